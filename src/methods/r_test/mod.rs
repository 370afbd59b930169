//! Error motions of a rotary table by a discrete R-test in the centre of the table (paper 1, section 5.3): three
//! displacement sensors on the table, a sphere in the spindle. The linear axes do not move while the table turns,
//! so the result is an independent comparison with self-calibration.
//!
//! Small moves of the linear axes calibrate the sensors ([`model`]). The displacement of the sphere relative to the
//! nest at each stop gives the motion of the table ([`outputs`]).

mod identify;
mod model;
mod observe;
mod outputs;
mod sensor_nest;
mod settings;
mod sources;
mod stages;

pub use settings::RTestSettings;

use self::sensor_nest::SensorNest;
use crate::{
    IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod,
};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

pub const METHOD_NAME: &str = "r-test";

pub struct RTest {
    settings: RTestSettings,
}

impl RegisteredMethod for RTest {
    type Settings = RTestSettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: METHOD_NAME,
        required_setup: "a precision sphere in the spindle, three displacement sensors in the centre of the rotary table",
        results: "position of the rotary table's axis, its error motions in X, Y and Z over its angle",
        default_machine_file: "r-test.toml",
        source: "documentation of trued",
        symbol_names: &[],
        has_cycle_passes: false,
    };

    fn new(settings: RTestSettings) -> Self {
        Self { settings }
    }
}

impl Method for RTest {
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
        stages::next_stage(&SensorNest::new(plan, &self.settings)?, done, source)
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, MethodRefusal> {
        crate::named_sensors(METHOD_NAME, &self.settings.sensors, sensors)
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        identify::identify(plan, &self.settings, readings)
    }
}
