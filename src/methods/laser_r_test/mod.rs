//! Location errors of rotary axes from one precision sphere: the laser R-test of paper 2 with a displacement sensor
//! in the spindle (METHODS section 2), or chase-the-ball with the touch probe.

mod centre_equations;
mod combined_fit;
mod estimate_notes;
mod identify;
mod latency;
mod measured_scan;
mod observe;
mod outputs;
mod paper_estimator;
mod parameter_selection;
mod pose_groups;
mod position_history;
mod result;
mod scan_cells;
mod scan_purpose;
mod scan_step;
mod settings;
mod setup;
mod sources;
mod sphere_geometry;
mod sphere_model;
mod stages;
mod symbol_names;
#[cfg(test)]
mod tests;
mod touches;

pub use settings::LaserRTestSettings;

use self::settings::MeasuringDevice;
use self::setup::LaserSetup;
use super::{
    IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod,
};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

pub const METHOD_NAME: &str = "laser-r-test";
/// The method `laser-r-test`: location errors of rotary axes from one sphere, by laser sensor or touch probe.
pub struct LaserRTest {
    settings: LaserRTestSettings,
}

impl RegisteredMethod for LaserRTest {
    type Settings = LaserRTestSettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: METHOD_NAME,
        required_setup: "one precision sphere; a laser displacement sensor in the spindle, or the \
                touch probe",
        results: "location errors of both rotary axes, optionally harmonics of the tilting axis; \
                beam and zero point of the sensor",
        default_machine_file: "laser.toml",
        source: "Y. Nagai, S. Ibaraki, S. Nishikawa: Error calibration of five-axis machine tools by on-machine \
                measurement system using a laser displacement sensor (2014)",
        symbol_names: symbol_names::SYMBOL_NAMES,
        has_cycle_passes: false,
    };

    fn new(settings: LaserRTestSettings) -> Self {
        Self { settings }
    }
}

impl Method for LaserRTest {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        let setup = LaserSetup::new(plan, &self.settings)?;
        let stage_requests = stages::list_stage_requests(&setup)?;
        let stage_count = done.iter().filter(|stage| stage.repeat == 0).count();
        let Some(stage_request) = stage_requests.get(stage_count) else { return Ok(NextStage::NoFurtherStage) };
        let geometry = match source {
            ObjectPositionSource::Nominal => sphere_geometry::nominal_geometry(&setup),
            ObjectPositionSource::Measured(readings) => sphere_geometry::measured_geometry(&setup, readings)?,
        };
        stages::build_stage(&setup, stage_request, &geometry, done)
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, MethodRefusal> {
        match self.settings.by {
            MeasuringDevice::Laser => Ok(vec![setup::select_sensor(sensors, &self.settings)?]),
            MeasuringDevice::Probe => Ok(Vec::new()),
        }
    }

    fn accepts_probe_map(&self) -> bool {
        self.settings.by == MeasuringDevice::Probe
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let setup = LaserSetup::new(plan, &self.settings)?;
        identify::identify(&setup, readings)
    }
}
