//! From frames to samples: follows the sensor's counter, so that what is missing is known and what
//! came before is not taken twice. Common to whatever sends frames.

use super::Sample;
use super::layout::{Decoded, Layout, Short};
use crate::record::reading::Flag;

pub struct Follower {
    layout: Layout,
    /// Of the frame before.
    count: Option<u64>,
    /// Something was lost since the last frame, and no counter says how much.
    broken: bool,
    /// Nobody asked for what lies between the last frame and the next.
    fresh: bool,
}

enum Step {
    On { missing: u32 },
    Stands,
}

impl Follower {
    pub fn new(layout: Layout) -> Self {
        Self { layout, count: None, broken: false, fresh: true }
    }

    /// Frames may be missing before the next one.
    pub fn interrupted(&mut self) {
        self.broken = true;
    }

    /// What lies between the last frame and the next is not missed. A count that still stands is.
    pub fn forget(&mut self) {
        (self.broken, self.fresh) = (false, true);
    }

    /// # Errors
    /// A frame that is too short for the layout.
    pub fn sample(&mut self, t_s: f64, frame: &[u8]) -> Result<Sample, Short> {
        let Decoded { value, counter } = self.layout.decode(frame)?;
        let step = match counter {
            Some(count) => self.step(count),
            None => Step::On { missing: 0 },
        };
        let Step::On { missing } = step else {
            return Ok(Sample { t_s, value_mm: None, flag: Flag::Stale, missing: 0 });
        };
        let broken = std::mem::take(&mut self.broken) || missing > 0;
        Ok(match value {
            Ok(mm) => {
                let flag = if broken { Flag::Gap } else { Flag::None };
                Sample { t_s, value_mm: Some(mm), flag, missing }
            }
            Err(flag) => Sample { t_s, value_mm: None, flag, missing },
        })
    }

    fn step(&mut self, count: u64) -> Step {
        let fresh = std::mem::take(&mut self.fresh);
        let Some(last) = self.count.replace(count) else { return Step::On { missing: 0 } };
        let round = 1_u64 << self.layout.counter_width().unwrap_or_default();
        match (round + count - last) % round {
            // After an interruption it may have gone round.
            0 if !self.broken => Step::Stands,
            0 => Step::On { missing: 0 },
            _ if fresh => Step::On { missing: 0 },
            on => Step::On { missing: u32::try_from(on - 1).unwrap_or(u32::MAX) },
        }
    }
}
