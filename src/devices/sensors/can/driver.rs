//! Driver: samples from the frames of one CAN identifier.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::Config;
use super::bus::Bus;
use crate::sensors::follow::CounterTracker;
use crate::sensors::layout::Layout;
use crate::sensors::{Driver as Seam, Named, Opening, Prepared, Sample, Sensor, SensorError};
use link::can::{Can, CanEvent, Frame, Id};
use link::{Clock, SharedPorts};
use machine::record::reading::Flag;
use machine::record::sensor;

/// Number of samples that is enough to determine the rate. `LISTEN_S`: time that is enough, s.
const ENOUGH: usize = 50;
const LISTEN_S: f64 = 0.5;
/// Maximum time until a sensor that is switched on sends its first frame.
const PATIENCE: Duration = Duration::from_secs(1);

pub(super) struct Driver {
    can: Can,
    id: Id,
    layout: Layout,
    range_mm: [f64; 2],
    timeout: Duration,
    clock: Arc<dyn Clock>,
    counting: CounterTracker,
    /// Time before which received frames are ignored, s.
    since_s: f64,
    bus: Bus,
    _served: Option<Arc<()>>,
}

impl Driver {
    pub(super) fn new(
        config: &Config,
        can: Can,
        range_mm: [f64; 2],
        clock: Arc<dyn Clock>,
    ) -> Self {
        let Config { id, layout, timeout, .. } = config.clone();
        let counting = CounterTracker::new(layout.counter_width().map(|width| 1 << width));
        let since_s = f64::NEG_INFINITY;
        let (bus, _served) = (Bus::default(), None);
        Self { can, id, layout, range_mm, timeout, clock, counting, since_s, bus, _served }
    }

    /// Keeps `served`, on which the sensor depends, as long as the driver lives.
    pub(super) fn beside(self, served: Option<Arc<()>>) -> Self {
        Self { _served: served, ..self }
    }

    fn read(&mut self, frame: &Frame) -> Result<Sample, SensorError> {
        let decoded =
            self.layout.decode(frame.data()).map_err(|short| SensorError::UnexpectedDevice {
                text: format!("{short} (id {} on {})", self.id, self.can.name()),
                remedy:
                    "compare `id`, `length` and the layout of [sensor.can] with the sensor's manual"
                        .to_owned(),
            })?;
        Ok(self.counting.follow(frame.t_s, decoded.within(self.range_mm)))
    }

    fn nothing(&self) -> Sample {
        Sample::stale(self.clock.now_s())
    }

    /// Waits for the first sample. A bus that reports only errors is never silent, so the wait has a
    /// deadline.
    async fn first(&mut self) -> Result<Sample, SensorError> {
        let wait = self.timeout.max(PATIENCE);
        let deadline = Instant::now() + wait;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.can.next(left).await? {
                Some(CanEvent::Frame(frame)) => {
                    self.bus.speaks();
                    return self.read(&frame);
                }
                Some(other) if !left.is_zero() => self.bus.hears(other),
                _ => break,
            }
        }
        let ails = self.bus.ails(self.can.name(), self.id);
        Err(ails.map_or(SensorError::Silent { seconds: wait.as_secs_f64() }, SensorError::from))
    }

    /// Receives samples until there are enough to determine their rate; returns their number, and how long
    /// they took, s.
    async fn listen(&mut self, first: Sample) -> Result<(usize, f64), SensorError> {
        let (mut last, mut steps, mut stood) = (first.t_s, 0, 0);
        while steps < ENOUGH && stood < ENOUGH && last - first.t_s < LISTEN_S {
            let Sample { t_s, flag, missing, .. } = self.next().await?;
            if self.counting.stands() {
                stood += 1;
            } else if flag == Flag::Stale {
                break;
            } else {
                (last, steps) = (t_s, steps + 1 + missing as usize);
            }
        }
        if steps == 0 && stood > 0 {
            return Err(SensorError::Stands);
        }
        Ok((steps, last - first.t_s))
    }
}

impl Seam for Driver {
    async fn prepare(&mut self) -> Result<Prepared, SensorError> {
        self.forget().await?;
        let first = self.first().await?;
        let (steps, span_s) = self.listen(first).await?;
        if span_s <= 0.0 {
            let ails = self.bus.ails(self.can.name(), self.id).map(SensorError::from);
            let seconds = self.timeout.as_secs_f64();
            return Err(ails.unwrap_or(SensorError::Silent { seconds }));
        }
        let identity = format!("frames {} on {}", self.id, self.can.name());
        Ok(Prepared { identity, rate_hz: steps as f64 / span_s })
    }

    fn passed_over(&self) -> u64 {
        self.counting.passed_over()
    }

    async fn forget(&mut self) -> Result<(), SensorError> {
        if !self.can.is_on_demand() {
            // The kernel may still hold earlier frames.
            self.since_s = self.clock.now_s();
            while let Some(heard) = self.can.waiting()? {
                self.bus.hears(heard);
            }
        }
        self.counting.forget();
        Ok(())
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        let deadline = Instant::now() + self.timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.can.next(left).await? {
                None => return Ok(self.nothing()),
                Some(CanEvent::Frame(frame)) if frame.t_s < self.since_s => {}
                Some(CanEvent::Frame(frame)) => {
                    self.bus.speaks();
                    return self.read(&frame);
                }
                Some(heard @ (CanEvent::Down(_) | CanEvent::Off(_))) => {
                    self.bus.hears(heard);
                    self.counting.interrupted();
                    return Ok(self.nothing());
                }
                Some(heard @ (CanEvent::Up | CanEvent::Lost(_))) => {
                    self.bus.hears(heard);
                    self.counting.interrupted();
                }
                // A frame that the controller could not read is sent again; the counter shows any other
                // loss.
                Some(heard) => self.bus.hears(heard),
            }
        }
    }

    fn on_demand(&self) -> bool {
        self.can.is_on_demand()
    }
}

impl Named for Config {
    fn at(&self) -> String {
        format!("frames {} on CAN interface {}", self.id, self.interface)
    }

    fn encoder_round(&self) -> Option<u64> {
        self.layout.encoder_round()
    }

    /// The kernel gives each listener its own copy of a frame, so no port is shared.
    fn open<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        _: &'a SharedPorts,
    ) -> Opening<'a> {
        Box::pin(async move {
            let can = self.listen(clock.clone())?;
            Ok(self.over(can, sensor, clock, None))
        })
    }
}

impl Config {
    /// Creates the sensor with frames from `can`; `served` is kept as long as the sensor exists. Call
    /// inside a tokio runtime.
    pub fn over(
        &self,
        can: Can,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
        served: Option<Arc<()>>,
    ) -> Sensor {
        let driver = Driver::new(self, can, sensor.range_mm, clock);
        Sensor::spawn(sensor.name.clone(), driver.beside(served))
    }
}
