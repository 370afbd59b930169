//! The simulated control behind a window of Modbus registers: executes the received text, or the rows for its resident
//! program, against a [`SimulatedWorld`]. It is the peer of the driver and shares no code with it; its register
//! addresses come from `docs/line-window.md` and `docs/resident-program.md` alone.
//!
//! The state of the control advances only at requests, to the time at which the request arrives.

mod chunk;
mod fault;
mod job;
mod layout;
mod registers;
mod resident_program;
mod serve;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

pub use fault::{Fault, FaultKind};
pub use serve::{serve_rtu, serve_tcp};

use resident_program::SimulatedResidentProgram;

use super::job_executor::JobExecutor;
use crate::SimulatedWorld;
use crate::interpreter::{Interpreter, SimulationPace};
use machine::Position;
use machine::record::machine::Machine;

const ALARM_HARD_LIMIT: u16 = 1;
const ALARM_SOFT_LIMIT: u16 = 2;
const ALARM_PROBE_CLOSED: u16 = 4;
const ALARM_NO_CONTACT: u16 = 5;
const ALARM_PROBE_STILL_CLOSED: u16 = 11;
/// Reason of a hold because the client's heartbeat stopped during a job.
const HOLD_REASON_HEARTBEAT_LOST: u16 = 64;

/// Maximum time between two changes of the client's heartbeat: after it, motion is held and no chunk is accepted.
const HEARTBEAT_TIMEOUT: Duration = Duration::from_secs(2);

/// Configuration of the simulated control.
#[derive(Debug, Clone)]
pub struct SimulatedModbusOptions {
    /// Interpreter with the axes and their travel.
    pub interpreter: Interpreter,
    pub pace: SimulationPace,
    /// Faults to simulate.
    pub faults: Vec<Fault>,
    /// Whether the control holds a resident measuring program; it then accepts no lines.
    pub has_resident_program: bool,
}

impl SimulatedModbusOptions {
    pub fn for_machine(machine: &Machine, pace: SimulationPace) -> Self {
        Self { interpreter: Interpreter::for_machine(machine), pace, faults: Vec::new(), has_resident_program: false }
    }
}

/// One entry of the event log of the control.
#[derive(Debug, Clone, PartialEq)]
pub enum ControlEvent {
    /// A chunk was accepted; `text` describes its lines or the rows of its table.
    ChunkAccepted {
        sequence: u16,
        text: String,
    },
    /// A chunk was offered, whether accepted or not.
    ChunkOffered {
        sequence: u16,
    },
    /// Latched positions in steps of 0.001 mm or degree, in the order of the registers, and the simulated time of the
    /// latch.
    ContactLatched {
        latch: Vec<i32>,
        t_s: f64,
    },
    /// A value other than 0 was written to the hold register.
    HoldRegisterWritten,
    FaultOccurred(FaultKind),
}

pub type ControlEventLog = Arc<Mutex<Vec<ControlEvent>>>;

/// Operating state of the control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum OperatingState {
    /// State after power-up, until a person makes the control ready.
    NotReady,
    Ready,
    /// Held, with the reason; 0 for the hold register or a person.
    Held(u16),
    /// Alarm with this code.
    AlarmWithCode(u16),
}

/// The simulated control.
pub struct Firmware {
    options: SimulatedModbusOptions,
    executor: JobExecutor,
    operating_state: OperatingState,
    /// The holding registers.
    holding_registers: Vec<u16>,
    /// Lines of the current chunk that have not been started.
    unstarted_lines: VecDeque<String>,
    resident_program: Option<SimulatedResidentProgram>,
    /// Sequence number of the last chunk that was checked, whether it was accepted or refused; 0: none since
    /// power-up.
    checked_sequence: u16,
    /// Sequence number of the last chunk that was executed completely and without error.
    executed_sequence: u16,
    /// Why the last checked chunk was refused or its execution stopped; 0: no error.
    error_code: u16,
    /// Number of contacts since power-up; wraps.
    latch_count: u16,
    /// Latched position of the last contact.
    latched_position: Position,
    /// Simulated time of the last latch; 0 before the first.
    latch_time_s: f64,
    /// Number of status blocks composed so far; wraps.
    status_block_count: u16,
    /// Time at which the client's heartbeat last changed; `None`: not since power-up.
    last_heartbeat_change_time: Option<Duration>,
    /// Number of requests that arrived since the control was built, lost ones included.
    request_count: u64,
    /// Number of chunks accepted since the control was built.
    accepted_chunk_count: u64,
    /// Number of contacts since the control was built.
    contact_count: u64,
    /// Whether the current status shows the previous result.
    shows_previous_result: bool,
    /// Status block of a control whose program has stopped; the control accepts no chunk. `None`: the program runs.
    frozen_status_block: Option<Vec<u16>>,
    /// Value of the control's heartbeat since it stopped; `None`: it counts.
    frozen_heartbeat_value: Option<u16>,
    /// Whether each contact is reported with the time stamp `WRONG_STAMP_S`.
    has_wrong_stamp: bool,
    /// Status block of the last read.
    previous_status_block: Vec<u16>,
    /// Whether no request is answered any more; motion continues.
    is_hung: bool,
    /// Notified to cut all TCP connections.
    cut_signal: Arc<tokio::sync::Notify>,
    event_log: ControlEventLog,
    /// Host time since the control was first powered up; a power cycle does not reset it.
    time_since_start: Duration,
}

impl Firmware {
    pub fn new(world: Arc<Mutex<SimulatedWorld>>, options: SimulatedModbusOptions) -> Self {
        let (resident, size) = match options.has_resident_program {
            true => (Some(SimulatedResidentProgram::default()), layout::PROGRAM_COMMAND_BLOCK_REGISTER_COUNT),
            false => (None, layout::LINE_COMMAND_BLOCK_REGISTER_COUNT),
        };
        Self {
            executor: JobExecutor::new(world, options.pace),
            options,
            operating_state: OperatingState::Ready,
            holding_registers: vec![0; size],
            unstarted_lines: VecDeque::new(),
            resident_program: resident,
            checked_sequence: 0,
            executed_sequence: 0,
            error_code: 0,
            latch_count: 0,
            latched_position: Position::new(),
            latch_time_s: 0.0,
            status_block_count: 0,
            last_heartbeat_change_time: None,
            request_count: 0,
            accepted_chunk_count: 0,
            contact_count: 0,
            shows_previous_result: false,
            frozen_status_block: None,
            frozen_heartbeat_value: None,
            has_wrong_stamp: false,
            previous_status_block: Vec::new(),
            is_hung: false,
            cut_signal: Arc::default(),
            event_log: Arc::default(),
            time_since_start: Duration::ZERO,
        }
    }

    pub fn event_log(&self) -> ControlEventLog {
        self.event_log.clone()
    }

    fn record_event(&self, entry: ControlEvent) {
        // A list stays consistent if another thread panics.
        self.event_log.lock().unwrap_or_else(PoisonError::into_inner).push(entry);
    }

    /// Switches the control off and on; a person must make it ready again.
    fn power_cycle(&mut self) {
        self.stop_at_current_position();
        self.holding_registers.fill(0);
        (self.checked_sequence, self.executed_sequence, self.error_code, self.latch_count) = (0, 0, 0, 0);
        self.last_heartbeat_change_time = None;
        self.resident_program = self.resident_program.take().map(|_| SimulatedResidentProgram::default());
        self.operating_state = OperatingState::NotReady;
    }

    /// Whether a job, lines or a table remain, also a row that waits for an acknowledgement; `false` unless `Ready`.
    fn is_running(&self) -> bool {
        let begun = self.resident_program.as_ref().is_some_and(SimulatedResidentProgram::is_running);
        self.operating_state == OperatingState::Ready
            && (begun || self.executor.active_job.is_some() || !self.unstarted_lines.is_empty())
    }

    /// Whether the client's heartbeat has changed since power-up, at most the timeout before `at`.
    fn is_heartbeat_current(&self, at: Duration) -> bool {
        self.last_heartbeat_change_time.is_some_and(|beat| at <= beat + HEARTBEAT_TIMEOUT)
    }
}
