//! Displacement sensors in the spindle, on the table or on the bed.

use super::beam::{Beam, SensorOutput};
use super::random_draws::{RandomSource, draw_normal};
use super::sensor_truth::SensorTruth;
use super::{SimulatedWorld, SimulatedWorldError};
use machine::record::sensor::{Sensor, SensorMount};

/// One sensor, its sample clock, and the index of its next sample for the random draws.
#[derive(Debug, Clone)]
pub(super) struct SimulatedSensor {
    name: String,
    mount: SensorMount,
    beam: Beam,
    clock: SampleClock,
    next_sample_index: u64,
}

/// Sampling times, by the sensor's own clock.
#[derive(Debug, Clone)]
struct SampleClock {
    /// True duration, s, of a second of the sensor's clock.
    second_duration_s: f64,
    jitter_std_dev_s: f64,
    /// Delay of the last sample relative to the regular times of the sensor's clock (jitter), s.
    last_jitter_s: f64,
    /// Latency: each output belongs to a moment this much earlier.
    latency_s: f64,
}

impl SampleClock {
    fn new(truth: &SensorTruth) -> Self {
        let second_duration_s = 1.0 + truth.clock_slow_ppm * 1e-6;
        let (jitter_s, latency_s) = (truth.clock_jitter_us * 1e-6, truth.clock_late_ms * 1e-3);
        Self { second_duration_s, jitter_std_dev_s: jitter_s, last_jitter_s: 0.0, latency_s }
    }

    /// True time until the sample that comes `after_s` later by the sensor's clock. `deviate`: jitter in standard
    /// deviations. The jitter of one sample does not shift the next one.
    fn time_until_sample_s(&mut self, after_s: f64, deviate: f64) -> f64 {
        let before = std::mem::replace(&mut self.last_jitter_s, self.jitter_std_dev_s * deviate);
        after_s * self.second_duration_s + self.last_jitter_s - before
    }
}

impl SimulatedSensor {
    /// Advances the sample index to the time `t_s`, so that no noise value repeats.
    pub fn advance_sample_index_to_time(&mut self, t_s: f64) {
        self.next_sample_index = self.next_sample_index.max((t_s * SAMPLE_INDEX_RATE_HZ) as u64);
    }
}

/// Rate at which the sample index advances with world time. Assumption: no sensor samples faster.
const SAMPLE_INDEX_RATE_HZ: f64 = 1e6;

impl SimulatedWorld {
    /// Adds these sensors, each with the errors of its `[[simulated.sensor]]`, and with the drawn errors that its
    /// `[[sensor]]` declares by magnitude; without such a table, the values of `SensorTruth::default` apply.
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
            Ok(SimulatedSensor { name: sensor.name.clone(), mount: sensor.mount, beam, clock, next_sample_index: 0 })
        };
        self.sensors = sensors.iter().enumerate().map(sensor).collect::<Result<_, _>>()?;
        Ok(self)
    }

    /// Lets `after_s` pass by the clock of the sensor `name`, then returns its sample. If the sensor has a latency, the
    /// sample belongs to the earlier axis positions. `None`: there is no such sensor.
    pub fn sample_after(&mut self, name: &str, after_s: f64) -> Option<SensorOutput> {
        let number = self.sensor_index(name)?;
        let elapsed_s = self.time_to_next_sample_s(number, after_s)?;
        self.dwell(elapsed_s);
        self.sensor_output(number, self.simulated_time_s)
    }

    /// Index of the sensor `name`.
    pub(super) fn sensor_index(&self, name: &str) -> Option<usize> {
        self.sensors.iter().position(|sensor| sensor.name == name)
    }

    /// True time until the sample that comes `after_s` later by the sensor's clock. `None`: there is no such sensor.
    pub(super) fn time_to_next_sample_s(&mut self, sensor_index: usize, after_s: f64) -> Option<f64> {
        let sensor = self.sensors.get_mut(sensor_index)?;
        let key = [sensor_index as u64, sensor.next_sample_index];
        let deviate = draw_normal(self.seed, RandomSource::SampleJitter, &key);
        Some(sensor.clock.time_until_sample_s(after_s, deviate))
    }

    /// Takes the sample that the sensor outputs at `t_s`: it was measured one latency earlier. Simulated time does
    /// not advance. `None`: there is no such sensor.
    pub(super) fn sensor_output(&mut self, sensor_index: usize, t_s: f64) -> Option<SensorOutput> {
        let measured_s = t_s - self.sensors.get(sensor_index)?.clock.latency_s;
        let (axes, command) = match self.motion_history.path_and_fraction_at(measured_s) {
            Some((path, along)) => self.true_positions_with_and_without_lost_motion(path, along),
            None => (self.true_axis_positions(), self.true_wiring.true_position(self.commanded_position.clone())),
        };
        let view = match self.sensors.get(sensor_index)?.mount {
            SensorMount::Bed => self.scene.view_from_bed(&axes, measured_s),
            SensorMount::Table => self.scene.view_from_table(&axes, &command, measured_s),
            SensorMount::Spindle => self.scene.view_from_spindle(&axes, &command, measured_s),
        };
        let sensor = self.sensors.get_mut(sensor_index)?;
        let key = [sensor_index as u64, sensor.next_sample_index];
        let deviate = draw_normal(self.seed, RandomSource::SampleNoise, &key);
        sensor.next_sample_index += 1;
        Some(sensor.beam.output(&view, deviate))
    }
}
