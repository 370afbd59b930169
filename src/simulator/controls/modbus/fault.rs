//! What the simulated control, or its wire, can do wrong, to rehearse it: `[[simulated.fault]]`.

use std::time::Duration;

use serde::Deserialize;
use tokio_modbus::{ExceptionCode, Request, Response};

use super::layout::{HOLD, SEQUENCE};
use super::{Entry, Firmware, Mode};
use crate::Latch;
use crate::interpreter::Sham;

const E_STOP: u16 = 10;
const UNKNOWN_ALARM: u16 = 99;
const USUAL_LATE_S: f64 = 0.7;
/// Of a common PLC.
const USUAL_SCAN_S: f64 = 0.010;

/// Far beyond the clock of any control.
pub(super) const WRONG_STAMP_S: f64 = 1e300;

const MANY: usize = 8;
/// First register of the latch.
const LATCH: usize = 20;

/// One thing that goes wrong, once: at the first request after all conditions hold.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    pub kind: FaultKind,
    /// Not before this request, counted as they come.
    #[serde(default)]
    pub at_request: u64,
    /// Not before so many chunks were taken.
    #[serde(default)]
    pub at_line: u64,
    /// Not before so many contacts.
    #[serde(default)]
    pub after_touch: u64,
    /// Of an alarm or an exception.
    #[serde(default)]
    pub code: Option<u8>,
    /// How late a reply is.
    #[serde(default)]
    pub late_s: Option<f64>,
    /// How often a PLC looks at the probe.
    #[serde(default)]
    pub scan_s: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// The request is obeyed, the reply comes late.
    Late,
    /// The request is obeyed, the reply lost.
    Unanswered,
    /// The request is lost.
    Lost,
    /// The request is refused by an exception.
    Exception,
    /// The status is written while it is read.
    Torn,
    /// The status of an earlier moment is shown once more.
    Stale,
    /// The connection is cut (RTU: the request is lost).
    Cut,
    /// It hangs: nothing is answered any more.
    Silence,
    /// Its program stands; its registers are still served.
    Frozen,
    /// It is switched off and on.
    Reset,
    Alarm,
    EStop,
    /// Somebody holds it at the machine.
    Hold,
    /// The probe reads closed from now on.
    ProbeStuck,
    /// The probe reads open from now on.
    ProbeDead,
    /// The next probing move meets something after two fifths of its way.
    ForeignBody,
    /// Something brushes the stylus during the next rapid: the probe reads closed for a while.
    RapidContact,
    /// From now on a contact is latched by the scan of a PLC.
    SlowLatch,
    /// A write of many registers is confirmed, and only the first half of it is kept.
    HalfWritten,
    /// The write of a sequence is confirmed and forgotten.
    LostStart,
    /// The write of a hold is confirmed and forgotten.
    LostHold,
    /// Its heartbeat stays as it is; its program goes on.
    HeartbeatStands,
    /// From now on each contact is stamped with `WRONG_STAMP_S`.
    WrongStamp,
    /// A program shows the result before once more, as valid.
    StaleResult,
    /// A program does not hear an acknowledge.
    RepeatedResult,
    /// A program counts a result that it never shows.
    SkippedResult,
    /// A program begins once more where it should end.
    StartedTwice,
}

impl FaultKind {
    /// Of every window that nobody holds (`LostHold` strikes holds alone).
    pub const ALL: [FaultKind; 20] = [
        Self::Late,
        Self::Unanswered,
        Self::Lost,
        Self::Exception,
        Self::Torn,
        Self::Stale,
        Self::Cut,
        Self::Silence,
        Self::Frozen,
        Self::Reset,
        Self::Alarm,
        Self::EStop,
        Self::Hold,
        Self::ProbeStuck,
        Self::ProbeDead,
        Self::ForeignBody,
        Self::RapidContact,
        Self::SlowLatch,
        Self::HalfWritten,
        Self::LostStart,
    ];
    /// Of a resident program besides.
    pub const OF_PROGRAM: [FaultKind; 4] =
        [Self::StaleResult, Self::RepeatedResult, Self::SkippedResult, Self::StartedTwice];

    /// It happens to a resident program alone.
    pub fn of_program(self) -> bool {
        Self::OF_PROGRAM.contains(&self)
    }

    /// It is noted when it happens.
    fn comes_later(self) -> bool {
        matches!(
            self,
            Self::ForeignBody | Self::RapidContact | Self::SkippedResult | Self::StartedTwice
        )
    }

    /// Whether it can happen to this request at all.
    fn strikes(self, request: &Request<'_>) -> bool {
        match self {
            Self::HalfWritten => {
                matches!(request, Request::WriteMultipleRegisters(_, words) if words.len() > MANY)
            }
            Self::LostStart => matches!(request, Request::WriteMultipleRegisters(at, words)
                if usize::from(*at) == SEQUENCE && words.len() == 1),
            Self::LostHold => matches!(request, Request::WriteMultipleRegisters(at, words)
                if usize::from(*at) == HOLD && words.len() == 1),
            Self::Torn | Self::Stale | Self::StaleResult => {
                matches!(request, Request::ReadInputRegisters(0, count) if *count > 1)
            }
            _ => true,
        }
    }
}

/// What goes back over the wire.
pub(super) struct Reply {
    pub answer: Option<Result<Response, ExceptionCode>>,
    pub late: Duration,
}

impl Firmware {
    /// A request comes at `now`.
    pub(super) fn request(&mut self, request: &Request<'_>, now: Duration) -> Reply {
        self.live(now);
        self.requests += 1;
        let at_once = |answer| Reply { answer, late: Duration::ZERO };
        if self.hung {
            return at_once(None);
        }
        let (requests, taken, touches) = (self.requests, self.taken, self.touches);
        let has_before = self.resident.as_ref().is_some_and(|resident| resident.before.is_some());
        let due = |fault: &Fault| {
            fault.at_request <= requests
                && fault.at_line <= taken
                && fault.after_touch <= touches
                && fault.kind.strikes(request)
                && (fault.kind != FaultKind::StaleResult || has_before)
        };
        let Some(place) = self.options.faults.iter().position(due) else {
            return at_once(Some(self.obey(request)));
        };
        let fault = self.options.faults.remove(place);
        self.go_wrong(&fault, request)
    }

    fn obey(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let answer = self.answer(request);
        // What was written acts at once.
        self.live(self.now);
        answer
    }

    fn go_wrong(&mut self, fault: &Fault, request: &Request<'_>) -> Reply {
        use FaultKind as K;
        if !fault.kind.comes_later() {
            self.note(Entry::Wrong(fault.kind));
        }
        let mut late = Duration::ZERO;
        let answer = match fault.kind {
            K::Late => {
                let late_s = fault.late_s.unwrap_or(USUAL_LATE_S);
                late = Duration::try_from_secs_f64(late_s).unwrap_or_default();
                Some(self.obey(request))
            }
            K::Unanswered => {
                let _ = self.obey(request);
                None
            }
            K::Lost => None,
            K::Cut => {
                self.cut.notify_waiters();
                None
            }
            K::Silence => {
                self.hung = true;
                None
            }
            K::Exception => {
                let code = fault.code.map(ExceptionCode::new);
                Some(Err(code.unwrap_or(ExceptionCode::ServerDeviceBusy)))
            }
            K::HalfWritten | K::LostStart | K::LostHold => Some(self.half(request)),
            K::StaleResult => Some(self.with_stale_result(request)),
            K::Torn => Some(self.torn(request)),
            K::Stale => Some(self.stale(request)),
            kind => {
                self.turn(kind, fault);
                Some(self.obey(request))
            }
        };
        Reply { answer, late }
    }

    /// What befalls the control itself.
    fn turn(&mut self, kind: FaultKind, fault: &Fault) {
        match kind {
            FaultKind::Frozen => self.frozen = Some(self.status()),
            FaultKind::HeartbeatStands => self.standing_heartbeat = Some(self.heartbeat()),
            FaultKind::WrongStamp => self.wrong_stamp = true,
            FaultKind::Reset => self.reset(),
            FaultKind::Alarm => self.alarm(fault.code.map_or(UNKNOWN_ALARM, u16::from)),
            FaultKind::EStop => self.alarm(E_STOP),
            FaultKind::Hold => {
                self.stop_here();
                self.mode = Mode::Held(0);
            }
            FaultKind::ProbeStuck => self.sham = Sham::Closed,
            FaultKind::ProbeDead => self.sham = Sham::Open,
            FaultKind::ForeignBody => self.sham = Sham::Early,
            FaultKind::RapidContact => self.sham = Sham::Brush,
            FaultKind::SlowLatch => {
                let scan_ms = fault.scan_s.unwrap_or(USUAL_SCAN_S) * 1e3;
                self.with_world(|world| world.latch_by(Latch { scan_ms, ..Latch::default() }));
            }
            _ => {}
        }
        let Some(resident) = &mut self.resident else { return };
        match kind {
            FaultKind::RepeatedResult => resident.deaf = true,
            FaultKind::SkippedResult => resident.skips = true,
            FaultKind::StartedTwice => resident.begins_again = true,
            _ => {}
        }
    }

    fn with_stale_result(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        self.stale_result = true;
        let answer = self.obey(request);
        self.stale_result = false;
        answer
    }

    /// The first half of what is to be written, as if it were all.
    fn half(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let Request::WriteMultipleRegisters(at, words) = request else {
            return self.obey(request);
        };
        let half = words.get(..words.len() / 2).unwrap_or_default();
        if !half.is_empty() {
            self.write(*at, half)?;
        }
        let count = u16::try_from(words.len()).map_err(|_| ExceptionCode::IllegalDataValue)?;
        Ok(Response::WriteMultipleRegisters(*at, count))
    }

    /// From the latch on it is of the block before.
    fn torn(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let before = self.shown.clone();
        match self.obey(request) {
            Ok(Response::ReadInputRegisters(mut words)) => {
                for (word, old) in words.iter_mut().zip(before).skip(LATCH) {
                    *word = old;
                }
                if let (Some(head), Some(tail)) = (words.first().copied(), words.last_mut()) {
                    *tail = head.wrapping_sub(1);
                }
                Ok(Response::ReadInputRegisters(words))
            }
            other => other,
        }
    }

    fn stale(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let shown = self.shown.clone();
        match self.obey(request) {
            Ok(Response::ReadInputRegisters(words)) if words.len() == shown.len() => {
                Ok(Response::ReadInputRegisters(shown))
            }
            other => other,
        }
    }
}
