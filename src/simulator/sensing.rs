//! The displacement sensors, in the spindle, on the table or on the bed.

use super::beam::{Beam, Sensed};
use super::sensor_truth::SensorTruth;
use super::{Speed, World, WorldError, drawn};
use machine::Position;
use machine::record::sensor::{Mount, Sensor};

/// One sensor, and how often it has been asked.
#[derive(Debug, Clone)]
pub(super) struct Eye {
    name: String,
    mount: Mount,
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
    /// What each says was so long before.
    before_s: f64,
}

impl Ticks {
    fn new(truth: &SensorTruth) -> Self {
        let lasts_s = 1.0 + truth.clock_slow_ppm * 1e-6;
        let (jitter_s, before_s) = (truth.clock_jitter_us * 1e-6, truth.clock_late_ms * 1e-3);
        Self { lasts_s, jitter_s, late_s: 0.0, before_s }
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

/// What a sensor said on the way.
#[derive(Debug, Clone)]
pub struct Passing {
    /// Displayed, and the time, when it said it.
    pub position: Position,
    pub t_s: f64,
    pub sensed: Sensed,
}

/// No sensor is asked more often.
const MOST_HZ: f64 = 1e6;

impl World {
    /// With these sensors, each as its `[[simulated.sensor]]` says, an ideal one where
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
            Ok(Eye { name: sensor.name.clone(), mount: sensor.mount, beam, clock, taken: 0 })
        };
        self.eyes = sensors.iter().enumerate().map(eye).collect::<Result<_, _>>()?;
        Ok(self)
    }

    /// `after_s` pass by the clock of the sensor `name`, then it says what it sees from where the axes
    /// stand, or stood when it saw it. `None`: there is no such sensor.
    pub fn sense(&mut self, name: &str, after_s: f64) -> Option<Sensed> {
        let number = self.eyes.iter().position(|eye| eye.name == name)?;
        let passed = self.tick(number, after_s)?;
        self.dwell(passed);
        self.says(number, self.t_s)
    }

    /// What the sensor `name` says at `t_s`, which is not later than now, and where the axes were then. `None`:
    /// there is no such sensor.
    pub fn sensed_at(&mut self, name: &str, t_s: f64) -> Option<Passing> {
        let number = self.eyes.iter().position(|eye| eye.name == name)?;
        let position = match self.trail.at(t_s) {
            Some((path, along)) => self.displayed(&path.command(along)),
            None => self.position(),
        };
        Some(Passing { position, t_s, sensed: self.says(number, t_s)? })
    }

    /// A straight unguarded move of the axes named in `to`; on its way the sensor `name` says something
    /// each `period_s` by its clock.
    pub fn sense_on_the_way(
        &mut self,
        name: &str,
        to: &Position,
        speed: Speed,
        period_s: f64,
    ) -> Vec<Passing> {
        let number = self.eyes.iter().position(|eye| eye.name == name);
        let (Some(number), Some(path)) = (number, self.path(to, speed)) else { return Vec::new() };
        let (begins_s, lasts_s) = (self.t_s, path.ramp().duration_s());
        self.trail.went(begins_s, &path, 1.0);
        let (mut all, mut t_s) = (Vec::new(), begins_s);
        while let Some(passed) = self.tick(number, period_s) {
            t_s += passed;
            if t_s > begins_s + lasts_s || passed <= 0.0 {
                break;
            }
            let Some(passing) = self.sensed_at(name, t_s) else { break };
            all.push(passing);
        }
        self.stop_at(&path, 1.0, lasts_s);
        all
    }

    /// What truly passes until the next sample.
    fn tick(&mut self, number: usize, after_s: f64) -> Option<f64> {
        let eye = self.eyes.get_mut(number)?;
        let deviate = drawn::sample_tick(self.seed, number, eye.taken);
        Some(eye.clock.until(after_s, deviate))
    }

    fn says(&mut self, number: usize, t_s: f64) -> Option<Sensed> {
        let saw_s = t_s - self.eyes.get(number)?.clock.before_s;
        let (axes, command) = match self.trail.at(saw_s) {
            Some((path, along)) => self.true_on(path, along),
            None => (self.true_axes(), self.wired.truly(self.command.clone())),
        };
        let sight = match self.eyes.get(number)?.mount {
            Mount::Bed => self.scene.sight_from_bed(&axes, saw_s),
            Mount::Table => self.scene.sight_from_table(&axes, &command, saw_s),
            Mount::Spindle => self.scene.sight(&axes, &command, saw_s),
        };
        let eye = self.eyes.get_mut(number)?;
        let deviate = drawn::sample_deviate(self.seed, number, eye.taken);
        eye.taken += 1;
        Some(eye.beam.says(&sight, deviate))
    }
}
