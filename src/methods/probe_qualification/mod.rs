//! Direction-dependent errors of a touch probe, from touches all around a precision sphere: repeatability,
//! pre-travel as harmonics of the azimuth with their covariance, stylus offset if the spindle can be oriented, and
//! dependence on the feed. Later runs with the same probe use the estimate as a prior
//! (`identification/probe_map.rs`).

mod bench;
mod estimate;
mod fit;
mod layout;
mod observe;
mod outputs;
mod settings;
mod sources;
mod stages;

pub use settings::Settings;

use self::bench::QualificationSetup;
use super::{Description, IdentifyError, Method, Next, Refused, Registered, Source};
use crate::identification::probe_map;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub struct ProbeQualification {
    settings: Settings,
}

impl Registered for ProbeQualification {
    type Settings = Settings;
    const DESCRIPTION: Description = Description {
        name: probe_map::METHOD,
        needs: "a precision sphere on the table; its form certificate, for a map that later runs take off",
        finds: "repeatability of the touch probe, its pre-travel over the direction, what the feed changes; with a \
                spindle that can be turned the stylus offset",
        machine_file: "probe-qualification.toml",
    };

    fn new(settings: Settings) -> Self {
        Self { settings }
    }
}

impl Method for ProbeQualification {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        stages::next(&QualificationSetup::new(plan, &self.settings)?, done, source)
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let bench = QualificationSetup::new(plan, &self.settings)?;
        let observed = observe::observe(&bench, readings)?;
        let fitted = fit::fit(&bench, &observed)?;
        Ok(estimate::estimate(&bench, &observed, &fitted))
    }
}
