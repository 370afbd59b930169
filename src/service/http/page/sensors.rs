//! Live values of the sensors that a prompt names, for the person at the machine.

use axum::response::Html;
use minijinja::{Value, context};

use super::render_template;
use crate::service::http::ServedMachine;
use crate::service::http::machine_status::MachineStatus;
use crate::service::http::problem::Problem;
use machine::record::watched_sensors::{LiveCrossSectionValue, LiveSensorValue, LiveValues};

/// Part of the page with the sensor values; the script reloads it with each new value.
pub async fn sensors_part(machine: ServedMachine) -> Result<Html<String>, Problem> {
    let live = MachineStatus::from_machine(&machine).open_prompt.and_then(|asked| asked.live);
    render_template("sensors.html", context! { live => live.as_ref().map(live_values) })
}

pub fn live_values(live: &LiveValues) -> Value {
    context! {
        sensors => live.sensors.iter().map(sensor_values).collect::<Vec<_>>(),
        sections => live.sections.iter().map(section_values).collect::<Vec<_>>(),
        tilt => live.tilt_urad.map(|tilt| tilt.map(|urad| format!("{urad:+.0}"))),
    }
}

fn sensor_values(live: &LiveSensorValue) -> Value {
    let mm = |mm: f64| format!("{mm:+.5}");
    let percent = |mm: f64| format!("{:.0}", 100.0 * live.fraction_of_range(mm));
    context! {
        name => live.sensor.as_str(),
        value => live.value_mm.map(mm),
        failure => live.failure.as_deref(),
        target => live.target_mm.map(mm),
        to_target => live.change_to_target_um().map(|um| format!("{um:+.1}")),
        least => live.range_mm[0],
        greatest => live.range_mm[1],
        value_percent => live.value_mm.map(percent),
        target_percent => live.target_mm.map(percent),
    }
}

fn section_values(live: &LiveCrossSectionValue) -> Value {
    let at = live.eccentricity_um.map(|um| um.map(|um| format!("{um:+.1}")));
    context! { number => live.number, at }
}
