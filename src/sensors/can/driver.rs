//! One sample after the other from the frames of one identifier.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::Config;
use crate::base::Clock;
use crate::link::can::{Can, CanError, Frame, Heard, Id};
use crate::record::reading::Flag;
use crate::sensors::follow::Counting;
use crate::sensors::layout::Layout;
use crate::sensors::{Driver as Seam, Prepared, Sample, SensorError};

/// How many samples, and how long, are enough to know its rate.
const ENOUGH: usize = 50;
const LISTEN_S: f64 = 0.5;
/// A sensor that is switched on says something within this.
const PATIENCE: Duration = Duration::from_secs(1);

pub(super) struct Driver {
    can: Can,
    id: Id,
    layout: Layout,
    range_mm: [f64; 2],
    timeout: Duration,
    clock: Arc<dyn Clock>,
    counting: Counting,
    /// What was received before is not wanted.
    since_s: f64,
    /// What the bus said last of its errors.
    trouble: Option<String>,
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
        let counting = Counting::new(layout.counter_width().map(|width| 1 << width));
        let since_s = f64::NEG_INFINITY;
        let (trouble, _served) = (None, None);
        Self { can, id, layout, range_mm, timeout, clock, counting, since_s, trouble, _served }
    }

    /// Keeps what serves it.
    pub(super) fn beside(self, served: Option<Arc<()>>) -> Self {
        Self { _served: served, ..self }
    }

    fn read(&mut self, frame: &Frame) -> Result<Sample, SensorError> {
        let decoded = self.layout.decode(frame.data()).map_err(|short| SensorError::Strange {
            text: format!("{short} (id {} on {})", self.id, self.can.name()),
            remedy:
                "compare `id`, `length` and the layout of [sensor.can] with the sensor's manual"
                    .to_owned(),
        })?;
        Ok(self.counting.follow(frame.t_s, decoded.within(self.range_mm)))
    }

    fn nothing(&self) -> Sample {
        Sample { t_s: self.clock.now_s(), value_mm: None, flag: Flag::Stale, missing: 0 }
    }

    /// The first sign of life.
    async fn first(&mut self) -> Result<Sample, SensorError> {
        let mut down = None;
        let wait = self.timeout.max(PATIENCE);
        loop {
            match self.can.next(wait).await? {
                Some(Heard::Frame(frame)) => return self.read(&frame),
                Some(Heard::Down(why)) => down = Some(why),
                Some(Heard::Up) => down = None,
                Some(Heard::Lost(_)) => {}
                // A bus with errors alone is never silent.
                Some(Heard::Trouble(why)) => {
                    if self.trouble.replace(why).is_some() && down.is_none() {
                        break;
                    }
                }
                None => break,
            }
        }
        let interface = self.can.name().to_owned();
        Err(match (down, self.trouble.take()) {
            (Some(why), _) => CanError::Down { interface, why }.into(),
            (None, Some(why)) => {
                CanError::Trouble { interface, id: self.id.to_string(), why }.into()
            }
            (None, None) => SensorError::Silent { seconds: wait.as_secs_f64() },
        })
    }
}

impl Seam for Driver {
    async fn prepare(&mut self) -> Result<Prepared, SensorError> {
        self.forget().await?;
        self.trouble = None;
        let first = self.first().await?;
        let (mut last, mut steps) = (first.t_s, 0);
        while steps < ENOUGH && last - first.t_s < LISTEN_S {
            let Sample { t_s, flag, missing, .. } = self.next().await?;
            if flag == Flag::Stale {
                break;
            }
            (last, steps) = (t_s, steps + 1 + missing as usize);
        }
        let span_s = last - first.t_s;
        if span_s <= 0.0 {
            return Err(SensorError::Silent { seconds: self.timeout.as_secs_f64() });
        }
        let identity = format!("frames {} on {}", self.id, self.can.name());
        Ok(Prepared { identity, rate_hz: steps as f64 / span_s })
    }

    async fn forget(&mut self) -> Result<(), SensorError> {
        if !self.can.is_on_demand() {
            // The kernel may still hold some of what came before.
            self.since_s = self.clock.now_s();
            while self.can.waiting()?.is_some() {}
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
                Some(Heard::Frame(frame)) if frame.t_s < self.since_s => {}
                Some(Heard::Frame(frame)) => return self.read(&frame),
                Some(Heard::Down(_)) => {
                    self.counting.interrupted();
                    return Ok(self.nothing());
                }
                Some(Heard::Up | Heard::Lost(_)) => self.counting.interrupted(),
                // Frames that a controller could not read do not come; the counter tells.
                Some(Heard::Trouble(why)) => self.trouble = Some(why),
            }
        }
    }

    fn on_demand(&self) -> bool {
        self.can.is_on_demand()
    }
}
