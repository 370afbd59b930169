//! The simulated control: implements grblHAL's protocol and executes the received text against a [`World`]. It
//! is the peer of the driver and shares no code with it.
//!
//! One extension, switched by [`Options::stamps`]: the status report carries `|Time:<seconds>`, the
//! simulated time, and a contact is followed by `[TIME:<seconds>]`, the time of its trigger.

mod fault;
mod job;
mod say;
mod serve;
mod settings;
pub mod testing;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

use fault::Answer;
pub use fault::{Fault, FaultKind};
use job::Last;

use crate::World;
use crate::interpreter::{
    Active, Code, Interpreter, Job, LineAction, Pace, ProbeInputFault, is_blank,
};
use machine::Position;
use machine::record::machine::Machine;

/// Capacity of the planner, blocks.
const PLANNER: usize = 100;
/// Size of the receive buffer, bytes; further bytes are dropped without a message.
const RX_BUFFER: usize = 1024;
const LONGEST_LINE: usize = 256;

const SOFT_LIMIT: u8 = 2;
const RESET_IN_MOTION: u8 = 3;
const PROBE_CLOSED: u8 = 4;
const NO_CONTACT: u8 = 5;
const HARD_LIMIT: u8 = 1;
const LOCKED: Code = 9;

/// Configuration of the simulated control.
#[derive(Debug, Clone)]
pub struct Options {
    /// Interpreter with the axes and their travel.
    pub reader: Interpreter,
    pub pace: Pace,
    /// Compatibility level: 0 (latches errors) if true, 10 (as Grbl 1.1) if false.
    pub native: bool,
    pub stamps: bool,
    /// Stored settings, by number.
    pub settings: BTreeMap<u16, f64>,
    /// Overrides of feed and rapid speed, percent, as reported; they do not change the speed of motions.
    pub overrides: [u32; 2],
    /// Whether the machine is homed before the first connection.
    pub homed: bool,
    /// Whether a pendant has control, as reported.
    pub has_pendant: bool,
    /// Tool length, mm, as reported; motions do not apply it.
    pub tool_length_mm: f64,
    /// Faults to simulate.
    pub faults: Vec<Fault>,
}

impl Options {
    /// Options for the control of `machine`: native level, time stamps enabled.
    pub fn of(machine: &Machine, pace: Pace) -> Self {
        let (reader, settings) = (Interpreter::of(machine), settings::of(machine));
        Self {
            reader,
            pace,
            native: true,
            stamps: true,
            settings,
            overrides: [100, 100],
            homed: true,
            has_pendant: false,
            tool_length_mm: 0.0,
            faults: Vec::new(),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Lock {
    /// `$X` unlocks.
    Light,
    /// Only a soft reset unlocks.
    Reset,
    /// Only a soft reset unlocks, and until then no line is answered.
    Mute,
}

/// The simulated control: bytes in ([`Firmware::serve`]), bytes out.
pub struct Firmware {
    options: Options,
    world: Arc<Mutex<World>>,
    /// Position of the machine after all queued motion.
    planned: Position,
    rx: VecDeque<u8>,
    out: Vec<u8>,
    queue: VecDeque<Job>,
    active: Option<Active>,
    /// Whether the answer to a line waits for the end of its job.
    waiting: bool,
    held: bool,
    alarm: Option<Lock>,
    latched: Option<Code>,
    booted: bool,
    homed: bool,
    reported: bool,
    /// Result of the last probing move, for `$#`.
    last: Option<Last>,
    /// Number of lines received so far.
    lines: u64,
    touches: u64,
    sham: ProbeInputFault,
    happened: Arc<Mutex<Vec<FaultKind>>>,
    answer: Answer,
    hung: bool,
    door: bool,
    /// Host time at which the control started, and the time since then at the last event.
    since: Instant,
    now: Duration,
}

impl Firmware {
    pub fn new(world: Arc<Mutex<World>>, options: Options) -> Self {
        let mut firmware = Self {
            homed: options.homed,
            options,
            world,
            planned: Position::new(),
            rx: VecDeque::new(),
            out: Vec::new(),
            queue: VecDeque::new(),
            active: None,
            waiting: false,
            held: false,
            alarm: None,
            latched: None,
            booted: false,
            reported: false,
            last: None,
            lines: 0,
            touches: 0,
            sham: ProbeInputFault::default(),
            happened: Arc::default(),
            answer: Answer::default(),
            hung: false,
            door: false,
            since: Instant::now(),
            now: Duration::ZERO,
        };
        firmware.planned = firmware.stand();
        firmware
    }

    /// Faults that have occurred, in their order; a fault that is only configured is not included.
    pub fn happened(&self) -> Arc<Mutex<Vec<FaultKind>>> {
        self.happened.clone()
    }

    fn with_world<T>(&self, act: impl FnOnce(&mut World) -> T) -> T {
        // The world is plain data: a panic elsewhere leaves it consistent.
        act(&mut self.world.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Displayed position of the machine.
    fn stand(&self) -> Position {
        self.with_world(|world| world.position())
    }

    /// Processes received bytes: realtime bytes act at once, at any place in the stream.
    fn ingest(&mut self, bytes: &[u8], now: Duration) {
        self.now = now;
        for byte in bytes {
            match byte {
                b'?' => self.say_status(false),
                0x87 => self.say_status(true),
                b'!' => self.hold(),
                b'~' => (self.held, self.door) = (false, false),
                0x18 => self.reset(),
                0x80.. => {}
                byte if self.rx.len() < RX_BUFFER => self.rx.push_back(*byte),
                _ => {}
            }
        }
    }

    /// Does all work that is due at `now`; returns the delay until the next call.
    fn step(&mut self, now: Duration) -> Option<Duration> {
        self.now = now;
        loop {
            let ends = self.active.as_ref().map(|active| active.ends);
            if ends.is_some_and(|ends| ends <= now) {
                self.finish_active();
            } else if ends.is_none() && !self.held && !self.queue.is_empty() {
                self.start_next();
            } else if let Some(line) = self.next_line() {
                self.line(&line);
            } else {
                return ends;
            }
        }
    }

    fn next_line(&mut self) -> Option<String> {
        if self.waiting || self.hung || self.queue.len() >= PLANNER {
            return None;
        }
        let end = self.rx.iter().position(|byte| matches!(byte, b'\n' | b'\r'))?;
        let bytes: Vec<u8> = self.rx.drain(..=end).collect();
        if bytes.ends_with(b"\r") && self.rx.front() == Some(&b'\n') {
            self.rx.pop_front();
        }
        Some(String::from_utf8_lossy(&bytes).trim().to_owned())
    }

    fn obey(&mut self, line: &str) {
        if self.alarm == Some(Lock::Mute) {
            return;
        }
        if line.len() > LONGEST_LINE {
            return self.say_error(11);
        }
        if let Some(command) = line.strip_prefix('$') {
            return self.dollar(command);
        }
        if is_blank(line) {
            if line.is_empty() {
                self.latched = None;
            }
            return self.say_ok();
        }
        match self.gcode(line) {
            Ok(true) => self.waiting = true,
            Ok(false) => self.say_ok(),
            Err(code) => {
                self.latched = self.options.native.then_some(code);
                self.say_error(code);
            }
        }
    }

    /// Executes a line of G-code; returns whether the answer must wait for a job.
    fn gcode(&mut self, line: &str) -> Result<bool, Code> {
        if let Some(code) = self.latched {
            return Err(code);
        }
        if self.alarm.is_some() {
            return Err(LOCKED);
        }
        let job = match self.options.reader.line(line, &self.planned)? {
            LineAction::Nothing => return Ok(false),
            LineAction::OutOfTravel => return Ok(self.soft_limit()),
            LineAction::Do(job) => job,
        };
        let waits = job.is_waited_for();
        if let Some(to) = job.target() {
            self.planned = self.planned.updated_by(to);
        }
        self.queue.push_back(job);
        Ok(waits)
    }

    /// Soft limit. While idle: an alarm, and the line is answered. While moving: no answer until a reset.
    fn soft_limit(&mut self) -> bool {
        let moving = self.is_moving();
        self.hold();
        self.held = false;
        self.say(&format!("ALARM:{SOFT_LIMIT}"));
        self.stop_here();
        if moving {
            self.alarm = Some(Lock::Mute);
            return true;
        }
        self.say("[MSG:Reset to continue]");
        self.alarm = Some(Lock::Reset);
        false
    }

    fn is_moving(&self) -> bool {
        !self.held && (self.active.is_some() || !self.queue.is_empty())
    }

    /// Discards all motion; the machine stays at its position.
    fn stop_here(&mut self) {
        self.active = None;
        self.queue.clear();
        self.waiting = false;
        self.planned = self.stand();
    }

    /// Soft reset (0x18). A reset during motion makes the position uncertain and raises an alarm.
    fn reset(&mut self) {
        let moving = self.is_moving();
        self.hold();
        self.stop_here();
        self.rx.clear();
        self.held = false;
        self.door = false;
        self.hung = false;
        self.latched = None;
        self.reported = false;
        self.homed = false;
        self.alarm = moving.then_some(Lock::Light);
        if moving {
            self.say(&format!("ALARM:{RESET_IN_MOTION}"));
        }
        self.say_banner();
        if moving {
            self.say("[MSG:'$H'|'$X' to unlock]");
        }
    }
}
