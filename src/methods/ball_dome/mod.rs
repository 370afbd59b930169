//! Verification of a calibration. A calibrated ball dome is measured at many indexations. Its balls are transformed
//! into the table frame twice, with the nominal machine and with the machine errors of a SAMBA run, and compared with
//! the certificate (paper 4, sections 6 to 8; METHODS section 4).

mod design;
mod error_and_stylus_fit;
mod estimate;
mod measured_points;
mod model;
mod noise_simulation;
mod outputs;
mod prior_machine_errors;
mod settings;
mod sources;
mod stylus_gain;
mod symbol_names;
mod variant;
mod variant_computation;

#[cfg(test)]
mod tests;

pub use settings::BallDomeSettings;

use crate::ball_measurement::{self, VisitCache};
use crate::identification::plan_with_assumed_repeatability;
use crate::{
    IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod,
};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const METHOD_NAME: &str = "ball-dome";

pub struct BallDome {
    settings: BallDomeSettings,
    visit_cache: VisitCache,
}

impl RegisteredMethod for BallDome {
    type Settings = BallDomeSettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: METHOD_NAME,
        required_setup: "a ball artefact with calibrated positions, such as a ball dome",
        results: "deviation of the measured ball positions from their certificate: without correction and, given a \
            SAMBA estimate, with correction of the machine errors",
        default_machine_file: "ball-dome.toml",
        source: "H. Hashemiboroujeni, S. Esmaeili Marzdashti, K. Xing, J. R. R. Mayer: Five-axis machine tool \
                coordinate metrology evaluation using the ball dome artefact before and after machine \
                calibration. J. Manuf. Mater. Process. 3 (2019) 20",
        symbol_names: symbol_names::SYMBOL_NAMES,
        has_cycle_passes: false,
    };

    fn new(settings: BallDomeSettings) -> Self {
        Self { settings, visit_cache: VisitCache::default() }
    }
}

impl Method for BallDome {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        let setup = design::dome_setup(plan, &self.settings)?;
        let visits = self.visit_cache.get_or_design(plan, || design::design_visits(&setup, &self.settings))?;
        ball_measurement::next_stage(&setup, &visits, done, source)
    }

    /// Duration of the run. With an estimate of the machine also what the run cannot determine, from an identification
    /// of nominal readings.
    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, MethodRefusal> {
        let (watch_min, measure_min) = (self.settings.rest_check_min, machine_s / 60.0);
        let time = match watch_min > 0.0 {
            true => format!(
                "about {:.0} min: {measure_min:.0} min of measurement, after a rest check of at least \
                {watch_min:.0} min with one ball",
                measure_min + watch_min
            ),
            false => format!("about {measure_min:.0} min"),
        };
        if prior_machine_errors::machine_errors_from_prior(plan)?.is_none() {
            return Ok(vec![time]);
        }
        let settings =
            BallDomeSettings { monte_carlo_trials: MethodRefusal::MIN_MONTE_CARLO_TRIALS, ..self.settings.clone() };
        let readings = ball_measurement::nominal_readings(plan, machine_s);
        let estimate = estimate::build_estimate(&plan_with_assumed_repeatability(plan), &settings, &readings)
            .map_err(|error| MethodRefusal::new(error.to_string(), error.remedy()))?;
        Ok([time].into_iter().chain(estimate.not_identifiable).collect())
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), MethodRefusal> {
        prior_machine_errors::machine_errors_from_prior(plan).map(drop)
    }

    fn accepts_probe_map(&self) -> bool {
        true
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        estimate::build_estimate(plan, &self.settings, readings)
    }
}
