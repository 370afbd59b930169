//! The displacement sensors in the spindle.

use super::beam::{Beam, Sensed};
use super::{World, WorldError, drawn};
use crate::record::sensor::Sensor;

/// One sensor, and how often it has been asked.
#[derive(Debug, Clone)]
pub(super) struct Eye {
    name: String,
    beam: Beam,
    taken: u64,
}

impl Eye {
    /// From here on no noise comes that has been before.
    pub fn pass(&mut self, t_s: f64) {
        self.taken = self.taken.max((t_s * MOST_HZ) as u64);
    }
}

/// No sensor is asked more often.
const MOST_HZ: f64 = 1e6;

impl World {
    /// With these sensors in the spindle, each as its `[[simulated.sensor]]` says, an ideal one where
    /// there is none.
    ///
    /// # Errors
    /// Two sensors of one name, a `[[simulated.sensor]]` of no sensor, numbers that no sensor has.
    pub fn with_sensors(mut self, sensors: &[Sensor]) -> Result<Self, WorldError> {
        let named = |name: &str| sensors.iter().filter(|sensor| sensor.name == name).count();
        if let Some(stray) = self.sensor_truths.iter().find(|truth| named(&truth.name) == 0) {
            return Err(WorldError::NoSensor { name: stray.name.clone() });
        }
        if let Some(twice) = sensors.iter().find(|sensor| named(&sensor.name) > 1) {
            return Err(WorldError::TwoSensors { name: twice.name.clone() });
        }
        let eye = |(number, sensor): (usize, &Sensor)| {
            let mut truths = self.sensor_truths.iter().filter(|truth| truth.name == sensor.name);
            let truth = truths.next().cloned().unwrap_or_default();
            if truths.next().is_some() {
                return Err(WorldError::TwoSensors { name: sensor.name.clone() });
            }
            let beam = Beam::new(sensor, truth, self.seed, number)?;
            Ok(Eye { name: sensor.name.clone(), beam, taken: 0 })
        };
        self.eyes = sensors.iter().enumerate().map(eye).collect::<Result<_, _>>()?;
        Ok(self)
    }

    /// `after_s` pass, then the sensor `name` says what it sees from where the axes stand. `None`:
    /// there is no such sensor.
    pub fn sense(&mut self, name: &str, after_s: f64) -> Option<Sensed> {
        let number = self.eyes.iter().position(|eye| eye.name == name)?;
        self.dwell(after_s);
        let (axes, command) = (self.true_axes(), self.wired.truly(self.command.clone()));
        let sight = self.scene.sight(&axes, &command, self.t_s);
        let eye = self.eyes.get_mut(number)?;
        let deviate = drawn::sample_deviate(self.seed, number, eye.taken);
        eye.taken += 1;
        Some(eye.beam.says(&sight, deviate))
    }
}
