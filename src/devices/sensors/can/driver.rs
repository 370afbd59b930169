//! CanDriver: samples from the frames of one CAN identifier.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::CanConfig;
use super::bus_state::BusState;
use crate::sensors::counter_tracker::CounterTracker;
use crate::sensors::frame_layout::FrameLayout;
use crate::sensors::{
    MAX_RATE_MEASUREMENT_SAMPLES, OpenSensorFuture, RATE_MEASUREMENT_TIME, Sample, SensorConfig, SensorDriver,
    SensorError, SensorHandle, SensorInfo,
};
use link::can::{CanEvent, CanFrame, CanId, CanReceiver};
use link::{Clock, SharedPorts};
use machine::record::reading::ReadingFlag;
use machine::record::sensor;

/// Time to wait for the first frame if `timeout_s` is shorter: a sensor that was just switched on may need it.
const FIRST_FRAME_WAIT_FLOOR: Duration = Duration::from_secs(1);

/// Driver that decodes the frames of one identifier to samples.
pub(super) struct CanDriver {
    receiver: CanReceiver,
    id: CanId,
    layout: FrameLayout,
    /// Measuring range of the sensor, from the machine file: values beyond it are flagged.
    range_mm: [f64; 2],
    /// Maximum time between two frames; a longer silence gives a stale sample.
    silence_timeout: Duration,
    clock: Arc<dyn Clock>,
    counter_tracker: CounterTracker,
    /// Time before which received frames are ignored, s.
    ignored_before_s: f64,
    bus_state: BusState,
    /// Keeps the simulator alive that sends the frames of the sensor.
    _simulator: Option<Arc<()>>,
}

impl CanDriver {
    pub(super) fn new(config: &CanConfig, can: CanReceiver, range_mm: [f64; 2], clock: Arc<dyn Clock>) -> Self {
        Self {
            receiver: can,
            id: config.id,
            layout: config.layout.clone(),
            range_mm,
            silence_timeout: config.silence_timeout,
            clock,
            counter_tracker: CounterTracker::new(config.layout.sample_layout.counter_modulus()),
            ignored_before_s: f64::NEG_INFINITY,
            bus_state: BusState::default(),
            _simulator: None,
        }
    }

    /// Decodes a frame to a sample with the frame's time; a frame that does not contain all fields is an error.
    fn decode_frame(&mut self, frame: &CanFrame) -> Result<Sample, SensorError> {
        let decoded = self.layout.decode(frame.data()).map_err(|short| SensorError::InvalidData {
            text: format!("{short} (id {} on {})", self.id, self.receiver.name()),
            remedy: "compare `id`, `length` and the layout of [sensor.can] with the sensor's manual".to_owned(),
        })?;
        Ok(self.counter_tracker.complete_sample(frame.received_s, decoded.flag_out_of_range(self.range_mm)))
    }

    /// Waits for the first sample. The wait has a deadline, because a bus that reports only errors is never silent.
    async fn wait_for_first_sample(&mut self) -> Result<Sample, SensorError> {
        let wait = self.silence_timeout.max(FIRST_FRAME_WAIT_FLOOR);
        let deadline = Instant::now() + wait;
        loop {
            let remaining = deadline.saturating_duration_since(Instant::now());
            match self.receiver.next_event(remaining).await? {
                Some(CanEvent::Frame(frame)) => {
                    self.bus_state.clear();
                    return self.decode_frame(&frame);
                }
                Some(event) if !remaining.is_zero() => self.bus_state.record_event(event),
                _ => break,
            }
        }
        Err(self.silence_error(wait))
    }

    /// Error after `silence` without a frame: the fault of the bus if one is known, otherwise `Silent`.
    fn silence_error(&self, silence: Duration) -> SensorError {
        let fault = self.bus_state.fault(self.receiver.name(), self.id);
        fault.map_or(SensorError::Silent { seconds: silence.as_secs_f64() }, SensorError::from)
    }

    /// Receives samples for [`RATE_MEASUREMENT_TIME`], up to [`MAX_RATE_MEASUREMENT_SAMPLES`] or until the sensor is
    /// silent. Returns the number of sample intervals since `first` (missing samples are counted), and the time from
    /// `first` to the last sample, s.
    async fn count_intervals_and_span_s(&mut self, first: Sample) -> Result<(usize, f64), SensorError> {
        let (mut last, mut steps, mut unchanged_count) = (first.received_s, 0, 0);
        while steps.max(unchanged_count) < MAX_RATE_MEASUREMENT_SAMPLES
            && last - first.received_s < RATE_MEASUREMENT_TIME.as_secs_f64()
        {
            let Sample { received_s: t_s, flag, lost_before_count: missing, .. } = self.next().await?;
            if self.counter_tracker.is_count_unchanged() {
                unchanged_count += 1;
            } else if flag == ReadingFlag::Stale {
                break;
            } else {
                (last, steps) = (t_s, steps + 1 + missing as usize);
            }
        }
        if steps == 0 && unchanged_count > 0 {
            return Err(SensorError::CounterFrozen);
        }
        Ok((steps, last - first.received_s))
    }
}

impl SensorDriver for CanDriver {
    async fn prepare(&mut self) -> Result<SensorInfo, SensorError> {
        self.discard_old_samples().await?;
        let first = self.wait_for_first_sample().await?;
        let (steps, span_s) = self.count_intervals_and_span_s(first).await?;
        if span_s <= 0.0 {
            return Err(self.silence_error(self.silence_timeout));
        }
        let identity = format!("frames {} on {}", self.id, self.receiver.name());
        Ok(SensorInfo { identity, sample_rate_hz: steps as f64 / span_s })
    }

    fn unrequested_count(&self) -> u64 {
        self.counter_tracker.unrequested_count()
    }

    async fn discard_old_samples(&mut self) -> Result<(), SensorError> {
        if !self.receiver.generates_frames_on_demand() {
            // The kernel may still hold earlier frames.
            self.ignored_before_s = self.clock.now_s();
            while let Some(event) = self.receiver.try_next_event()? {
                self.bus_state.record_event(event);
            }
        }
        self.counter_tracker.ignore_next_gap();
        Ok(())
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        let deadline = Instant::now() + self.silence_timeout;
        loop {
            let remaining = deadline.saturating_duration_since(Instant::now());
            match self.receiver.next_event(remaining).await? {
                None => return Ok(Sample::stale(self.clock.now_s())),
                Some(CanEvent::Frame(frame)) if frame.received_s < self.ignored_before_s => {}
                Some(CanEvent::Frame(frame)) => {
                    self.bus_state.clear();
                    return self.decode_frame(&frame);
                }
                Some(event @ (CanEvent::InterfaceDown(_) | CanEvent::BusOff(_))) => {
                    self.bus_state.record_event(event);
                    self.counter_tracker.mark_data_lost();
                    return Ok(Sample::stale(self.clock.now_s()));
                }
                Some(event @ (CanEvent::InterfaceUp | CanEvent::LostFrames(_))) => {
                    self.bus_state.record_event(event);
                    self.counter_tracker.mark_data_lost();
                }
                // The sender repeats a frame that the controller could not read; the counter shows any
                // other loss.
                Some(event) => self.bus_state.record_event(event),
            }
        }
    }

    fn is_simulated_on_demand(&self) -> bool {
        self.receiver.generates_frames_on_demand()
    }
}

impl SensorConfig for CanConfig {
    fn describe_address(&self) -> String {
        format!("frames {} on CAN interface {}", self.id, self.interface)
    }

    fn encoder_modulus(&self) -> Option<u64> {
        self.layout.sample_layout.encoder_modulus()
    }

    /// The kernel gives each listener its own copy of a frame, so no port is shared.
    fn open_sensor<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        _: &'a SharedPorts,
    ) -> OpenSensorFuture<'a> {
        Box::pin(async move {
            let can = self.open_bus(clock.clone())?;
            Ok(self.spawn_sensor(can, sensor, clock, None))
        })
    }
}

impl CanConfig {
    /// Starts the task of a sensor that receives its frames from `can`. `simulator` is kept alive as long as the task.
    /// Call inside a tokio runtime.
    pub fn spawn_sensor(
        &self,
        can: CanReceiver,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        simulator: Option<Arc<()>>,
    ) -> SensorHandle {
        let driver = CanDriver { _simulator: simulator, ..CanDriver::new(self, can, sensor.range_mm, clock) };
        SensorHandle::spawn(sensor.name.as_str(), driver)
    }
}
