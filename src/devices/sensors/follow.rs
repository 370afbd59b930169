//! From what a sensor says to samples: follows its counter, so that what is missing is known and what
//! came before is not taken twice. Common to all sensors.

use super::Sample;
use super::layout::Decoded;
use machine::record::reading::Flag;

/// Whatever says a value and a count.
pub struct Counting {
    /// After so many samples the counter begins anew.
    round: Option<u64>,
    /// Of the sample before.
    count: Option<u64>,
    /// Something was lost since the last sample, and no counter says how much.
    broken: bool,
    /// Nobody asked for what lies between the last sample and the next.
    fresh: bool,
    /// The last sample had the number of the one before.
    stands: bool,
    /// So much time has passed that the counter may have gone round to the same number.
    long: bool,
    /// Samples that came while nobody listened, as far as the counter tells.
    passed_over: u64,
}

enum Step {
    On { missing: u32 },
    Stands,
}

impl Counting {
    pub fn new(round: Option<u64>) -> Self {
        let (count, broken, fresh) = (None, false, true);
        let (stands, long, passed_over) = (false, false, 0);
        Self { round, count, broken, fresh, stands, long, passed_over }
    }

    /// Samples may be missing before the next one.
    pub fn interrupted(&mut self) {
        self.broken = true;
    }

    /// What lies between the last sample and the next is not missed. A count that still stands is.
    pub fn forget(&mut self) {
        (self.broken, self.fresh) = (false, true);
    }

    /// What lies between the last sample and the next is not missed, however much it is.
    pub fn pass(&mut self) {
        self.forget();
        self.long = true;
    }

    pub fn passed_over(&self) -> u64 {
        self.passed_over
    }

    /// What comes next is the first: with a narrow counter it may have gone round to the same number.
    pub fn begin(&mut self) {
        self.forget();
        self.count = None;
    }

    /// The last sample came, and its counter said that it had come before.
    pub fn stands(&self) -> bool {
        self.stands
    }

    pub fn follow(&mut self, t_s: f64, decoded: Decoded) -> Sample {
        let Decoded { value, counter, encoder_count } = decoded;
        let step = match counter {
            Some(count) => self.step(count),
            None => Step::On { missing: 0 },
        };
        self.stands = matches!(step, Step::Stands);
        let Step::On { missing } = step else {
            return Sample::stale(t_s);
        };
        let broken = std::mem::take(&mut self.broken) || missing > 0;
        let flag = value.err().unwrap_or(if broken { Flag::Gap } else { Flag::None });
        Sample { t_s, value_mm: value.ok(), flag, missing, encoder_count }
    }

    fn step(&mut self, count: u64) -> Step {
        let (fresh, long) = (std::mem::take(&mut self.fresh), std::mem::take(&mut self.long));
        let Some(last) = self.count.replace(count) else { return Step::On { missing: 0 } };
        let round = self.round.unwrap_or(1);
        match (round + count - last) % round {
            // After an interruption it may have gone round.
            0 if !self.broken && !long => Step::Stands,
            0 => Step::On { missing: 0 },
            on if fresh => {
                self.passed_over += on - 1;
                Step::On { missing: 0 }
            }
            on => Step::On { missing: u32::try_from(on - 1).unwrap_or(u32::MAX) },
        }
    }
}
