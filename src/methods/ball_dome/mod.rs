//! Verification of a calibration. A calibrated ball dome is measured at many indexations. Its balls are
//! transformed into the table frame with the nominal machine and with that of a SAMBA run, and compared with
//! the certificate (paper 4, sections 6 to 8; METHODS section 4).

mod design;
mod estimate;
mod found;
mod full_fit;
mod model;
mod noise;
mod outputs;
mod points;
mod prior;
mod settings;
mod sources;
mod stylus;
mod variant;

#[cfg(test)]
mod tests;

pub use settings::Settings;

use crate::ball_measurement::{self, MadeVisits};
use crate::identification::with_repeatability;
use crate::{Description, IdentifyError, Method, Next, Refused, Registered, Source};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const NAME: &str = "ball-dome";

pub struct BallDome {
    settings: Settings,
    made: MadeVisits,
}

impl Registered for BallDome {
    type Settings = Settings;
    const DESCRIPTION: Description = Description {
        name: NAME,
        needs: "a ball artefact whose places are calibrated, such as a ball dome",
        finds: "deviation of the balls from their certificate, by the nominal machine and, with a SAMBA \
                estimate, by the calibrated one",
        machine_file: "ball-dome.toml",
    };

    fn new(settings: Settings) -> Self {
        Self { settings, made: MadeVisits::default() }
    }
}

impl Method for BallDome {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        let setup = design::setup(plan, &self.settings)?;
        let visits = self.made.of(plan, || design::visits(&setup, &self.settings))?;
        ball_measurement::next(&setup, &visits, done, source)
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, Refused> {
        let (watch_min, measure_min) = (self.settings.watch_min, machine_s / 60.0);
        let watch = || {
            format!(
                "about {:.0} min: {measure_min:.0} min of measurement, and before it one ball is watched until the machine \
                 is at rest, for {watch_min:.0} min at least",
                measure_min + watch_min
            )
        };
        let time = match watch_min > 0.0 {
            true => watch(),
            false => format!("about {measure_min:.0} min"),
        };
        if prior::known_machine(plan)?.is_none() {
            return Ok(vec![time]);
        }
        let settings =
            Settings { monte_carlo_trials: Refused::MIN_TRIALS, ..self.settings.clone() };
        let readings = ball_measurement::nominal_readings(plan, machine_s);
        let estimate = estimate::estimate(&with_repeatability(plan), &settings, &readings)
            .map_err(|error| Refused::new(error.to_string(), error.remedy()))?;
        Ok([time].into_iter().chain(estimate.not_identifiable).collect())
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), Refused> {
        prior::known_machine(plan).map(drop)
    }

    fn takes_probe_map(&self) -> bool {
        true
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        estimate::estimate(plan, &self.settings, readings)
    }
}
