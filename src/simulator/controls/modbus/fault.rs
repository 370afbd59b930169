//! Faults of the simulated control or of its wire, `[[simulated.fault]]`, for tests and training.

use std::time::Duration;

use serde::Deserialize;
use tokio_modbus::{ExceptionCode, Request, Response};

use super::layout::{HOLD_REGISTER, SEQUENCE_REGISTER};
use super::{ControlEvent, Firmware, OperatingState};
use crate::LatchDelay;
use crate::interpreter::ProbeInputFault;

const ALARM_E_STOP: u16 = 10;
const DEFAULT_ALARM_CODE: u16 = 99;
const DEFAULT_REPLY_DELAY_S: f64 = 0.7;
/// Scan period of a common PLC, s.
const DEFAULT_SCAN_PERIOD_S: f64 = 0.010;

/// Time stamp of [`FaultKind::WrongStamp`], s: far beyond the clock of any control.
pub(super) const WRONG_STAMP_S: f64 = 1e300;

/// Largest write, in registers, that [`FaultKind::HalfWritten`] does not affect.
const MAX_FULLY_WRITTEN_REGISTERS: usize = 8;
/// First register of the latched position.
const FIRST_LATCH_REGISTER: usize = 20;

/// One fault. It occurs once, at the first request that it can affect after all conditions hold.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    pub kind: FaultKind,
    /// Earliest request, counted from 1 in the order of arrival.
    #[serde(default)]
    pub at_request: u64,
    /// Minimum number of accepted chunks before the fault occurs.
    #[serde(rename = "at_line", default)]
    pub min_accepted_chunks: u64,
    /// Minimum number of contacts before the fault occurs.
    #[serde(default)]
    pub after_touch: u64,
    /// Code of `Alarm` or `Exception`; `None`: alarm 99, or exception 6 (server device busy).
    pub code: Option<u8>,
    /// `late`: delay of the reply, s; `None`: 0.7 s.
    pub late_s: Option<f64>,
    /// `slow-latch`: period at which the PLC reads the probe input, s; `None`: 0.01 s.
    #[serde(rename = "scan_s")]
    pub slow_latch_period_s: Option<f64>,
}

/// Kind of a fault; "the request" is the Modbus request at which the fault is triggered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// The request is executed; the reply comes late.
    Late,
    /// The request is executed; no reply is sent.
    #[serde(rename = "unanswered")]
    LostAnswer,
    /// The request is neither executed nor answered.
    #[serde(rename = "lost")]
    LostRequest,
    /// The request is not executed, but refused by an exception.
    Exception,
    /// The status changes while it is read.
    #[serde(rename = "torn")]
    StatusChangesDuringRead,
    /// The status block of the previous read is returned once more.
    #[serde(rename = "stale")]
    StaleStatus,
    /// All TCP connections are cut, and the request is lost (RTU: only the request is lost).
    #[serde(rename = "cut")]
    ConnectionCut,
    /// The control answers no request any more. Its motion continues.
    Silence,
    /// The program of the control stops: no chunk is accepted and the status does not change; the registers are still
    /// served.
    #[serde(rename = "frozen")]
    ProgramStopped,
    /// The control is switched off and on; a person must make it ready.
    #[serde(rename = "reset")]
    PowerCycle,
    /// The control raises an alarm, 99 unless `code` is given, then executes the request.
    Alarm,
    /// The control raises alarm 10, then executes the request.
    EStop,
    /// A person holds the control at the machine; the request is then executed.
    #[serde(rename = "hold")]
    PersonHolds,
    /// The probe reads closed from now on.
    ProbeStuck,
    /// The probe reads open from now on.
    ProbeDead,
    /// The next probing move meets an obstacle after two fifths of its path.
    ForeignBody,
    /// The stylus is brushed during the next rapid or turn: the probe reads closed in the next two status blocks.
    RapidContact,
    /// From now on a PLC latches a contact only in its next scan, so the latched position lies beyond the contact.
    #[serde(rename = "slow-latch")]
    LatchByScan,
    /// A write of more than eight registers is confirmed, but only its first half is kept.
    HalfWritten,
    /// A write of the sequence register is confirmed but ignored.
    LostStart,
    /// A write of the hold register is confirmed but ignored.
    LostHold,
    /// The control's own heartbeat stops; its program continues.
    #[serde(rename = "heartbeat-stands")]
    HeartbeatStopped,
    /// From now on each contact gets the time stamp `WRONG_STAMP_S`.
    WrongStamp,
    /// A resident program shows the previous result once more, as valid.
    StaleResult,
    /// A resident program ignores the acknowledgement of a result.
    #[serde(rename = "repeated-result")]
    AcknowledgeIgnored,
    /// A resident program counts a result that it never shows.
    SkippedResult,
    /// A resident program starts once more where it should end.
    #[serde(rename = "started-twice")]
    ProgramRestartedAtEnd,
}

impl FaultKind {
    /// Additional faults of a resident program.
    pub const PROGRAM_ONLY: [FaultKind; 4] =
        [Self::StaleResult, Self::AcknowledgeIgnored, Self::SkippedResult, Self::ProgramRestartedAtEnd];

    /// Whether the fault applies to a resident program only.
    pub fn is_program_only(self) -> bool {
        Self::PROGRAM_ONLY.contains(&self)
    }

    /// Whether the fault is recorded when it takes effect, not when it is due.
    fn is_recorded_later(self) -> bool {
        matches!(self, Self::ForeignBody | Self::RapidContact | Self::SkippedResult | Self::ProgramRestartedAtEnd)
    }

    /// Whether the fault can affect this request.
    fn affects(self, request: &Request<'_>) -> bool {
        match self {
            Self::HalfWritten => {
                matches!(request, Request::WriteMultipleRegisters(_, words) if words.len() > MAX_FULLY_WRITTEN_REGISTERS)
            }
            Self::LostStart => matches!(request, Request::WriteMultipleRegisters(at, words)
                if usize::from(*at) == SEQUENCE_REGISTER && words.len() == 1),
            Self::LostHold => matches!(request, Request::WriteMultipleRegisters(at, words)
                if usize::from(*at) == HOLD_REGISTER && words.len() == 1),
            FaultKind::StatusChangesDuringRead | FaultKind::StaleStatus | Self::StaleResult => {
                matches!(request, Request::ReadInputRegisters(0, count) if *count > 1)
            }
            _ => true,
        }
    }
}

/// Reply to a request, and the time by which it is delayed.
pub(super) struct DelayedReply {
    /// `None`: no reply is sent.
    pub answer: Option<Result<Response, ExceptionCode>>,
    pub delay: Duration,
}

impl Firmware {
    /// Handles a request that arrives at `now`, with the fault that is due, if any; one request triggers one fault at
    /// most.
    pub(super) fn handle_request(&mut self, request: &Request<'_>, now: Duration) -> DelayedReply {
        self.advance(now);
        self.request_count += 1;
        let without_delay = |answer| DelayedReply { answer, delay: Duration::ZERO };
        if self.is_hung {
            return without_delay(None);
        }
        let has_previous_result =
            self.resident_program.as_ref().is_some_and(|resident| resident.previous_result_slot.is_some());
        let due = |fault: &Fault| {
            fault.at_request <= self.request_count
                && fault.min_accepted_chunks <= self.accepted_chunk_count
                && fault.after_touch <= self.contact_count
                && fault.kind.affects(request)
                && (fault.kind != FaultKind::StaleResult || has_previous_result)
        };
        let Some(index) = self.options.faults.iter().position(due) else {
            return without_delay(Some(self.execute_and_advance(request)));
        };
        let fault = self.options.faults.remove(index);
        self.apply_fault(&fault, request)
    }

    /// Executes the request, and at once all work that is due after it.
    fn execute_and_advance(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let answer = self.execute_request(request);
        // A write takes effect at once.
        self.advance(self.time_since_start);
        answer
    }

    /// Applies a fault that is due; executes the request unless the fault loses, refuses or ignores it.
    fn apply_fault(&mut self, fault: &Fault, request: &Request<'_>) -> DelayedReply {
        use FaultKind as K;
        if !fault.kind.is_recorded_later() {
            self.record_event(ControlEvent::FaultOccurred(fault.kind));
        }
        let mut delay = Duration::ZERO;
        let answer = match fault.kind {
            K::Late => {
                let late_s = fault.late_s.unwrap_or(DEFAULT_REPLY_DELAY_S);
                delay = Duration::try_from_secs_f64(late_s).unwrap_or_default();
                Some(self.execute_and_advance(request))
            }
            K::LostAnswer => {
                let _ = self.execute_and_advance(request);
                None
            }
            K::LostRequest => None,
            K::ConnectionCut => {
                self.cut_signal.notify_waiters();
                None
            }
            K::Silence => {
                self.is_hung = true;
                None
            }
            K::Exception => {
                let code = fault.code.map(ExceptionCode::new);
                Some(Err(code.unwrap_or(ExceptionCode::ServerDeviceBusy)))
            }
            K::HalfWritten | K::LostStart | K::LostHold => Some(self.write_first_half(request)),
            K::StaleResult => Some(self.reply_with_previous_result(request)),
            K::StatusChangesDuringRead => Some(self.reply_with_torn_status(request)),
            K::StaleStatus => Some(self.reply_with_previous_status(request)),
            kind => {
                self.apply_control_fault(kind, fault);
                Some(self.execute_and_advance(request))
            }
        };
        DelayedReply { answer, delay }
    }

    /// Applies a fault of the control itself.
    fn apply_control_fault(&mut self, kind: FaultKind, fault: &Fault) {
        match kind {
            FaultKind::ProgramStopped => self.frozen_status_block = Some(self.status_block()),
            FaultKind::HeartbeatStopped => self.frozen_heartbeat_value = Some(self.heartbeat_count()),
            FaultKind::WrongStamp => self.has_wrong_stamp = true,
            FaultKind::PowerCycle => self.power_cycle(),
            FaultKind::Alarm => self.raise_alarm(fault.code.map_or(DEFAULT_ALARM_CODE, u16::from)),
            FaultKind::EStop => self.raise_alarm(ALARM_E_STOP),
            FaultKind::PersonHolds => {
                self.stop_at_current_position();
                self.operating_state = OperatingState::Held(0);
            }
            FaultKind::ProbeStuck => self.executor.probe_fault = ProbeInputFault::StuckClosed,
            FaultKind::ProbeDead => self.executor.probe_fault = ProbeInputFault::StuckOpen,
            FaultKind::ForeignBody => self.executor.probe_fault = ProbeInputFault::ObstacleOnNextProbe,
            FaultKind::RapidContact => self.executor.probe_fault = ProbeInputFault::BrushPending,
            FaultKind::LatchByScan => {
                let scan_ms = fault.slow_latch_period_s.unwrap_or(DEFAULT_SCAN_PERIOD_S) * 1e3;
                self.executor
                    .with_world(|world| world.set_latch_delay(LatchDelay { scan_ms, ..LatchDelay::default() }));
            }
            _ => {}
        }
        let Some(resident) = &mut self.resident_program else { return };
        match kind {
            FaultKind::AcknowledgeIgnored => resident.ignores_next_result_acknowledge = true,
            FaultKind::SkippedResult => resident.skips_next_result = true,
            FaultKind::ProgramRestartedAtEnd => resident.restarts_at_end = true,
            _ => {}
        }
    }

    /// Executes the request while the status shows the previous result as pending.
    fn reply_with_previous_result(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        self.shows_previous_result = true;
        let answer = self.execute_and_advance(request);
        self.shows_previous_result = false;
        answer
    }

    /// Writes the first half of the registers (nothing of a single one) and confirms all.
    fn write_first_half(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let Request::WriteMultipleRegisters(at, words) = request else {
            return self.execute_and_advance(request);
        };
        let half = words.get(..words.len() / 2).unwrap_or_default();
        if !half.is_empty() {
            self.write_registers(*at, half)?;
        }
        let count = u16::try_from(words.len()).map_err(|_| ExceptionCode::IllegalDataValue)?;
        Ok(Response::WriteMultipleRegisters(*at, count))
    }

    /// Replies with a status block whose registers from the latched position on are those of the previous block.
    fn reply_with_torn_status(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let before = self.previous_status_block.clone();
        match self.execute_and_advance(request) {
            Ok(Response::ReadInputRegisters(mut words)) => {
                for (word, old) in words.iter_mut().zip(before).skip(FIRST_LATCH_REGISTER) {
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

    /// Executes the request; replies with the status block of the read before it.
    fn reply_with_previous_status(&mut self, request: &Request<'_>) -> Result<Response, ExceptionCode> {
        let shown = self.previous_status_block.clone();
        match self.execute_and_advance(request) {
            Ok(Response::ReadInputRegisters(words)) if words.len() == shown.len() => {
                Ok(Response::ReadInputRegisters(shown))
            }
            other => other,
        }
    }
}
