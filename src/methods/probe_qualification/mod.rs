//! Direction-dependent errors of a touch probe, from touches all around a precision sphere: repeatability,
//! pre-travel as harmonics of the azimuth with their covariance, stylus offset if the spindle can be oriented, and
//! dependence on the feed. Later runs with the same probe use the estimate as a prior
//! (`identification/probe_map.rs`).

mod estimate;
mod fit;
mod observe;
mod outputs;
mod settings;
mod setup;
mod sources;
mod stages;
mod symbol_names;
mod unknowns_layout;

pub use settings::ProbeQualificationSettings;

use self::setup::QualificationSetup;
use super::{
    IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod,
};
use crate::identification::probe_map;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub struct ProbeQualification {
    settings: ProbeQualificationSettings,
}

impl RegisteredMethod for ProbeQualification {
    type Settings = ProbeQualificationSettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: probe_map::PROBE_QUALIFICATION_METHOD_NAME,
        required_setup: "a precision sphere on the table; its form certificate, if later runs are to subtract \
            the pre-travel map of the probe",
        results: "repeatability of the touch probe, its pre-travel as a function of direction and of feed; \
            the stylus offset if the spindle can be oriented",
        default_machine_file: "probe-qualification.toml",
        source: "documentation of trued",
        symbol_names: symbol_names::SYMBOL_NAMES,
        has_cycle_passes: false,
    };

    fn new(settings: ProbeQualificationSettings) -> Self {
        Self { settings }
    }
}

impl Method for ProbeQualification {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        stages::next_stage(&QualificationSetup::new(plan, &self.settings)?, done, source)
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let setup = QualificationSetup::new(plan, &self.settings)?;
        let observed = observe::observe_touches(&setup, readings)?;
        let fitted = fit::fit_touches(&setup, &observed)?;
        Ok(estimate::build_estimate(&setup, &observed, &fitted))
    }
}
