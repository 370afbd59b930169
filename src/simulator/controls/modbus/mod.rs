//! The simulated control behind a window of Modbus registers: executes the text it is given, or the
//! rows for the program that it holds, against a [`World`]. It is the driver's peer and shares none of its
//! code; where the items lie it knows from `docs/line-window.md` and `docs/resident-program.md` alone.
//!
//! It lives when it is asked: a request first brings it up to the time at which it comes.

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
use crate::interpreter::{Active, Interpreter, Pace, Sham};
use machine::Position;
use machine::record::machine::Machine;

const HARD_LIMIT: u16 = 1;
const SOFT_LIMIT: u16 = 2;
const PROBE_CLOSED: u16 = 4;
const NO_CONTACT: u16 = 5;
const STILL_CLOSED: u16 = 11;
const HEARTBEAT_LOST: u16 = 64;

/// Without a heartbeat from the other side for so long, what moves is held and nothing is taken.
const HEARTBEAT: Duration = Duration::from_secs(2);

/// How this control is built.
#[derive(Debug, Clone)]
pub struct Options {
    /// Its axes and their travel.
    pub reader: Interpreter,
    pub pace: Pace,
    /// What goes wrong.
    pub faults: Vec<Fault>,
    /// It holds a measuring program, and takes no lines.
    pub resident: bool,
}

impl Options {
    pub fn of(machine: &Machine, pace: Pace) -> Self {
        Self { reader: Interpreter::of(machine), pace, faults: Vec::new(), resident: false }
    }
}

/// What the control did, in its order.
#[derive(Debug, Clone, PartialEq)]
pub enum Entry {
    /// A chunk was taken; `text` says the rows of a table in words.
    Took {
        sequence: u16,
        text: String,
    },
    /// A chunk was offered, taken or not.
    Asked {
        sequence: u16,
    },
    /// Positions as latched, in steps of 0.001 mm or degree, and the time.
    Contact {
        latch: Vec<i32>,
        t_s: f64,
    },
    Hold,
    Wrong(FaultKind),
}

pub type Diary = Arc<Mutex<Vec<Entry>>>;

/// What the machine does, besides its motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// After switching on, until a person makes it ready.
    NotReady,
    Ready,
    /// With the reason, 0 for the hold register or a person.
    Held(u16),
    Alarm(u16),
}

/// The control.
pub struct Firmware {
    options: Options,
    world: Arc<Mutex<World>>,
    mode: Mode,
    /// The holding registers.
    command: Vec<u16>,
    /// Of the chunk in hand, those that are not begun.
    lines: VecDeque<String>,
    resident: Option<Resident>,
    active: Option<Active>,
    accepted: u16,
    executed: u16,
    error: u16,
    latches: u16,
    latch: Position,
    latch_time_s: f64,
    /// Status blocks written so far.
    blocks: u16,
    sham: Sham,
    /// When the other side's heartbeat last changed.
    beat: Option<Duration>,
    requests: u64,
    taken: u64,
    /// Contacts since it was built.
    touches: u64,
    /// The status under way shows the result before.
    stale_result: bool,
    /// It takes nothing, and its status stays as it was.
    frozen: Option<Vec<u16>>,
    /// Its heartbeat stays at this value.
    standing_heartbeat: Option<u16>,
    wrong_stamp: bool,
    /// The block before.
    shown: Vec<u16>,
    hung: bool,
    cut: Arc<tokio::sync::Notify>,
    diary: Diary,
    /// Host time since it was switched on.
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
            sham: Sham::default(),
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
        // A list is whole whatever panicked beside it.
        self.diary.lock().unwrap_or_else(PoisonError::into_inner).push(entry);
    }

    fn with_world<T>(&self, act: impl FnOnce(&mut World) -> T) -> T {
        // The world is plain data: a panic elsewhere leaves it whole.
        act(&mut self.world.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Where the machine stands.
    fn stand(&self) -> Position {
        self.with_world(|world| world.position())
    }

    /// Switched off and on: a person has to make it ready.
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
