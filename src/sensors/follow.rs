//! From frames to samples: follows the sensor's counter, so that what is missing is known and what
//! came before is not taken twice. Common to whatever sends frames.

use super::Sample;
use super::layout::Decoded;
use crate::record::reading::Flag;

pub struct Follower {
    /// After so many samples the counter begins anew.
    round: Option<u64>,
    /// Of the frame before.
    count: Option<u64>,
    /// Something was lost since the last frame, and no counter says how much.
    broken: bool,
}

enum Step {
    On { missing: u32 },
    Stands,
}

impl Follower {
    pub fn new(round: Option<u64>) -> Self {
        Self { round, count: None, broken: false }
    }

    /// Frames may be missing before the next one.
    pub fn interrupted(&mut self) {
        self.broken = true;
    }

    /// What comes next is the first.
    pub fn forget(&mut self) {
        (self.count, self.broken) = (None, false);
    }

    pub fn follow(&mut self, t_s: f64, Decoded { value, counter }: Decoded) -> Sample {
        let step = match counter {
            Some(count) => self.step(count),
            None => Step::On { missing: 0 },
        };
        let Step::On { missing } = step else {
            return Sample { t_s, value_mm: None, flag: Flag::Stale, missing: 0 };
        };
        let broken = std::mem::take(&mut self.broken) || missing > 0;
        match value {
            Ok(mm) => {
                let flag = if broken { Flag::Gap } else { Flag::None };
                Sample { t_s, value_mm: Some(mm), flag, missing }
            }
            Err(flag) => Sample { t_s, value_mm: None, flag, missing },
        }
    }

    fn step(&mut self, count: u64) -> Step {
        let Some(last) = self.count.replace(count) else { return Step::On { missing: 0 } };
        let round = self.round.unwrap_or(1);
        match (round + count - last) % round {
            // After an interruption it may have gone round.
            0 if !self.broken => Step::Stands,
            0 => Step::On { missing: 0 },
            on => Step::On { missing: u32::try_from(on - 1).unwrap_or(u32::MAX) },
        }
    }
}
