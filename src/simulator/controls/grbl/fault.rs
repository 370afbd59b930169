//! Faults of the simulated control, `[[simulated.fault]]`, for rehearsals.

use std::sync::PoisonError;

use serde::Deserialize;

use super::{Firmware, HARD_LIMIT, Lock, SOFT_LIMIT};
use crate::interpreter::ProbeInputFault;

const E_STOP: u8 = 10;
const UNKNOWN_ALARM: u8 = 3;
/// Grbl's error code for settings that were lost and replaced by defaults.
const SETTINGS_LOST: u8 = 7;

/// One fault. It occurs once, at the first suitable line after both conditions hold.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    pub kind: FaultKind,
    /// Earliest line, counted from 1 in the order of reception.
    #[serde(default)]
    pub at_line: u64,
    /// Number of contacts before which the fault does not occur.
    #[serde(default)]
    pub after_touch: u64,
    /// Code of an alarm or an error.
    #[serde(default)]
    pub code: Option<u8>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// The control hangs: it neither reads, moves nor answers any more.
    Silence,
    /// The control restarts: it loses its state and sends the banner.
    Reset,
    /// The control sends the banner and does not restart.
    Banner,
    /// A line is lost.
    Unanswered,
    /// A line is executed, but its answer is lost.
    LostOk,
    DoubleOk,
    /// Bytes that are not text precede the answer.
    Garbage,
    /// An alarm instead of the execution of the line.
    Alarm,
    Error,
    /// The probe reads closed from now on.
    ProbeStuck,
    /// The probe reads open from now on.
    ProbeDead,
    /// The next probing move meets an obstacle after two fifths of its path.
    ForeignBody,
    /// The stylus is brushed during the next rapid or turn: the probe reads closed for a while.
    RapidContact,
    SoftLimit,
    /// A person presses feed hold at the machine, or opens the door.
    Hold,
    Door,
    EStop,
}

impl FaultKind {
    pub const ALL: [FaultKind; 17] = [
        Self::Silence,
        Self::Reset,
        Self::Banner,
        Self::Unanswered,
        Self::LostOk,
        Self::DoubleOk,
        Self::Garbage,
        Self::Alarm,
        Self::Error,
        Self::ProbeStuck,
        Self::ProbeDead,
        Self::ForeignBody,
        Self::RapidContact,
        Self::SoftLimit,
        Self::Hold,
        Self::Door,
        Self::EStop,
    ];
}

/// How often the next answer is sent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Answer {
    #[default]
    Once,
    Twice,
    Never,
}

impl Firmware {
    /// Executes `line`, unless a fault is due.
    pub(super) fn line(&mut self, line: &str) {
        self.lines += 1;
        let (lines, touches) = (self.lines, self.touches);
        let due = |fault: &Fault| fault.at_line <= lines && fault.after_touch <= touches;
        match self.options.faults.iter().position(due) {
            Some(place) => {
                let fault = self.options.faults.remove(place);
                self.go_wrong(&fault, line);
            }
            None => self.obey(line),
        }
    }

    fn go_wrong(&mut self, fault: &Fault, line: &str) {
        use FaultKind as K;
        // These faults wait for their move, their answer, or a machine that can be held.
        let later = matches!(
            fault.kind,
            K::LostOk | K::DoubleOk | K::ForeignBody | K::RapidContact | K::Hold | K::Door
        );
        if !later {
            self.happens(fault.kind);
        }
        match fault.kind {
            FaultKind::Silence => self.hung = true,
            FaultKind::Reset => self.reset(),
            FaultKind::Unanswered => {}
            FaultKind::Alarm => self.raise(fault.code.unwrap_or(UNKNOWN_ALARM)),
            FaultKind::EStop => self.raise(E_STOP),
            FaultKind::Error => {
                let code = fault.code.unwrap_or(SETTINGS_LOST);
                self.latched = self.options.native.then_some(code);
                self.say_error(code);
            }
            FaultKind::SoftLimit => {
                if !self.soft_limit() {
                    self.say_ok();
                }
            }
            kind => {
                self.spoil(kind);
                self.obey(line);
                if matches!(kind, FaultKind::Hold | FaultKind::Door) {
                    self.hold();
                    self.door = kind == FaultKind::Door;
                    if self.held {
                        self.happens(kind);
                    }
                }
            }
        }
    }

    /// Applies a fault that does not depend on the content of the line.
    fn spoil(&mut self, kind: FaultKind) {
        match kind {
            FaultKind::Banner => self.say_banner(),
            FaultKind::LostOk => self.answer = Answer::Never,
            FaultKind::DoubleOk => self.answer = Answer::Twice,
            FaultKind::Garbage => self.out.extend_from_slice(b"\xf8\x80\x1f\x00x\r\n"),
            FaultKind::ProbeStuck => self.sham = ProbeInputFault::Closed,
            FaultKind::ProbeDead => self.sham = ProbeInputFault::Open,
            FaultKind::ForeignBody => self.sham = ProbeInputFault::Early,
            FaultKind::RapidContact => self.sham = ProbeInputFault::Brush,
            _ => {}
        }
    }

    pub(super) fn happens(&mut self, kind: FaultKind) {
        // A list stays consistent if another thread panics.
        self.happened.lock().unwrap_or_else(PoisonError::into_inner).push(kind);
    }

    /// Raises a spontaneous alarm; the line is not executed.
    fn raise(&mut self, code: u8) {
        self.say(&format!("ALARM:{code}"));
        self.stop_here();
        let needs_reset = matches!(code, HARD_LIMIT | SOFT_LIMIT | E_STOP);
        self.alarm = Some(if needs_reset { Lock::Reset } else { Lock::Light });
        if !needs_reset {
            self.say_ok();
        }
    }
}
