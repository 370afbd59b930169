//! Live values of the sensors that a prompt names, for the person at the machine.

use axum::extract::{Path, State};
use axum::response::Html;
use minijinja::{Value, context};

use super::render;
use crate::service::http::AppState;
use crate::service::http::problem::Problem;
use crate::service::http::status::MachineStatus;
use machine::record::watch::{LiveSection, LiveSensor, LiveValues};

/// The part that the script reloads with each new value.
pub async fn page(
    State(web): State<AppState>,
    Path(name): Path<String>,
) -> Result<Html<String>, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let live = MachineStatus::of(machine).asked.and_then(|asked| asked.live);
    render("sensors.html", context! { live => live.as_ref().map(values) })
}

pub fn values(live: &LiveValues) -> Value {
    context! {
        sensors => live.sensors.iter().map(sensor).collect::<Vec<_>>(),
        sections => live.sections.iter().map(section).collect::<Vec<_>>(),
        tilt => live.tilt_urad.map(|tilt| tilt.map(|urad| format!("{urad:+.0}"))),
    }
}

fn sensor(live: &LiveSensor) -> Value {
    let mm = |mm: f64| format!("{mm:+.5}");
    let percent = |mm: f64| format!("{:.0}", 100.0 * live.range_share(mm));
    context! {
        name => live.sensor.as_str(),
        value => live.value_mm.map(mm),
        failure => live.failure.as_deref(),
        target => live.target_mm.map(mm),
        to_target => live.to_target_um().map(|um| format!("{um:+.1}")),
        least => live.range_mm[0],
        greatest => live.range_mm[1],
        value_percent => live.value_mm.map(percent),
        target_percent => live.target_mm.map(percent),
    }
}

fn section(live: &LiveSection) -> Value {
    let at = live.eccentricity_um.map(|um| um.map(|um| format!("{um:+.1}")));
    context! { number => live.number, at }
}
