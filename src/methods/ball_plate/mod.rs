//! Six error motions of a rotary table from uncalibrated balls on a circle, on a machine whose linear axes
//! need not be known (paper 5; METHODS section 5). Every ball is measured at every stop of the table; least
//! squares over all visits separates the table, the plate and the linear axes.

mod basis;
mod cross_check;
mod cycles;
mod design;
mod equations;
mod forecast;
mod four_steps;
mod identify;
mod layout;
mod observe;
mod outputs;
mod plate;
mod settings;
mod solved;
mod sources;
#[cfg(test)]
mod tests;
mod warnings;

pub use settings::Settings;

use self::design::Design;
use self::plate::Plate;
use super::{Description, IdentifyError, Method, Next, Refused, Registered, Source};
use crate::ball_measurement::{self, MeasurementSetup};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const NAME: &str = "ball-plate";
/// Maximum duration of a run without `long = true`, s: drift limits the value of a longer run.
const MAX_DURATION_S: f64 = 4.0 * 3600.0;

pub struct BallPlate {
    settings: Settings,
}

impl Registered for BallPlate {
    type Settings = Settings;
    const DESCRIPTION: Description = Description {
        name: NAME,
        needs: "three or more uncalibrated balls on a circle about the rotary table",
        finds: "six error motions of the rotary table over its angle, reversal, deviations of \
                the linear axes along the circle, and of the plate",
        machine_file: "ball-plate.toml",
    };

    fn new(settings: Settings) -> Self {
        Self { settings }
    }
}

impl Method for BallPlate {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        self.settings.check()?;
        let plate = Plate::new(plan, &self.settings)?;
        let design = Design::new(plan, &self.settings, &plate)?;
        let touch = self.settings.touch();
        let setup = MeasurementSetup { method: NAME, plan, balls: plate.balls, touch };
        if done.is_empty() {
            design.check(&self.settings, &plate)?;
            let time_s = ball_measurement::machine_time_s(&setup, &design.visits)?;
            self.check_duration(time_s)?;
        }
        ball_measurement::next(&setup, &design.visits, done, source)
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, Refused> {
        forecast::forecast(plan, &self.settings, machine_s)
            .map_err(|error| Refused::new(error.to_string(), error.remedy()))
    }

    fn takes_probe_map(&self) -> bool {
        true
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        identify::identify(plan, &self.settings, readings)
    }
}

impl BallPlate {
    fn check_duration(&self, time_s: f64) -> Result<(), Refused> {
        if time_s <= MAX_DURATION_S || self.settings.long {
            return Ok(());
        }
        Err(Refused {
            why: format!("this plan takes {:.1} hours of machine time", time_s / 3600.0),
            instead: format!(
                "choose fewer positions or revolutions, or state long = true in [method.{NAME}]: drift then \
                 stands in U"
            ),
        })
    }
}
