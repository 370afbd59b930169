//! What an identification has found, as the estimate and its warnings are written from it.

use super::fit::Measured;
use super::settings::Settings;
use super::suspects::Solved;
use estimation::linear::Survey;
use estimation::misfit::Misfit;
use estimation::monte_carlo::Summary;
use estimation::propagated::Propagated;
use machine::Position;
use machine::record::artefact::Length;
use machine::record::plan::Plan;

/// Everything that the estimate is written from.
pub struct Parts<'a> {
    pub plan: &'a Plan,
    pub settings: &'a Settings,
    pub solved: Solved<'a>,
    pub measured: &'a Measured,
    pub names: Vec<String>,
    pub survey: Survey,
    pub misfit: Misfit,
    pub propagated: Propagated,
    pub monte_carlo: Summary,
    pub lengths: &'a [&'a Length],
    pub u_bars: &'a [f64],
}

/// e.g. `B -30°, C 90°`.
pub fn place_name(position: &Position) -> String {
    let axes = position.iter().filter(|(axis, _)| !axis.is_linear());
    let named: Vec<String> =
        axes.map(|(axis, value)| format!("{axis} {:.0}°", axis.to_edge(value))).collect();
    named.join(", ")
}
