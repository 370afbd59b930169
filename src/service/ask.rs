//! What is asked of a machine's attendant, and a person's word.

use tokio::sync::oneshot;

use super::board::Refusal;
use crate::store::RunId;

/// What the service must do, one thing at a time: while one is asked for, no other is accepted.
#[derive(Debug)]
pub enum Ask {
    Start { cycle: u16 },
    Acknowledge(Word),
    Resume { run: RunId, word: Word },
    End,
}

/// Somebody has looked at the machine.
#[derive(Debug)]
pub struct Word {
    pub who: String,
    pub why: String,
    /// All axes, where the control may have lost its position.
    pub homed: bool,
    /// For whoever waits to hear what became of it.
    pub answer: oneshot::Sender<Result<(), Refusal>>,
}

/// Who looked, why, and whether the axes are homed.
#[derive(Debug, Clone, Copy, Default)]
pub struct Looked<'a> {
    pub who: &'a str,
    pub why: &'a str,
    pub homed: bool,
}

impl Looked<'_> {
    pub(super) fn word(self) -> (Word, Answer) {
        let (answer, told) = oneshot::channel();
        let Self { who, why, homed } = self;
        (Word { who: who.to_owned(), why: why.to_owned(), homed, answer }, told)
    }
}

/// What became of an accepted word.
pub type Answer = oneshot::Receiver<Result<(), Refusal>>;

/// What a hold has met.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stopped {
    Run,
    /// Nothing moves here.
    Nothing,
    /// Whatever moves is another program's: this one cannot hold it.
    Elsewhere,
}
