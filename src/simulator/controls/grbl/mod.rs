//! The simulated control: implements grblHAL's protocol and executes the received text against a [`SimulatedWorld`]. It
//! is the peer of the driver and shares no code with it.
//!
//! One extension, switched by [`SimulatedGrblOptions::has_time_stamps`]: the status report carries `|Time:<seconds>`,
//! the simulated time, and a contact is followed by `[TIME:<seconds>]`, the time at which it was latched.

mod fault;
mod job;
mod reports;
mod serve;
mod settings;
pub mod testing;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::time::Instant;

use fault::AnswerCount;
pub use fault::{Fault, FaultKind};
use job::LastProbeResult;

use super::job_executor::JobExecutor;
use crate::SimulatedWorld;
use crate::interpreter::{GrblErrorCode, Interpreter, Job, LineAction, SimulationPace, is_blank};
use machine::Position;
use machine::record::machine::Machine;

/// Capacity of the planner, blocks.
const PLANNER_BLOCK_COUNT: usize = 100;
/// Size of the receive buffer, bytes; further bytes are dropped without a message.
const RX_BUFFER_BYTES: usize = 1024;
const MAX_LINE_BYTES: usize = 256;

const ALARM_SOFT_LIMIT: u8 = 2;
const ALARM_RESET_IN_MOTION: u8 = 3;
const ALARM_PROBE_CLOSED: u8 = 4;
const ALARM_NO_CONTACT: u8 = 5;
const ALARM_HARD_LIMIT: u8 = 1;
const ERROR_LOCKED: GrblErrorCode = 9;

/// Configuration of the simulated control.
#[derive(Debug, Clone)]
pub struct SimulatedGrblOptions {
    /// Interpreter with the axes and their travel.
    pub interpreter: Interpreter,
    pub pace: SimulationPace,
    /// Compatibility level: 0 (latches errors) if true, 10 (as Grbl 1.1) if false.
    pub is_compatibility_level_0: bool,
    /// Whether status reports and contacts carry the simulated time: an extension of grblHAL.
    pub has_time_stamps: bool,
    /// Values of the stored `$` settings, by number.
    pub settings_by_number: BTreeMap<u16, f64>,
    /// Overrides of feed and rapid speed, percent, as reported; they do not change the speed of motions.
    pub feed_and_rapid_override_percent: [u32; 2],
    /// Whether the machine is homed before the first connection.
    pub is_homed: bool,
    /// Whether a pendant has control, as reported.
    pub is_pendant_in_control: bool,
    /// Tool length, mm, as reported; motions do not apply it.
    pub reported_tool_length_mm: f64,
    /// Faults to simulate.
    pub faults: Vec<Fault>,
}

impl SimulatedGrblOptions {
    /// Options for the control of `machine`: compatibility level 0, time stamps enabled.
    pub fn for_machine(machine: &Machine, pace: SimulationPace) -> Self {
        let (interpreter, settings) = (Interpreter::for_machine(machine), settings::machine_settings(machine));
        Self {
            interpreter,
            pace,
            is_compatibility_level_0: true,
            has_time_stamps: true,
            settings_by_number: settings,
            feed_and_rapid_override_percent: [100, 100],
            is_homed: true,
            is_pendant_in_control: false,
            reported_tool_length_mm: 0.0,
            faults: Vec::new(),
        }
    }
}

/// Input that unlocks the control after an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum AlarmLock {
    /// `$X`, `$H` or a soft reset unlocks.
    Unlockable,
    /// Only a soft reset unlocks.
    NeedsReset,
    /// Only a soft reset unlocks, and until then no line is answered.
    SilentUntilReset,
}

/// The simulated control: bytes in ([`Firmware::serve`]), bytes out.
pub struct Firmware {
    options: SimulatedGrblOptions,
    executor: JobExecutor,
    /// Position of the machine after all queued motion.
    planned_position: Position,
    /// Received bytes that are not yet taken as a line; realtime bytes never enter it.
    receive_buffer: VecDeque<u8>,
    send_buffer: Vec<u8>,
    /// Accepted jobs that have not started.
    job_queue: VecDeque<Job>,
    /// Whether the answer to a line waits for the end of its job.
    is_answer_pending: bool,
    /// Feed hold: no further job starts until `~` or a soft reset.
    is_held: bool,
    alarm_lock: Option<AlarmLock>,
    /// Error that refuses all further G-code until an empty line, a `$` command or a soft reset; at compatibility
    /// level 0 only.
    latched_error: Option<GrblErrorCode>,
    /// Whether the banner of the first start has been sent.
    has_booted: bool,
    /// Whether the control reports its axes as homed; motion does not depend on it.
    is_homed: bool,
    /// Whether a status report has been sent since the start or the last soft reset.
    has_sent_status_report: bool,
    /// Result of the last probing move, for `$#`.
    last_probe: Option<LastProbeResult>,
    /// Number of lines taken from the receive buffer since the control was built, blank and refused ones included.
    received_line_count: u64,
    /// Number of contacts since the control was built; a reset keeps it.
    contact_count: u64,
    occurred_faults: Arc<Mutex<Vec<FaultKind>>>,
    next_answer_count: AnswerCount,
    /// [`FaultKind::Silence`]: no line is read and nothing is sent until a soft reset.
    is_hung: bool,
    is_door_open: bool,
    /// Host time at which the control started.
    start_instant: Instant,
    /// Time of the last event, counted from the start of the control.
    time_since_start: Duration,
}

impl Firmware {
    pub fn new(world: Arc<Mutex<SimulatedWorld>>, options: SimulatedGrblOptions) -> Self {
        let mut firmware = Self {
            is_homed: options.is_homed,
            executor: JobExecutor::new(world, options.pace),
            options,
            planned_position: Position::new(),
            receive_buffer: VecDeque::new(),
            send_buffer: Vec::new(),
            job_queue: VecDeque::new(),
            is_answer_pending: false,
            is_held: false,
            alarm_lock: None,
            latched_error: None,
            has_booted: false,
            has_sent_status_report: false,
            last_probe: None,
            received_line_count: 0,
            contact_count: 0,
            occurred_faults: Arc::default(),
            next_answer_count: AnswerCount::default(),
            is_hung: false,
            is_door_open: false,
            start_instant: Instant::now(),
            time_since_start: Duration::ZERO,
        };
        firmware.planned_position = firmware.executor.displayed_position();
        firmware
    }

    /// Faults that have occurred, in their order; a fault that is only configured is not included.
    pub fn occurred_faults(&self) -> Arc<Mutex<Vec<FaultKind>>> {
        self.occurred_faults.clone()
    }

    /// Processes received bytes: realtime bytes act at once, at any place in the stream.
    fn receive_bytes(&mut self, bytes: &[u8], now: Duration) {
        self.time_since_start = now;
        for byte in bytes {
            match byte {
                b'?' => self.send_status(false),
                0x87 => self.send_status(true),
                b'!' => self.hold(),
                b'~' => (self.is_held, self.is_door_open) = (false, false),
                0x18 => self.soft_reset(),
                0x80.. => {}
                byte if self.receive_buffer.len() < RX_BUFFER_BYTES => self.receive_buffer.push_back(*byte),
                _ => {}
            }
        }
    }

    /// Does all work that is due at `now`. Returns the time of the next work; `None`: no work without new input.
    fn advance_and_return_wake_time(&mut self, now: Duration) -> Option<Duration> {
        self.time_since_start = now;
        loop {
            let ends = self.executor.active_job.as_ref().map(|active| active.end_time);
            if ends.is_some_and(|ends| ends <= now) {
                self.finish_active_job();
            } else if ends.is_none() && !self.is_held && !self.job_queue.is_empty() {
                self.start_next_job();
            } else if let Some(line) = self.take_next_line() {
                self.execute_line_or_fault(&line);
            } else {
                return ends;
            }
        }
    }

    /// Removes the next complete line from the receive buffer. `None`: there is none, or the control accepts no line
    /// now.
    fn take_next_line(&mut self) -> Option<String> {
        if self.is_answer_pending || self.is_hung || self.job_queue.len() >= PLANNER_BLOCK_COUNT {
            return None;
        }
        let end = self.receive_buffer.iter().position(|byte| matches!(byte, b'\n' | b'\r'))?;
        let bytes: Vec<u8> = self.receive_buffer.drain(..=end).collect();
        if bytes.ends_with(b"\r") && self.receive_buffer.front() == Some(&b'\n') {
            self.receive_buffer.pop_front();
        }
        Some(String::from_utf8_lossy(&bytes).trim().to_owned())
    }

    fn execute_line(&mut self, line: &str) {
        if self.alarm_lock == Some(AlarmLock::SilentUntilReset) {
            return;
        }
        if line.len() > MAX_LINE_BYTES {
            return self.send_error(11);
        }
        if let Some(command) = line.strip_prefix('$') {
            return self.run_dollar_command(command);
        }
        if is_blank(line) {
            if line.is_empty() {
                self.latched_error = None;
            }
            return self.send_ok();
        }
        match self.execute_gcode(line) {
            Ok(true) => self.is_answer_pending = true,
            Ok(false) => self.send_ok(),
            Err(code) => {
                self.latched_error = self.options.is_compatibility_level_0.then_some(code);
                self.send_error(code);
            }
        }
    }

    /// Executes a line of G-code. Returns whether its answer must wait: for the end of its job, or, after a soft-limit
    /// alarm in motion, for a reset.
    fn execute_gcode(&mut self, line: &str) -> Result<bool, GrblErrorCode> {
        if let Some(code) = self.latched_error {
            return Err(code);
        }
        if self.alarm_lock.is_some() {
            return Err(ERROR_LOCKED);
        }
        let job = match self.options.interpreter.interpret_line(line, &self.planned_position)? {
            LineAction::NoMotion => return Ok(false),
            LineAction::OutOfTravel => return Ok(self.raise_soft_limit_alarm()),
            LineAction::Execute(job) => job,
        };
        let waits = job.is_acknowledged_at_end();
        if let Some(to) = job.target() {
            self.planned_position = self.planned_position.updated_by(to);
        }
        self.job_queue.push_back(job);
        Ok(waits)
    }

    /// Raises a soft-limit alarm. Idle: the line is answered. Moving: no answer until a reset; returns `true`.
    fn raise_soft_limit_alarm(&mut self) -> bool {
        let moving = self.is_moving();
        self.hold();
        self.is_held = false;
        self.raise_alarm(ALARM_SOFT_LIMIT, if moving { AlarmLock::SilentUntilReset } else { AlarmLock::NeedsReset });
        if !moving {
            self.send_line("[MSG:Reset to continue]");
        }
        moving
    }

    /// Reports the alarm, discards all motion and locks the control.
    fn raise_alarm(&mut self, code: u8, lock: AlarmLock) {
        self.send_line(&format!("ALARM:{code}"));
        self.discard_all_motion();
        self.alarm_lock = Some(lock);
    }

    /// Whether a job is active or queued, a dwell included; `false` during a feed hold.
    fn is_moving(&self) -> bool {
        !self.is_held && (self.executor.active_job.is_some() || !self.job_queue.is_empty())
    }

    /// Discards all motion. The machine stays at its position in the world, which contains the part already travelled
    /// of the active job only if `hold` was called before.
    fn discard_all_motion(&mut self) {
        self.executor.active_job = None;
        self.job_queue.clear();
        self.is_answer_pending = false;
        self.planned_position = self.executor.displayed_position();
    }

    /// Soft reset (0x18). A reset during motion makes the position uncertain and raises an alarm; otherwise an alarm
    /// is cleared. The control is no longer homed.
    fn soft_reset(&mut self) {
        let moving = self.is_moving();
        self.hold();
        self.discard_all_motion();
        self.receive_buffer.clear();
        self.is_held = false;
        self.is_door_open = false;
        self.is_hung = false;
        self.latched_error = None;
        self.has_sent_status_report = false;
        self.is_homed = false;
        self.alarm_lock = moving.then_some(AlarmLock::Unlockable);
        if moving {
            self.send_line(&format!("ALARM:{ALARM_RESET_IN_MOTION}"));
        }
        self.send_banner();
        if moving {
            self.send_line("[MSG:'$H'|'$X' to unlock]");
        }
    }
}
