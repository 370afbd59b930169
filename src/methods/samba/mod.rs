//! SAMBA: identification of the geometry of a five-axis machine, the stylus and the artefact at once, from
//! uncalibrated master balls and one scale bar (paper 4; METHODS section 4).

mod design;
mod fit;
mod identify;
mod left_out;
mod model;
mod outputs;
mod parameters;
mod separable;
mod settings;
mod solution;
mod sources;
mod suspects;
#[cfg(test)]
pub mod tests;
mod warnings;

pub use crate::identification::LeastSquares;
pub use fit::{Bar, Measured, Measurement, Problem, Seen};
pub use model::Model;
pub use settings::Settings;

use std::sync::Arc;

use self::design::DesignSetup;
use super::{Description, IdentifyError, Method, Next, Refused, Registered, Source};
use crate::ball_measurement::{self, MadeVisits, Visit};
use crate::identification::{assumed_repeatability, expected, with_repeatability};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const NAME: &str = "samba";
pub struct Samba {
    settings: Settings,
    made: MadeVisits,
}

impl Samba {
    fn visits(&self, bench: &DesignSetup<'_>) -> Result<Arc<[Visit]>, Refused> {
        self.made.of(bench.plan, || {
            design::design(bench, |visits| {
                ball_measurement::machine_time_s(&bench.measurement(), visits)
            })
        })
    }
}

impl Registered for Samba {
    type Settings = Settings;
    const DESCRIPTION: Description = Description {
        name: NAME,
        needs: "uncalibrated master balls, and one scale bar",
        finds: "location errors of all axes, scales of X, Y, Z, spindle offsets, stylus \
                and balls, with their covariance",
        machine_file: "samba.toml",
    };

    fn new(settings: Settings) -> Self {
        Self { settings, made: MadeVisits::default() }
    }
}

impl Method for Samba {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        let bench = DesignSetup::new(plan, &self.settings)?;
        let visits = self.visits(&bench)?;
        ball_measurement::next(&bench.measurement(), &visits, done, source)
    }

    fn takes_probe_map(&self) -> bool {
        true
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, Refused> {
        let settings =
            Settings { monte_carlo_trials: Refused::MIN_TRIALS, ..self.settings.clone() };
        let readings = ball_measurement::nominal_readings(plan, machine_s);
        let estimate = identify::identify(&with_repeatability(plan), &settings, &readings)
            .map_err(|error| Refused::new(error.to_string(), error.remedy()))?;
        let of_machine = expected(&estimate, |parameter| parameter.symbol.starts_with('E'));
        let lines = of_machine.into_iter().chain(assumed_repeatability(plan));
        Ok(lines.chain(estimate.not_identifiable).collect())
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        identify::identify(plan, &self.settings, readings)
    }
}
