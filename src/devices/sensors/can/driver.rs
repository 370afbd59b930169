//! CanDriver: samples from the frames of one CAN identifier.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::CanConfig;
use super::bus::BusState;
use crate::sensors::counter_tracker::CounterTracker;
use crate::sensors::frame_layout::FrameLayout;
use crate::sensors::{
    MAX_RATE_SAMPLES, OpenFuture, RATE_WINDOW, Sample, Sensor, SensorConfig, SensorDriver, SensorError, SensorInfo,
};
use link::can::{CanEvent, CanFrame, CanId, CanReceiver};
use link::{Clock, SharedPorts};
use machine::record::reading::ReadingFlag;
use machine::record::sensor;

/// Maximum time until a sensor that is switched on sends its first frame.
const FIRST_FRAME_TIMEOUT: Duration = Duration::from_secs(1);

pub(super) struct CanDriver {
    can: CanReceiver,
    id: CanId,
    layout: FrameLayout,
    range_mm: [f64; 2],
    timeout: Duration,
    clock: Arc<dyn Clock>,
    counter: CounterTracker,
    /// Time before which received frames are ignored, s.
    ignored_before_s: f64,
    bus: BusState,
    /// The simulator on which the sensor depends.
    _simulator: Option<Arc<()>>,
}

impl CanDriver {
    pub(super) fn new(config: &CanConfig, can: CanReceiver, range_mm: [f64; 2], clock: Arc<dyn Clock>) -> Self {
        let CanConfig { id, layout, timeout, .. } = config.clone();
        let counter = CounterTracker::new(layout.sample.counter_modulus());
        let ignored_before_s = f64::NEG_INFINITY;
        let (bus, _simulator) = (BusState::default(), None);
        Self { can, id, layout, range_mm, timeout, clock, counter, ignored_before_s, bus, _simulator }
    }

    fn decode_frame(&mut self, frame: &CanFrame) -> Result<Sample, SensorError> {
        let decoded = self.layout.decode(frame.data()).map_err(|short| SensorError::InvalidData {
            text: format!("{short} (id {} on {})", self.id, self.can.name()),
            remedy: "compare `id`, `length` and the layout of [sensor.can] with the sensor's manual".to_owned(),
        })?;
        Ok(self.counter.complete_sample(frame.t_s, decoded.flag_out_of_range(self.range_mm)))
    }

    /// Waits for the first sample. A bus that reports only errors is never silent, so the wait has a
    /// deadline.
    async fn first_sample(&mut self) -> Result<Sample, SensorError> {
        let wait = self.timeout.max(FIRST_FRAME_TIMEOUT);
        let deadline = Instant::now() + wait;
        loop {
            let remaining = deadline.saturating_duration_since(Instant::now());
            match self.can.next_event(remaining).await? {
                Some(CanEvent::Frame(frame)) => {
                    self.bus.clear();
                    return self.decode_frame(&frame);
                }
                Some(event) if !remaining.is_zero() => self.bus.record_event(event),
                _ => break,
            }
        }
        Err(self.silence_error(wait))
    }

    /// Error without a frame for `silence`: the fault of the bus, if one is known.
    fn silence_error(&self, silence: Duration) -> SensorError {
        let fault = self.bus.fault(self.can.name(), self.id);
        fault.map_or(SensorError::Silent { seconds: silence.as_secs_f64() }, SensorError::from)
    }

    /// Receives samples until there are enough to determine their rate; returns their number, and how long
    /// they took, s.
    async fn measure_rate(&mut self, first: Sample) -> Result<(usize, f64), SensorError> {
        let (mut last, mut steps, mut unchanged_count) = (first.t_s, 0, 0);
        while steps.max(unchanged_count) < MAX_RATE_SAMPLES && last - first.t_s < RATE_WINDOW.as_secs_f64() {
            let Sample { t_s, flag, missing_count: missing, .. } = self.next().await?;
            if self.counter.is_unchanged() {
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
        Ok((steps, last - first.t_s))
    }
}

impl SensorDriver for CanDriver {
    async fn prepare(&mut self) -> Result<SensorInfo, SensorError> {
        self.discard_old_samples().await?;
        let first = self.first_sample().await?;
        let (steps, span_s) = self.measure_rate(first).await?;
        if span_s <= 0.0 {
            return Err(self.silence_error(self.timeout));
        }
        let identity = format!("frames {} on {}", self.id, self.can.name());
        Ok(SensorInfo { identity, rate_hz: steps as f64 / span_s })
    }

    fn unrequested_count(&self) -> u64 {
        self.counter.unrequested_count()
    }

    async fn discard_old_samples(&mut self) -> Result<(), SensorError> {
        if !self.can.is_on_demand() {
            // The kernel may still hold earlier frames.
            self.ignored_before_s = self.clock.now_s();
            while let Some(event) = self.can.try_next_event()? {
                self.bus.record_event(event);
            }
        }
        self.counter.skip_gap();
        Ok(())
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        let deadline = Instant::now() + self.timeout;
        loop {
            let remaining = deadline.saturating_duration_since(Instant::now());
            match self.can.next_event(remaining).await? {
                None => return Ok(Sample::stale(self.clock.now_s())),
                Some(CanEvent::Frame(frame)) if frame.t_s < self.ignored_before_s => {}
                Some(CanEvent::Frame(frame)) => {
                    self.bus.clear();
                    return self.decode_frame(&frame);
                }
                Some(event @ (CanEvent::Down(_) | CanEvent::BusOff(_))) => {
                    self.bus.record_event(event);
                    self.counter.mark_data_lost();
                    return Ok(Sample::stale(self.clock.now_s()));
                }
                Some(event @ (CanEvent::Up | CanEvent::LostFrames(_))) => {
                    self.bus.record_event(event);
                    self.counter.mark_data_lost();
                }
                // A frame that the controller could not read is sent again; the counter shows any other
                // loss.
                Some(event) => self.bus.record_event(event),
            }
        }
    }

    fn is_on_demand(&self) -> bool {
        self.can.is_on_demand()
    }
}

impl SensorConfig for CanConfig {
    fn describe_address(&self) -> String {
        format!("frames {} on CAN interface {}", self.id, self.interface)
    }

    fn encoder_modulus(&self) -> Option<u64> {
        self.layout.sample.encoder_modulus()
    }

    /// The kernel gives each listener its own copy of a frame, so no port is shared.
    fn open_sensor<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        _: &'a SharedPorts,
    ) -> OpenFuture<'a> {
        Box::pin(async move {
            let can = self.open_bus(clock.clone())?;
            Ok(self.spawn_sensor(can, sensor, clock, None))
        })
    }
}

impl CanConfig {
    /// Creates the sensor with frames from `can`; `simulator` is kept as long as the sensor exists. Call
    /// inside a tokio runtime.
    pub fn spawn_sensor(
        &self,
        can: CanReceiver,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        simulator: Option<Arc<()>>,
    ) -> Sensor {
        let driver = CanDriver { _simulator: simulator, ..CanDriver::new(self, can, sensor.range_mm, clock) };
        Sensor::spawn(sensor.name.as_str(), driver)
    }
}
