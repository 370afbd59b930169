//! The simulated control behind a window of Modbus registers: executes the received text, or the rows for its
//! resident program, against a [`World`]. It is the peer of the driver and shares no code with it; its register
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

use resident::Resident;

use crate::World;
use crate::interpreter::{Active, Interpreter, Pace, ProbeInputFault};
use machine::Position;
use machine::record::machine::Machine;

const HARD_LIMIT: u16 = 1;
const SOFT_LIMIT: u16 = 2;
const PROBE_CLOSED: u16 = 4;
const NO_CONTACT: u16 = 5;
const STILL_CLOSED: u16 = 11;
const HEARTBEAT_LOST: u16 = 64;

/// Timeout of the client's heartbeat: after it, motion is held and no chunk is accepted.
const HEARTBEAT: Duration = Duration::from_secs(2);

/// Configuration of the simulated control.
#[derive(Debug, Clone)]
pub struct Options {
    /// Interpreter with the axes and their travel.
    pub reader: Interpreter,
    pub pace: Pace,
    /// Faults to simulate.
    pub faults: Vec<Fault>,
    /// Whether the control holds a resident measuring program; it then accepts no lines.
    pub resident: bool,
}

impl Options {
    pub fn of(machine: &Machine, pace: Pace) -> Self {
        Self { reader: Interpreter::of(machine), pace, faults: Vec::new(), resident: false }
    }
}

/// One entry of the diary of the control.
#[derive(Debug, Clone, PartialEq)]
pub enum Entry {
    /// A chunk was accepted; `text` describes its lines or the rows of its table.
    Took {
        sequence: u16,
        text: String,
    },
    /// A chunk was offered, whether accepted or not.
    Asked {
        sequence: u16,
    },
    /// Latched positions, in steps of 0.001 mm or degree, and the time.
    Contact {
        latch: Vec<i32>,
        t_s: f64,
    },
    Hold,
    Wrong(FaultKind),
}

pub type Diary = Arc<Mutex<Vec<Entry>>>;

/// Operating state of the control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// State after power-up, until a person makes the control ready.
    NotReady,
    Ready,
    /// Held, with the reason; 0 for the hold register or a person.
    Held(u16),
    Alarm(u16),
}

/// The simulated control.
pub struct Firmware {
    options: Options,
    world: Arc<Mutex<World>>,
    mode: Mode,
    /// The holding registers.
    command: Vec<u16>,
    /// Lines of the current chunk that have not been started.
    lines: VecDeque<String>,
    resident: Option<Resident>,
    active: Option<Active>,
    accepted: u16,
    executed: u16,
    error: u16,
    latches: u16,
    latch: Position,
    latch_time_s: f64,
    /// Number of status blocks written so far.
    blocks: u16,
    sham: ProbeInputFault,
    /// Time at which the client's heartbeat last changed.
    beat: Option<Duration>,
    requests: u64,
    taken: u64,
    /// Number of contacts since the control was built.
    touches: u64,
    /// Whether the current status shows the previous result.
    stale_result: bool,
    /// Status of a frozen control, which accepts nothing.
    frozen: Option<Vec<u16>>,
    /// Value of a heartbeat that has stopped.
    standing_heartbeat: Option<u16>,
    wrong_stamp: bool,
    /// The previous status block.
    shown: Vec<u16>,
    hung: bool,
    cut: Arc<tokio::sync::Notify>,
    diary: Diary,
    /// Host time since power-up.
    now: Duration,
}

impl Firmware {
    pub fn new(world: Arc<Mutex<World>>, options: Options) -> Self {
        let (resident, size) = match options.resident {
            true => (Some(Resident::default()), layout::OF_PROGRAM),
            false => (None, layout::OF_LINES),
        };
        Self {
            options,
            world,
            mode: Mode::Ready,
            command: vec![0; size],
            lines: VecDeque::new(),
            resident,
            active: None,
            accepted: 0,
            executed: 0,
            error: 0,
            latches: 0,
            latch: Position::new(),
            latch_time_s: 0.0,
            blocks: 0,
            sham: ProbeInputFault::default(),
            beat: None,
            requests: 0,
            taken: 0,
            touches: 0,
            stale_result: false,
            frozen: None,
            standing_heartbeat: None,
            wrong_stamp: false,
            shown: Vec::new(),
            hung: false,
            cut: Arc::default(),
            diary: Arc::default(),
            now: Duration::ZERO,
        }
    }

    pub fn diary(&self) -> Diary {
        self.diary.clone()
    }

    fn note(&self, entry: Entry) {
        // A list stays consistent if another thread panics.
        self.diary.lock().unwrap_or_else(PoisonError::into_inner).push(entry);
    }

    fn with_world<T>(&self, act: impl FnOnce(&mut World) -> T) -> T {
        // The world is plain data: a panic elsewhere leaves it consistent.
        act(&mut self.world.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Displayed position of the machine.
    fn stand(&self) -> Position {
        self.with_world(|world| world.position())
    }

    /// Switches the control off and on; a person must make it ready again.
    fn reset(&mut self) {
        self.stop_here();
        self.command.fill(0);
        (self.accepted, self.executed, self.error, self.latches) = (0, 0, 0, 0);
        self.beat = None;
        self.resident = self.resident.take().map(|_| Resident::default());
        self.mode = Mode::NotReady;
    }

    fn is_moving(&self) -> bool {
        let begun = self.resident.as_ref().is_some_and(Resident::is_running);
        self.mode == Mode::Ready && (begun || self.active.is_some() || !self.lines.is_empty())
    }

    fn beats(&self, at: Duration) -> bool {
        self.beat.is_some_and(|beat| at <= beat + HEARTBEAT)
    }
}
