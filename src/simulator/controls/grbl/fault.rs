//! What the simulated control can do wrong, to rehearse it: `[[simulated.fault]]`.

use std::sync::PoisonError;

use serde::Deserialize;

use super::{Firmware, HARD_LIMIT, Lock, SOFT_LIMIT};
use crate::interpreter::Sham;

const E_STOP: u8 = 10;
const UNKNOWN_ALARM: u8 = 3;
/// Grbl's word for settings that were lost and replaced by defaults.
const SETTINGS_LOST: u8 = 7;

/// One thing that goes wrong, once: with the first line that it can happen to after both
/// conditions hold.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    pub kind: FaultKind,
    /// Not before this line, counted as they are received.
    #[serde(default)]
    pub at_line: u64,
    /// Not before so many contacts.
    #[serde(default)]
    pub after_touch: u64,
    /// Of an alarm or an error.
    #[serde(default)]
    pub code: Option<u8>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// It hangs: nothing is read, done or said any more.
    Silence,
    /// It restarts: everything is forgotten, the banner is said.
    Reset,
    /// The banner and nothing else.
    Banner,
    /// A line is lost.
    Unanswered,
    /// A line is obeyed, its answer lost.
    LostOk,
    DoubleOk,
    /// Bytes that are no text, before the answer.
    Garbage,
    /// Instead of obeying the line.
    Alarm,
    Error,
    /// The probe reads closed from now on.
    ProbeStuck,
    /// The probe reads open from now on.
    ProbeDead,
    /// The next probing move meets something after two fifths of its way.
    ForeignBody,
    /// Something brushes the stylus during the next rapid or turn: the probe reads closed for a while.
    RapidContact,
    SoftLimit,
    /// Somebody presses feed hold at the machine, or opens the door.
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

/// How the next answer is said.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Answer {
    #[default]
    Once,
    Twice,
    Never,
}

impl Firmware {
    /// Obey `line`, unless it is its turn to go wrong.
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
        // These wait for their move, their answer, or a machine that can be held.
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

    /// What the line does not notice itself.
    fn spoil(&mut self, kind: FaultKind) {
        match kind {
            FaultKind::Banner => self.say_banner(),
            FaultKind::LostOk => self.answer = Answer::Never,
            FaultKind::DoubleOk => self.answer = Answer::Twice,
            FaultKind::Garbage => self.out.extend_from_slice(b"\xf8\x80\x1f\x00x\r\n"),
            FaultKind::ProbeStuck => self.sham = Sham::Closed,
            FaultKind::ProbeDead => self.sham = Sham::Open,
            FaultKind::ForeignBody => self.sham = Sham::Early,
            FaultKind::RapidContact => self.sham = Sham::Brush,
            _ => {}
        }
    }

    pub(super) fn happens(&mut self, kind: FaultKind) {
        // A list is whole whatever panicked beside it.
        self.happened.lock().unwrap_or_else(PoisonError::into_inner).push(kind);
    }

    /// An alarm out of nothing; the line is not obeyed.
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
