//! Error motions of a rotary axis by multiprobe and multistep separation (paper 3): sensors around a cylinder on
//! the table, with the cylinder indexed relative to the table. Samples of several revolutions give five of the six
//! error motions. The angular positioning error is not measurable with a round artefact.
//!
//! [`estimation::revolutions`] resamples to equal angles and computes harmonics with their scatter.
//! [`identify_motions`] separates motion and artefact harmonic by harmonic. [`layout_prediction`] predicts before the
//! measurement what a layout separates.

mod calibration;
mod centring;
mod estimate;
mod fault_diagnosis;
mod fit;
mod layout_checks;
mod layout_prediction;
mod model;
mod observe;
mod outputs;
mod settings;
mod setup;
mod sources;
mod stages;
mod step_label;
mod symbol_names;
mod total_and_asynchronous;

#[cfg(test)]
mod tests;

pub use settings::MultiprobeSettings;

use self::fit::SeparationFit;
use self::model::ProbeLayout;
use self::outputs::ReportedMotions;
use self::setup::MultiprobeSetup;
use self::sources::{SourceSizes, uncertainty_sources};
use crate::identification::{Identification, IdentificationOutputs, TrialSettings};
use crate::{
    IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod,
};
use estimation::revolutions::HarmonicData;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

pub const METHOD_NAME: &str = "multiprobe";

pub struct Multiprobe {
    settings: MultiprobeSettings,
}

impl RegisteredMethod for Multiprobe {
    type Settings = MultiprobeSettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: METHOD_NAME,
        required_setup: "a datum cylinder on an indexing stage on the rotary table, three or more displacement sensors",
        results: "five error motions of the rotary table over its angle (all but EC), form of the cylinder, \
                eccentricity",
        default_machine_file: "multiprobe.toml",
        source: "D. Maldonado Pimiento, F. Viprey, S. Lavernhe, G. Poulachon: Novel in-situ methodology for \
                geometric error characterisation of rotary axis errors on multi-axis machine tool. 15th \
                Lamdamap Conference (2023)",
        symbol_names: symbol_names::SYMBOL_NAMES,
        has_cycle_passes: false,
    };

    fn new(settings: MultiprobeSettings) -> Self {
        Self { settings }
    }
}

impl Method for Multiprobe {
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
        let setup = MultiprobeSetup::new(plan, &self.settings)?;
        if done.is_empty() {
            setup.check_separability()?;
        }
        stages::next_stage(&setup, done, source)
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, MethodRefusal> {
        crate::named_sensors(METHOD_NAME, &self.settings.sensors, sensors)
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        estimate::build_estimate(plan, &self.settings, readings)
    }
}

/// The identified error motions and forms, with the fit from which they follow.
struct SeparatedMotions {
    pub identification: Identification,
    pub fit: SeparationFit,
}

/// Separates motion and artefact. Values by ISO 230-7 and roundness have an uncertainty only with `trials`.
///
/// # Errors
/// A value is not finite, or there are fewer than two trials.
fn identify_motions(
    layout: &ProbeLayout,
    data: &HarmonicData,
    sizes: &SourceSizes<'_>,
    trials: Option<TrialSettings>,
) -> Result<SeparatedMotions, IdentifyError> {
    let fit = SeparationFit::new(layout, data)?;
    let motions = ReportedMotions::new(layout, &fit);
    // The uncertainties of the values by ISO 230-7 and of the roundness come from the trials.
    let nonlinear = motions.motion_ranges(sizes.settings.sampling);
    let outputs = IdentificationOutputs { nonlinear: Some(nonlinear), ..motions.linear_outputs() };
    let sources = uncertainty_sources(layout, data, &fit, sizes);
    let identification = crate::identification::identify(&fit.solved_model(), &sources, outputs, trials)?;
    Ok(SeparatedMotions { identification, fit })
}
