//! Displacement sensors in the spindle, on the table or on the bed.

use super::beam::{Beam, SensorOutput};
use super::sensor_truth::SensorTruth;
use super::{SimulatedWorld, SimulatedWorldError, Speed, random_draws};
use machine::Position;
use machine::record::sensor::{Sensor, SensorMount};

/// One sensor, and the number of samples it has taken.
#[derive(Debug, Clone)]
pub(super) struct SimulatedSensor {
    name: String,
    mount: SensorMount,
    beam: Beam,
    clock: SampleClock,
    sample_count: u64,
}

/// Sampling times, by the sensor's own clock.
#[derive(Debug, Clone)]
struct SampleClock {
    /// True duration of a second of the sensor's clock.
    second_duration_s: f64,
    jitter_s: f64,
    /// Delay of the last sample.
    last_jitter_s: f64,
    /// Latency: each output belongs to a moment this much earlier.
    latency_s: f64,
}

impl SampleClock {
    fn new(truth: &SensorTruth) -> Self {
        let second_duration_s = 1.0 + truth.clock_slow_ppm * 1e-6;
        let (jitter_s, latency_s) = (truth.clock_jitter_us * 1e-6, truth.clock_late_ms * 1e-3);
        Self { second_duration_s, jitter_s, last_jitter_s: 0.0, latency_s }
    }

    /// True time until the sample that comes `after_s` later by the sensor's clock. The jitter of one sample
    /// does not shift the next one.
    fn time_until_sample_s(&mut self, after_s: f64, deviate: f64) -> f64 {
        let before = std::mem::replace(&mut self.last_jitter_s, self.jitter_s * deviate);
        after_s * self.second_duration_s + self.last_jitter_s - before
    }
}

impl SimulatedSensor {
    /// Advances the sample count to `t_s`, so that no noise value repeats.
    pub fn advance_to(&mut self, t_s: f64) {
        self.sample_count = self.sample_count.max((t_s * MAX_SAMPLE_RATE_HZ) as u64);
    }
}

/// A sample that a sensor takes during a move.
#[derive(Debug, Clone)]
pub struct SampleInMotion {
    /// Displayed position, at the time of output.
    pub position: Position,
    pub t_s: f64,
    pub output: SensorOutput,
}

/// Maximum sampling rate of a sensor.
const MAX_SAMPLE_RATE_HZ: f64 = 1e6;

impl SimulatedWorld {
    /// Adds these sensors, each with the errors of its `[[simulated.sensor]]`; without one, the sensor is
    /// ideal.
    ///
    /// # Errors
    /// Two sensors have the same name, a `[[simulated.sensor]]` names no sensor, or a number is impossible for
    /// a sensor.
    pub fn with_sensors(mut self, sensors: &[Sensor]) -> Result<Self, SimulatedWorldError> {
        let count_of_name = |name: &str| sensors.iter().filter(|sensor| sensor.name == name).count();
        if let Some(unknown) = self.sensor_truths.iter().find(|truth| count_of_name(&truth.name) == 0) {
            return Err(SimulatedWorldError::UnknownSensor { name: unknown.name.clone() });
        }
        if let Some(duplicate) = sensors.iter().find(|sensor| count_of_name(&sensor.name) > 1) {
            return Err(SimulatedWorldError::DuplicateSensor { name: duplicate.name.clone() });
        }
        let sensor = |(number, sensor): (usize, &Sensor)| {
            let mut truths = self.sensor_truths.iter().filter(|truth| truth.name == sensor.name);
            let truth = truths.next().cloned().unwrap_or_default();
            if truths.next().is_some() {
                return Err(SimulatedWorldError::DuplicateSensor { name: sensor.name.clone() });
            }
            let clock = SampleClock::new(&truth);
            let beam = Beam::new(sensor, truth, self.seed, number)?;
            Ok(SimulatedSensor { name: sensor.name.clone(), mount: sensor.mount, beam, clock, sample_count: 0 })
        };
        self.sensors = sensors.iter().enumerate().map(sensor).collect::<Result<_, _>>()?;
        Ok(self)
    }

    /// Lets `after_s` pass by the clock of the sensor `name`, then returns its sample at the axis positions,
    /// which are earlier ones if the sensor has a latency. `None`: there is no such sensor.
    pub fn sample_after(&mut self, name: &str, after_s: f64) -> Option<SensorOutput> {
        let number = self.sensors.iter().position(|sensor| sensor.name == name)?;
        let elapsed_s = self.time_to_next_sample_s(number, after_s)?;
        self.dwell(elapsed_s);
        self.sensor_output(number, self.t_s)
    }

    /// Sample of the sensor `name` at `t_s`, which is not later than now, and the axis positions at that time.
    /// `None`: there is no such sensor.
    pub fn sample_at(&mut self, name: &str, t_s: f64) -> Option<SampleInMotion> {
        let number = self.sensors.iter().position(|sensor| sensor.name == name)?;
        let position = match self.motion_history.path_at(t_s) {
            Some((path, along)) => self.displayed_position(&path.command(along)),
            None => self.position(),
        };
        Some(SampleInMotion { position, t_s, output: self.sensor_output(number, t_s)? })
    }

    /// Makes a straight, unguarded move of the axes named in `to`, during which the sensor `name` samples every
    /// `period_s` by its clock.
    pub fn sample_during_move(
        &mut self,
        name: &str,
        to: &Position,
        speed: Speed,
        period_s: f64,
    ) -> Vec<SampleInMotion> {
        let number = self.sensors.iter().position(|sensor| sensor.name == name);
        let (Some(number), Some(path)) = (number, self.path(to, speed)) else { return Vec::new() };
        let (start_s, lasts_s) = (self.t_s, path.ramp().duration_s());
        self.motion_history.record_move(start_s, &path, 1.0);
        let (mut samples, mut t_s) = (Vec::new(), start_s);
        while let Some(elapsed_s) = self.time_to_next_sample_s(number, period_s) {
            t_s += elapsed_s;
            if t_s > start_s + lasts_s || elapsed_s <= 0.0 {
                break;
            }
            let Some(sample) = self.sample_at(name, t_s) else { break };
            samples.push(sample);
        }
        self.set_stop_position(&path, 1.0, lasts_s);
        samples
    }

    /// True time until the next sample.
    fn time_to_next_sample_s(&mut self, number: usize, after_s: f64) -> Option<f64> {
        let sensor = self.sensors.get_mut(number)?;
        let deviate = random_draws::draw_sample_delay(self.seed, number, sensor.sample_count);
        Some(sensor.clock.time_until_sample_s(after_s, deviate))
    }

    fn sensor_output(&mut self, number: usize, t_s: f64) -> Option<SensorOutput> {
        let measured_s = t_s - self.sensors.get(number)?.clock.latency_s;
        let (axes, command) = match self.motion_history.path_at(measured_s) {
            Some((path, along)) => self.true_positions_on_path(path, along),
            None => (self.true_axes(), self.true_wiring.true_position(self.command.clone())),
        };
        let view = match self.sensors.get(number)?.mount {
            SensorMount::Bed => self.scene.view_from_bed(&axes, measured_s),
            SensorMount::Table => self.scene.view_from_table(&axes, &command, measured_s),
            SensorMount::Spindle => self.scene.view_from_spindle(&axes, &command, measured_s),
        };
        let sensor = self.sensors.get_mut(number)?;
        let deviate = random_draws::draw_sample_noise(self.seed, number, sensor.sample_count);
        sensor.sample_count += 1;
        Some(sensor.beam.output(&view, deviate))
    }
}
