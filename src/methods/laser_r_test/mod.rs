//! Location errors of rotary axes from one precision sphere: the laser R-test of paper 2 with a displacement sensor
//! in the spindle (METHODS section 2), or chase-the-ball with the touch probe.

mod bench;
mod cells;
mod centres;
mod cross;
mod group;
mod identify;
mod known;
mod label;
mod latency;
mod model;
mod observe;
mod outputs;
mod paper;
mod parameters;
mod parts;
mod settings;
mod sources;
mod spots;
mod stages;
#[cfg(test)]
mod tests;
mod touches;
mod track;
mod two_fits;
mod words;

pub use settings::Settings;

use self::bench::LaserSetup;
use self::settings::MeasuringDevice;
use super::{Description, IdentifyError, Method, Next, Refused, Registered, Source};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

pub const NAME: &str = "laser-r-test";
pub struct LaserRTest {
    settings: Settings,
}

impl Registered for LaserRTest {
    type Settings = Settings;
    const DESCRIPTION: Description = Description {
        name: NAME,
        needs: "one precision sphere; a laser displacement sensor in the spindle, or the \
                touch probe",
        finds: "location errors of both rotary axes, on request harmonics of the tilting \
                one; the sensor's beam and zero point",
        machine_file: "laser.toml",
    };

    fn new(settings: Settings) -> Self {
        Self { settings }
    }
}

impl Method for LaserRTest {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        let bench = LaserSetup::new(plan, &self.settings)?;
        let tasks = stages::tasks(&bench)?;
        let id = done.last().map_or(0, |stage| stage.id + 1);
        let passed = done.iter().filter(|stage| stage.repeat == 0).count();
        let Some(task) = tasks.get(passed) else { return Ok(Next::Done) };
        let place = match source {
            Source::Nominal => known::nominal(&bench),
            Source::Measured(readings) => known::known(&bench, readings)?,
        };
        let (stage, new_steps) = stages::stage(&bench, task, &place, id)?;
        Ok(Next::Stage { stage, new_steps })
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, Refused> {
        match self.settings.by {
            MeasuringDevice::Laser => Ok(vec![bench::sensor(sensors, &self.settings)?]),
            MeasuringDevice::Probe => Ok(Vec::new()),
        }
    }

    fn takes_probe_map(&self) -> bool {
        self.settings.by == MeasuringDevice::Probe
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let bench = LaserSetup::new(plan, &self.settings)?;
        identify::identify(&bench, readings)
    }
}
