//! Faults of the simulated control, `[[simulated.fault]]`, for tests and training.

use std::sync::PoisonError;

use serde::Deserialize;

use super::{ALARM_HARD_LIMIT, ALARM_SOFT_LIMIT, AlarmLock, Firmware};
use crate::interpreter::ProbeInputFault;

const ALARM_E_STOP: u8 = 10;
/// Alarm of Grbl: reset while in motion.
const DEFAULT_ALARM_CODE: u8 = 3;
/// Grbl's error code for settings that were lost and replaced by defaults.
const ERROR_SETTINGS_LOST: u8 = 7;

/// One fault. It is triggered once, at the first line at which both conditions hold; one line triggers one fault at
/// most.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    pub kind: FaultKind,
    /// Earliest line, counted from 1 in the order of reception.
    #[serde(default)]
    pub at_line: u64,
    /// Minimum number of contacts before the fault occurs.
    #[serde(default)]
    pub after_touch: u64,
    /// Code of `Alarm` or `Error`; `None`: alarm 3, or error 7.
    pub code: Option<u8>,
}

/// Kind of a fault; "the line" is the received line at which the fault is triggered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// The control hangs until a soft reset: it reads no line and sends nothing. Motion that was accepted before
    /// continues.
    Silence,
    /// The control executes a soft reset: it loses the line and its state, and sends the banner; in motion also an
    /// alarm.
    #[serde(rename = "reset")]
    Restart,
    /// The control sends the banner, does not restart, and executes the line.
    #[serde(rename = "banner")]
    BannerWithoutRestart,
    /// A line is lost: it is neither executed nor answered.
    #[serde(rename = "unanswered")]
    LostLine,
    /// A line is executed, but the next `ok` is not sent.
    #[serde(rename = "lost-ok")]
    LostAnswer,
    /// The next `ok` is sent twice.
    DoubleOk,
    /// Bytes that are not text precede the answer.
    Garbage,
    /// An alarm instead of the execution of the line. Codes 1, 2 and 10 need a soft reset; after others the line is
    /// answered by `ok`.
    Alarm,
    /// An error instead of the execution of the line; at compatibility level 0 the error is latched.
    Error,
    /// The probe reads closed from now on.
    ProbeStuck,
    /// The probe reads open from now on.
    ProbeDead,
    /// The next probing move meets an obstacle after two fifths of its path.
    ForeignBody,
    /// The stylus is brushed during the next rapid or turn: the probe reads closed in the next two status reports.
    RapidContact,
    /// A soft-limit alarm instead of the execution of the line.
    SoftLimit,
    /// A person presses feed hold at the machine just after the line is accepted.
    #[serde(rename = "hold")]
    PersonHolds,
    /// A person opens the door just after the line is accepted: a feed hold that is reported as `Door:1`.
    Door,
    /// Alarm 10 instead of the execution of the line; only a soft reset unlocks.
    EStop,
}

/// How often the next `ok` is sent; errors are not affected.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum AnswerCount {
    #[default]
    Once,
    Twice,
    Never,
}

impl Firmware {
    /// Executes `line`, with the fault that is due, if any.
    pub(super) fn execute_line_or_fault(&mut self, line: &str) {
        self.received_line_count += 1;
        let due = |fault: &Fault| fault.at_line <= self.received_line_count && fault.after_touch <= self.contact_count;
        match self.options.faults.iter().position(due) {
            Some(index) => {
                let fault = self.options.faults.remove(index);
                self.apply_fault(&fault, line);
            }
            None => self.execute_line(line),
        }
    }

    /// Applies a fault that is due; executes `line` unless the fault replaces the execution.
    fn apply_fault(&mut self, fault: &Fault, line: &str) {
        use FaultKind as K;
        // These faults are recorded later, at the move, the answer or the hold that they affect.
        let is_recorded_later = matches!(
            fault.kind,
            K::LostAnswer | K::DoubleOk | K::ForeignBody | K::RapidContact | K::PersonHolds | K::Door
        );
        if !is_recorded_later {
            self.record_fault(fault.kind);
        }
        match fault.kind {
            FaultKind::Silence => self.is_hung = true,
            FaultKind::Restart => self.soft_reset(),
            FaultKind::LostLine => {}
            FaultKind::Alarm => self.raise_spontaneous_alarm(fault.code.unwrap_or(DEFAULT_ALARM_CODE)),
            FaultKind::EStop => self.raise_spontaneous_alarm(ALARM_E_STOP),
            FaultKind::Error => {
                let code = fault.code.unwrap_or(ERROR_SETTINGS_LOST);
                self.latched_error = self.options.is_compatibility_level_0.then_some(code);
                self.send_error(code);
            }
            FaultKind::SoftLimit => {
                if !self.raise_soft_limit_alarm() {
                    self.send_ok();
                }
            }
            kind => {
                self.apply_fault_before_line(kind);
                self.execute_line(line);
                if matches!(kind, FaultKind::PersonHolds | FaultKind::Door) {
                    self.hold();
                    self.is_door_open = kind == FaultKind::Door;
                    if self.is_held {
                        self.record_fault(kind);
                    }
                }
            }
        }
    }

    /// Applies a fault that does not depend on the content of the line.
    fn apply_fault_before_line(&mut self, kind: FaultKind) {
        match kind {
            FaultKind::BannerWithoutRestart => self.send_banner(),
            FaultKind::LostAnswer => self.next_answer_count = AnswerCount::Never,
            FaultKind::DoubleOk => self.next_answer_count = AnswerCount::Twice,
            FaultKind::Garbage => self.send_buffer.extend_from_slice(b"\xf8\x80\x1f\x00x\r\n"),
            FaultKind::ProbeStuck => self.executor.probe_fault = ProbeInputFault::StuckClosed,
            FaultKind::ProbeDead => self.executor.probe_fault = ProbeInputFault::StuckOpen,
            FaultKind::ForeignBody => self.executor.probe_fault = ProbeInputFault::ObstacleOnNextProbe,
            FaultKind::RapidContact => self.executor.probe_fault = ProbeInputFault::BrushPending,
            _ => {}
        }
    }

    /// Adds the fault to those that have occurred.
    pub(super) fn record_fault(&mut self, kind: FaultKind) {
        // A list stays consistent if another thread panics.
        self.occurred_faults.lock().unwrap_or_else(PoisonError::into_inner).push(kind);
    }

    /// Raises a spontaneous alarm; the line is not executed, and is answered only if the alarm needs no reset.
    fn raise_spontaneous_alarm(&mut self, code: u8) {
        let needs_reset = matches!(code, ALARM_HARD_LIMIT | ALARM_SOFT_LIMIT | ALARM_E_STOP);
        self.raise_alarm(code, if needs_reset { AlarmLock::NeedsReset } else { AlarmLock::Unlockable });
        if !needs_reset {
            self.send_ok();
        }
    }
}
