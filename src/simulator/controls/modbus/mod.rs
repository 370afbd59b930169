//! The simulated control behind a window of Modbus registers: executes the received text, or the rows for its resident
//! program, against a [`SimulatedWorld`]. It is the peer of the driver and shares no code with it; its register
//! addresses come from `docs/line-window.md` and `docs/resident-program.md` alone.
//!
//! Its state advances on requests: each request first brings it up to the time of its arrival.

mod chunk;
mod fault;
mod job;
mod layout;
mod registers;
mod resident;
mod serve;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

pub use fault::{Fault, FaultKind};
pub use serve::{serve_rtu, serve_tcp};

use resident::SimulatedResidentProgram;

use super::job_executor::JobExecutor;
use crate::SimulatedWorld;
use crate::interpreter::{Interpreter, SimulationPace};
use machine::Position;
use machine::record::machine::Machine;

const ALARM_HARD_LIMIT: u16 = 1;
const ALARM_SOFT_LIMIT: u16 = 2;
const ALARM_PROBE_CLOSED: u16 = 4;
const ALARM_NO_CONTACT: u16 = 5;
const ALARM_STILL_CLOSED: u16 = 11;
const HOLD_HEARTBEAT_LOST: u16 = 64;

/// Timeout of the client's heartbeat: after it, motion is held and no chunk is accepted.
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

/// One entry of the diary of the control.
#[derive(Debug, Clone, PartialEq)]
pub enum ControlEvent {
    /// A chunk was accepted; `text` describes its lines or the rows of its table.
    Accepted {
        sequence: u16,
        text: String,
    },
    /// A chunk was offered, whether accepted or not.
    Offered {
        sequence: u16,
    },
    /// Latched positions, in steps of 0.001 mm or degree, and the time.
    Contact {
        latch: Vec<i32>,
        t_s: f64,
    },
    Hold,
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
    Alarm(u16),
}

/// The simulated control.
pub struct Firmware {
    options: SimulatedModbusOptions,
    executor: JobExecutor,
    mode: OperatingState,
    /// The holding registers.
    holding_registers: Vec<u16>,
    /// Lines of the current chunk that have not been started.
    pending_lines: VecDeque<String>,
    resident_program: Option<SimulatedResidentProgram>,
    accepted_sequence: u16,
    executed_sequence: u16,
    error_code: u16,
    latch_count: u16,
    latch: Position,
    latch_time_s: f64,
    /// Number of status blocks written so far.
    status_count: u16,
    /// Time at which the client's heartbeat last changed.
    last_heartbeat: Option<Duration>,
    request_count: u64,
    accepted_chunk_count: u64,
    /// Number of contacts since the control was built.
    contact_count: u64,
    /// Whether the current status shows the previous result.
    shows_previous_result: bool,
    /// Status of a frozen control, which accepts nothing.
    frozen_status: Option<Vec<u16>>,
    /// Value of a heartbeat that has stopped.
    stopped_heartbeat: Option<u16>,
    has_wrong_stamp: bool,
    /// The previous status block.
    previous_status: Vec<u16>,
    is_hung: bool,
    cut_signal: Arc<tokio::sync::Notify>,
    diary: ControlEventLog,
    /// Host time since power-up.
    now: Duration,
}

impl Firmware {
    pub fn new(world: Arc<Mutex<SimulatedWorld>>, options: SimulatedModbusOptions) -> Self {
        let (resident, size) = match options.has_resident_program {
            true => (Some(SimulatedResidentProgram::default()), layout::PROGRAM_BLOCK_REGISTERS),
            false => (None, layout::LINE_BLOCK_REGISTERS),
        };
        Self {
            executor: JobExecutor::new(world, options.pace),
            options,
            mode: OperatingState::Ready,
            holding_registers: vec![0; size],
            pending_lines: VecDeque::new(),
            resident_program: resident,
            accepted_sequence: 0,
            executed_sequence: 0,
            error_code: 0,
            latch_count: 0,
            latch: Position::new(),
            latch_time_s: 0.0,
            status_count: 0,
            last_heartbeat: None,
            request_count: 0,
            accepted_chunk_count: 0,
            contact_count: 0,
            shows_previous_result: false,
            frozen_status: None,
            stopped_heartbeat: None,
            has_wrong_stamp: false,
            previous_status: Vec::new(),
            is_hung: false,
            cut_signal: Arc::default(),
            diary: Arc::default(),
            now: Duration::ZERO,
        }
    }

    pub fn event_log(&self) -> ControlEventLog {
        self.diary.clone()
    }

    fn record(&self, entry: ControlEvent) {
        // A list stays consistent if another thread panics.
        self.diary.lock().unwrap_or_else(PoisonError::into_inner).push(entry);
    }

    /// Switches the control off and on; a person must make it ready again.
    fn reset(&mut self) {
        self.stop_at_current_position();
        self.holding_registers.fill(0);
        (self.accepted_sequence, self.executed_sequence, self.error_code, self.latch_count) = (0, 0, 0, 0);
        self.last_heartbeat = None;
        self.resident_program = self.resident_program.take().map(|_| SimulatedResidentProgram::default());
        self.mode = OperatingState::NotReady;
    }

    fn is_moving(&self) -> bool {
        let begun = self.resident_program.as_ref().is_some_and(SimulatedResidentProgram::is_running);
        self.mode == OperatingState::Ready
            && (begun || self.executor.active.is_some() || !self.pending_lines.is_empty())
    }

    fn is_heartbeat_current(&self, at: Duration) -> bool {
        self.last_heartbeat.is_some_and(|beat| at <= beat + HEARTBEAT_TIMEOUT)
    }
}
