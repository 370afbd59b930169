//! Displacement sensors in the spindle, on the table or on the bed.

use super::beam::{Beam, Sensed};
use super::sensor_truth::SensorTruth;
use super::{Speed, World, WorldError, drawn};
use machine::Position;
use machine::record::sensor::{Mount, Sensor};

/// One sensor, and the number of samples it has taken.
#[derive(Debug, Clone)]
pub(super) struct SimulatedSensor {
    name: String,
    mount: Mount,
    beam: Beam,
    clock: Ticks,
    taken: u64,
}

/// Sampling times, by the sensor's own clock.
#[derive(Debug, Clone)]
struct Ticks {
    /// True duration of a second of the sensor's clock.
    lasts_s: f64,
    jitter_s: f64,
    /// Delay of the last sample.
    late_s: f64,
    /// Latency: each output belongs to a moment this much earlier.
    before_s: f64,
}

impl Ticks {
    fn new(truth: &SensorTruth) -> Self {
        let lasts_s = 1.0 + truth.clock_slow_ppm * 1e-6;
        let (jitter_s, before_s) = (truth.clock_jitter_us * 1e-6, truth.clock_late_ms * 1e-3);
        Self { lasts_s, jitter_s, late_s: 0.0, before_s }
    }

    /// True time until the sample that comes `after_s` later by the sensor's clock. The jitter of one sample
    /// does not shift the next one.
    fn until(&mut self, after_s: f64, deviate: f64) -> f64 {
        let before = std::mem::replace(&mut self.late_s, self.jitter_s * deviate);
        after_s * self.lasts_s + self.late_s - before
    }
}

impl SimulatedSensor {
    /// Advances the sample count to `t_s`, so that no noise value repeats.
    pub fn pass(&mut self, t_s: f64) {
        self.taken = self.taken.max((t_s * MOST_HZ) as u64);
    }
}

/// A sample that a sensor takes during a move.
#[derive(Debug, Clone)]
pub struct SampleInMotion {
    /// Displayed position, at the time of output.
    pub position: Position,
    pub t_s: f64,
    pub sensed: Sensed,
}

/// Maximum sampling rate of a sensor.
const MOST_HZ: f64 = 1e6;

impl World {
    /// Adds these sensors, each with the errors of its `[[simulated.sensor]]`; without one, the sensor is
    /// ideal.
    ///
    /// # Errors
    /// Two sensors have the same name, a `[[simulated.sensor]]` names no sensor, or a number is impossible for
    /// a sensor.
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
            Ok(SimulatedSensor {
                name: sensor.name.clone(),
                mount: sensor.mount,
                beam,
                clock,
                taken: 0,
            })
        };
        self.eyes = sensors.iter().enumerate().map(eye).collect::<Result<_, _>>()?;
        Ok(self)
    }

    /// Lets `after_s` pass by the clock of the sensor `name`, then returns its sample at the axis positions,
    /// which are earlier ones if the sensor has a latency. `None`: there is no such sensor.
    pub fn sense(&mut self, name: &str, after_s: f64) -> Option<Sensed> {
        let number = self.eyes.iter().position(|eye| eye.name == name)?;
        let passed = self.tick(number, after_s)?;
        self.dwell(passed);
        self.says(number, self.t_s)
    }

    /// Sample of the sensor `name` at `t_s`, which is not later than now, and the axis positions at that time.
    /// `None`: there is no such sensor.
    pub fn sensed_at(&mut self, name: &str, t_s: f64) -> Option<SampleInMotion> {
        let number = self.eyes.iter().position(|eye| eye.name == name)?;
        let position = match self.trail.at(t_s) {
            Some((path, along)) => self.displayed(&path.command(along)),
            None => self.position(),
        };
        Some(SampleInMotion { position, t_s, sensed: self.says(number, t_s)? })
    }

    /// Makes a straight, unguarded move of the axes named in `to`, during which the sensor `name` samples every
    /// `period_s` by its clock.
    pub fn sense_on_the_way(
        &mut self,
        name: &str,
        to: &Position,
        speed: Speed,
        period_s: f64,
    ) -> Vec<SampleInMotion> {
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

    /// True time until the next sample.
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
