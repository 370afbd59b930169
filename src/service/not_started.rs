//! Why an unattended cycle does not start.

use jiff::Timestamp;

use super::machine_state::Refusal;
use crate::store::{RunId, StoreError};

/// Why a due cycle does not start, or does not start yet.
#[derive(Debug, thiserror::Error)]
pub enum NotStartedReason {
    /// The cycle was never armed.
    #[error("the cycle is not armed for unattended motion")]
    CycleNotArmed,
    /// The arming was ended before its time. `who`: the person who armed the cycle; `why`: reason of the end.
    #[error("the arming by {who} ended at {when}: {why}")]
    ArmingEnded { who: String, when: Timestamp, why: String },
    /// A run of this machine was held, failed or interrupted after the arming.
    #[error("run {run} was not completed after {who} armed this cycle; therefore the arming no longer holds")]
    ArmingBroken { who: String, run: RunId },
    #[error("the arming by {who} expired at {until}")]
    ArmingExpired { who: String, until: Timestamp },
    /// The clock is more than one hour earlier than the time of the arming.
    #[error("the clock was set back to before the arming by {who}")]
    ClockSetBack { who: String },
    /// A source of the readiness is missing or stale; `inputs`: names of all inputs that the start requires.
    #[error("not ready: no current report of {inputs}")]
    NoCurrentInputReport { inputs: String },
    /// The gate would refuse the start now; nothing was sent to the gate.
    #[error("not ready: {0}")]
    GateWouldRefuse(Refusal),
    /// A [`ReadinessCondition`](super::schedule::entry::ReadinessCondition) of the schedule does not hold;
    /// `condition` is its message.
    #[error("not ready: {condition}")]
    UnmetCondition { condition: &'static str },
    #[error("not ready: the control does not report `idle`")]
    IdleNotReported,
    #[error("not ready: the control has been idle for {idle_min} of {min_idle_min} minutes")]
    IdleTooShort { idle_min: u64, min_idle_min: u64 },
    /// The latest start of the slot has passed; the inner reason is the condition that did not hold last.
    #[error("the latest start time has passed: {0}")]
    LatestStartPassed(Box<NotStartedReason>),
    /// A request that the cycle is due repeats one that has started the cycle.
    #[error("the cycle was already started at {0}")]
    AlreadyStarted(Timestamp),
    /// The start was not written to the journal: an earlier outcome of the slot is kept, or the write failed.
    #[error("the cycle was not started: the scheduled time was already handled, or the journal cannot be written")]
    SlotNotRecorded,
    /// The gate refused the start that the journal had recorded already.
    #[error(transparent)]
    GateRefused(#[from] Refusal),
    #[error(transparent)]
    Journal(#[from] StoreError),
}
