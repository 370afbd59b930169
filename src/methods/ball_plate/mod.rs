//! Six error motions of a rotary table from uncalibrated balls on a circle, on a machine whose linear axes
//! need not be known (paper 5; METHODS section 5). Every ball is measured at every stop of the table; least
//! squares over all visits separates the table, the plate and the linear axes.

mod angle_basis;
mod cross_check;
mod design;
mod equations;
mod forecast;
mod four_step_solution;
mod identify;
mod observe;
mod outputs;
mod plate;
mod settings;
mod single_revolutions;
mod solved;
mod sources;
mod symbol_names;
#[cfg(test)]
mod tests;
mod unknowns_layout;
mod warnings;

pub use settings::BallPlateSettings;

use self::design::PlateDesign;
use self::plate::Plate;
use super::{
    IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod,
};
use crate::ball_measurement::{self, MeasurementSetup};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const METHOD_NAME: &str = "ball-plate";
/// Maximum machine time of a plan without `long = true`, s; a longer one is refused, because drift limits its value.
const MAX_DURATION_WITHOUT_LONG_SETTING_S: f64 = 4.0 * 3600.0;

/// The method `ball-plate`: error motions of a rotary table from uncalibrated balls on a circle.
pub struct BallPlate {
    settings: BallPlateSettings,
}

impl RegisteredMethod for BallPlate {
    type Settings = BallPlateSettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: METHOD_NAME,
        required_setup: "three or more uncalibrated balls on a circle about the rotary table",
        results: "six error motions of the rotary table over its angle, reversal, deviations of \
                the linear axes along the circle, and deviations of the plate (shape of the ball pattern)",
        default_machine_file: "ball-plate.toml",
        source: "Q. Wang, J. Miller, A. von Freyberg, N. Steffens, A. Fischer, G. Goch: Error mapping of rotary \
                tables in 4-axis measuring devices using a ball plate artifact (2018)",
        symbol_names: symbol_names::SYMBOL_NAMES,
        has_cycle_passes: false,
    };

    fn new(settings: BallPlateSettings) -> Self {
        Self { settings }
    }
}

impl Method for BallPlate {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        self.settings.check()?;
        let plate = Plate::new(plan, &self.settings)?;
        let design = PlateDesign::new(plan, &self.settings, &plate)?;
        let touch = self.settings.touch_settings();
        let setup = MeasurementSetup { method: METHOD_NAME, plan, balls: plate.balls, touch_settings: touch };
        if done.is_empty() {
            design.check_rank(&self.settings, &plate)?;
            let time_s = ball_measurement::visits_machine_time_s(&setup, &design.visits)?;
            MethodRefusal::require(
                time_s <= MAX_DURATION_WITHOUT_LONG_SETTING_S || self.settings.long,
                format!("this plan requires {:.1} h of machine time", time_s / 3600.0),
                format!(
                    "choose fewer positions or revolutions, or set long = true in [method.{METHOD_NAME}]; U then \
                    includes the drift"
                ),
            )?;
        }
        ball_measurement::next_stage(&setup, &design.visits, done, source)
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, MethodRefusal> {
        forecast::describe_forecast(plan, &self.settings, machine_s)
            .map_err(|error| MethodRefusal::new(error.to_string(), error.remedy()))
    }

    fn accepts_probe_map(&self) -> bool {
        true
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        identify::identify(plan, &self.settings, readings)
    }
}
