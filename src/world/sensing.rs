//! The displacement sensors in the spindle.

use super::beam::{Beam, Sensed};
use super::sensor_truth::SensorTruth;
use super::{World, WorldError, drawn};
use crate::record::sensor::Sensor;

/// One sensor, and how often it has been asked.
#[derive(Debug, Clone)]
pub(super) struct Eye {
    name: String,
    beam: Beam,
    clock: Ticks,
    taken: u64,
}

/// When it samples, by its own clock.
#[derive(Debug, Clone)]
struct Ticks {
    /// Of a second of its own.
    lasts_s: f64,
    jitter_s: f64,
    /// The last sample came so late.
    late_s: f64,
}

impl Ticks {
    fn new(truth: &SensorTruth) -> Self {
        let lasts_s = 1.0 + truth.clock_slow_ppm * 1e-6;
        Self { lasts_s, jitter_s: truth.clock_jitter_us * 1e-6, late_s: 0.0 }
    }

    /// What truly passes until the sample that comes `after_s` later by its clock. What one is late the
    /// next is not.
    fn until(&mut self, after_s: f64, deviate: f64) -> f64 {
        let before = std::mem::replace(&mut self.late_s, self.jitter_s * deviate);
        after_s * self.lasts_s + self.late_s - before
    }
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
            let clock = Ticks::new(&truth);
            let beam = Beam::new(sensor, truth, self.seed, number)?;
            Ok(Eye { name: sensor.name.clone(), beam, clock, taken: 0 })
        };
        self.eyes = sensors.iter().enumerate().map(eye).collect::<Result<_, _>>()?;
        Ok(self)
    }

    /// `after_s` pass by the clock of the sensor `name`, then it says what it sees from where the axes
    /// stand. `None`: there is no such sensor.
    pub fn sense(&mut self, name: &str, after_s: f64) -> Option<Sensed> {
        let number = self.eyes.iter().position(|eye| eye.name == name)?;
        let eye = self.eyes.get_mut(number)?;
        let tick = drawn::sample_tick(self.seed, number, eye.taken);
        let passed = eye.clock.until(after_s, tick);
        self.dwell(passed);
        let (axes, command) = (self.true_axes(), self.wired.truly(self.command.clone()));
        let sight = self.scene.sight(&axes, &command, self.t_s);
        let eye = self.eyes.get_mut(number)?;
        let deviate = drawn::sample_deviate(self.seed, number, eye.taken);
        eye.taken += 1;
        Some(eye.beam.says(&sight, deviate))
    }
}
