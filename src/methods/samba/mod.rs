//! SAMBA: identification of the geometry of a five-axis machine, the stylus and the artefact at once, from
//! uncalibrated master balls and one scale bar (paper 4; METHODS section 4).

mod confounding;
mod consistency;
mod design;
mod fit;
mod geometry_model;
mod geometry_solution;
mod identify;
mod omitted_errors;
mod outputs;
mod parameters;
mod settings;
mod sources;
mod symbol_names;
#[cfg(test)]
pub mod tests;
mod warnings;

pub use crate::identification::NonlinearFit;
pub use fit::{GeometryEquations, GeometryProblem, LengthConstraint, ObservedValues, PlannedBallMeasurement};
pub use geometry_model::GeometryModel;
pub use settings::SambaSettings;

use std::sync::Arc;

use self::design::DesignSetup;
use super::{
    IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod,
};
use crate::ball_measurement::{self, BallVisit, VisitCache};
use crate::identification::{
    describe_assumed_repeatability, describe_expected_uncertainty, plan_with_assumed_repeatability,
};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const METHOD_NAME: &str = "samba";
pub struct Samba {
    settings: SambaSettings,
    visit_cache: VisitCache,
}

impl Samba {
    /// Visits of the design in measuring order; designed again only if machine, probe or artefact have changed.
    fn designed_visits(&self, setup: &DesignSetup<'_>) -> Result<Arc<[BallVisit]>, MethodRefusal> {
        self.visit_cache.get_or_design(setup.plan, || {
            design::design_visits(setup, |visits| {
                ball_measurement::visits_machine_time_s(&setup.measurement_setup(), visits)
            })
        })
    }
}

impl RegisteredMethod for Samba {
    type Settings = SambaSettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: METHOD_NAME,
        required_setup: "uncalibrated master balls, and one scale bar",
        results: "location errors of all axes, scales of X, Y, Z, spindle offsets, stylus tip \
                and ball positions, with their covariance",
        default_machine_file: "samba.toml",
        source: "H. Hashemiboroujeni, S. Esmaeili Marzdashti, K. Xing, J. R. R. Mayer: Five-axis machine tool \
                coordinate metrology evaluation using the ball dome artefact before and after machine \
                calibration. J. Manuf. Mater. Process. 3 (2019) 20",
        symbol_names: symbol_names::SYMBOL_NAMES,
        has_cycle_passes: false,
    };

    fn new(settings: SambaSettings) -> Self {
        Self { settings, visit_cache: VisitCache::default() }
    }
}

impl Method for Samba {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        let setup = DesignSetup::new(plan, &self.settings)?;
        let visits = self.designed_visits(&setup)?;
        ball_measurement::next_stage(&setup.measurement_setup(), &visits, done, source)
    }

    fn accepts_probe_map(&self) -> bool {
        true
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, MethodRefusal> {
        let settings =
            SambaSettings { monte_carlo_trials: MethodRefusal::MIN_MONTE_CARLO_TRIALS, ..self.settings.clone() };
        let readings = ball_measurement::nominal_readings(plan, machine_s);
        let estimate = identify::identify(&plan_with_assumed_repeatability(plan), &settings, &readings)
            .map_err(|error| MethodRefusal::new(error.to_string(), error.remedy()))?;
        let of_machine = describe_expected_uncertainty(&estimate, |parameter| parameter.symbol.starts_with('E'));
        let lines = of_machine.into_iter().chain(describe_assumed_repeatability(plan));
        Ok(lines.chain(estimate.not_identifiable).collect())
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        identify::identify(plan, &self.settings, readings)
    }
}
