//! Error motions of a rotary table by a discrete R-test in the centre of the table (paper 1, section 5.3): three
//! displacement sensors on the table, a sphere in the spindle. The linear axes do not move while the table turns,
//! so the result is an independent comparison with self-calibration.
//!
//! Small moves of the linear axes calibrate the sensors ([`model`]). The displacement of the sphere relative to the
//! nest at each stop gives the motion of the table ([`outputs`]).

mod fit;
mod identify;
mod label;
mod model;
mod nest;
mod observe;
mod outputs;
mod settings;
mod sources;
mod stages;

pub use settings::Settings;

use self::nest::Nest;
use crate::{Description, IdentifyError, Method, Next, Refused, Registered, Source};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

pub const NAME: &str = "r-test";

pub struct RTest {
    settings: Settings,
}

impl Registered for RTest {
    type Settings = Settings;
    const DESCRIPTION: Description = Description {
        name: NAME,
        needs: "a precision sphere in the spindle, three displacement sensors in the centre of the rotary table",
        finds: "position of the rotary table's axis, its error motions in X, Y and Z over its angle",
        machine_file: "r-test.toml",
    };

    fn new(settings: Settings) -> Self {
        Self { settings }
    }
}

impl Method for RTest {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        self.settings.check()?;
        stages::next(&Nest::new(plan, &self.settings)?, done, source)
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, Refused> {
        crate::named_sensors(NAME, &self.settings.sensors, sensors)
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        identify::identify(plan, &self.settings, readings)
    }
}
