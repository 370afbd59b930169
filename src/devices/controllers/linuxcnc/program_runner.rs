//! Runs a program and watches that it moves and that LinuxCNC's task is alive.
//!
//! linuxcncrsh answers `get` from a copy of the task's state. If the task is frozen or dead, the copy
//! becomes outdated and the answers continue. Only an acknowledgement of the task proves that it is alive:
//! a `set` waits for it. So after [`SIGN_OF_LIFE_INTERVAL`] without a change, the driver sets a setting to its present
//! value.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::files::SharedFiles;
use super::result_log::ResultLog;
use super::rsh::RshClient;
use super::{path_check, state};
use crate::controllers::{ControllerError, HaltHandle};
use machine::record::motion::Motion;
use machine::{Axis, Position};
use planning::gcode::TransmissionUnit;

/// Polling interval. In LinuxCNC's sample configurations the task runs every 5 ms.
const POLL_INTERVAL: Duration = Duration::from_millis(4);
/// A program without the log line `END` counts as stopped if it is idle for this time, and again for this time after a
/// sign of life.
const STOP_CONFIRM_TIME: Duration = Duration::from_millis(60);
/// Time without a change after which a sign of life is requested, and interval of the requests.
const SIGN_OF_LIFE_INTERVAL: Duration = Duration::from_secs(1);
/// Maximum time for which a running program on a live task may neither move nor log. After it, a feed hold or an
/// interlock is assumed.
const MAX_STALL_TIME: Duration = Duration::from_secs(10);

/// Maximum time for the machine to come to rest after a hold, from any speed.
const MAX_BRAKING_TIME: Duration = Duration::from_secs(5);
/// Maximum time until the task updates its reported state.
const MAX_STATE_UPDATE_TIME: Duration = Duration::from_millis(30);
/// Largest change of the feedback of an axis at rest, mm or degrees.
const MAX_MOVEMENT_AT_REST_MM_OR_DEG: f64 = 0.01;

/// Limits by which the runner detects a stall or an unexpected contact of a program.
#[derive(Debug, Clone, Copy)]
pub(super) struct WatchedProgram<'a> {
    /// Step that errors name; 0 for a program that belongs to no block.
    pub step: u32,
    /// Maximum time for which the program itself lets the machine rest, in addition to [`MAX_STALL_TIME`].
    pub planned_standstill_time: Duration,
    /// End position of the program's rotary axes, if one of them turns at feed: a contact before that position is
    /// unexpected.
    pub feed_turn_end_position: Option<&'a Position>,
}

/// Maximum time for which the program itself lets the machine rest: dwells, spindle orientation, clamps.
pub(super) fn planned_program_standstill_time(part: &TransmissionUnit) -> Duration {
    let seconds = part.motions.iter().map(|motion| match motion {
        Motion::Dwell { seconds } => seconds.max(0.0),
        // Maximum time that the dialect allows.
        Motion::OrientSpindle { .. } => 20.0,
        _ => 0.0,
    });
    let seconds = seconds.sum::<f64>() + part.clamp_wait_s;
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO)
}

/// Runs the open program until it has ended or stopped, and returns its log. The log of a program that stopped early
/// is not complete. If the program has ended, its log is returned even if `halt` came meanwhile.
///
/// # Errors
/// A contact during a turn, a stalled or paused program, a halt, a fault of the link.
pub(super) async fn run_program(
    rsh: &mut RshClient,
    files: &SharedFiles,
    halt: &HaltHandle,
    program: WatchedProgram<'_>,
) -> Result<ResultLog, ControllerError> {
    let WatchedProgram { step, planned_standstill_time: standstill_time, feed_turn_end_position } = program;
    rsh.send_task_command("run").await?;
    let (mut idle_since, mut is_refreshed) = (None, false);
    let mut halted_since = None;
    let mut progress = ProgressMonitor::start();
    loop {
        if let Some(turn_end_position) = feed_turn_end_position
            && has_contact_during_turn(rsh, turn_end_position).await?
        {
            return Err(ControllerError::UnexpectedContact { step });
        }
        let status = rsh.get("program_status").await?;
        let log = files.read_log(step)?;
        match status.as_str() {
            "IDLE" if log.is_complete => return Ok(log),
            // A complete log is returned even after a halt, if the program ends within `STOP_CONFIRM_TIME`.
            _ if halt.is_halt_requested()
                && (!log.is_complete
                    || halted_since.get_or_insert_with(Instant::now).elapsed() > STOP_CONFIRM_TIME) =>
            {
                return Err(ControllerError::Halted);
            }
            "IDLE" => {
                let since = *idle_since.get_or_insert_with(Instant::now);
                let stopped = since.elapsed() > STOP_CONFIRM_TIME;
                if stopped && is_refreshed {
                    return Ok(log);
                }
                if stopped {
                    refresh_state(rsh).await?;
                    (idle_since, is_refreshed) = (None, true);
                }
            }
            "PAUSED" => return Err(paused_error("pause was pressed")),
            _ => {
                (idle_since, is_refreshed) = (None, false);
                progress.check_not_stalled(rsh, log.line_count, standstill_time).await?;
            }
        }
        sleep(POLL_INTERVAL).await;
    }
}

/// Whether the probe reads closed before the rotary axes have reached `turn_end_position`. The touch of the same
/// program begins after that.
async fn has_contact_during_turn(rsh: &mut RshClient, turn_end_position: &Position) -> Result<bool, ControllerError> {
    if rsh.get("probe_value").await? == "0" {
        return Ok(false);
    }
    let axes: Vec<Axis> = turn_end_position.iter().map(|(axis, _)| axis).collect();
    let position = state::read_position(rsh, &axes).await?;
    Ok(path_check::check_position(turn_end_position, &position).is_err())
}

/// Watches how long neither the position nor the log of the running program has changed.
struct ProgressMonitor {
    unchanged_since: Instant,
    last_position_and_line_count: (String, usize),
    /// Time of the last request for a sign of life.
    last_sign_of_life: Instant,
}

impl ProgressMonitor {
    fn start() -> Self {
        Self {
            unchanged_since: Instant::now(),
            last_position_and_line_count: (String::new(), 0),
            last_sign_of_life: Instant::now(),
        }
    }

    /// Error if the program neither moves nor logs for too long, if the task does not answer, or at 0 % feed override.
    async fn check_not_stalled(
        &mut self,
        rsh: &mut RshClient,
        log_line_count: usize,
        planned_standstill_time: Duration,
    ) -> Result<(), ControllerError> {
        let now = (rsh.get("abs_act_pos").await?, log_line_count);
        if now != self.last_position_and_line_count {
            *self = Self { last_position_and_line_count: now, ..Self::start() };
        }
        if self.last_sign_of_life.elapsed() < SIGN_OF_LIFE_INTERVAL {
            return Ok(());
        }
        request_sign_of_life(rsh).await?;
        if rsh.get("feed_override").await? == "0" {
            return Err(paused_error("the feed override is 0 %"));
        }
        if self.unchanged_since.elapsed() > MAX_STALL_TIME + planned_standstill_time {
            return Err(paused_error("the program runs, but the machine does not move: a feed hold or an interlock"));
        }
        self.last_sign_of_life = Instant::now();
        Ok(())
    }
}

/// Ensures that the reported state is current: a task that answers a command has updated its state. On a slow computer,
/// a reported idle may be older than the start of the program, and a message may be outstanding. A task of a stopped
/// machine refuses the command, which is an answer too.
async fn refresh_state(rsh: &mut RshClient) -> Result<(), ControllerError> {
    match request_sign_of_life(rsh).await {
        Err(ControllerError::LineRefused { .. }) => Ok(()),
        result => result,
    }
}

/// Sets a harmless setting to its present value. The task must acknowledge it, which it does at once, also
/// while a program runs. (`set mode auto` is not harmless: it aborts.)
pub(super) async fn request_sign_of_life(rsh: &mut RshClient) -> Result<(), ControllerError> {
    let stop = rsh.get("optional_stop").await?;
    rsh.send_task_command(&format!("optional_stop {stop}")).await
}

/// Repeats a hold until the machine is at rest. The first hold, on a connection of its own, may be lost:
/// linuxcncrsh (2.9) has a thread for each connection and parses in all of them with one `strtok`, so that
/// of two lines that come together one or both may be answered as other lines (two holds of 125 were lost
/// under load; the answer to one was `SET NAK`). A request with an odd answer, or with none, is repeated.
///
/// # Errors
/// The control has not accepted an abort in time, or the machine is not at rest; a fault of the link.
pub(super) async fn abort_until_at_rest(rsh: &mut RshClient) -> Result<(), ControllerError> {
    let deadline = Instant::now() + MAX_BRAKING_TIME;
    // Wait, so that the first hold is processed alone.
    sleep(MAX_STATE_UPDATE_TIME).await;
    while Instant::now() < deadline {
        if ignore_odd_reply(rsh.acquire_command_right().await)?.is_some()
            && ignore_odd_reply(rsh.send_task_command("abort").await)?.is_some()
            && ignore_odd_reply(is_at_rest(rsh).await)? == Some(true)
        {
            return Ok(());
        }
        // A control that is off refuses everything, and its machine is at rest.
        if ignore_odd_reply(is_off(rsh).await)? == Some(true) {
            return Ok(());
        }
    }
    Err(ControllerError::HoldFailed { seconds: MAX_BRAKING_TIME.as_secs_f64() })
}

/// Whether no program runs and three reports in a row show no motion: a report may be older than the one before.
pub(super) async fn is_at_rest(rsh: &mut RshClient) -> Result<bool, ControllerError> {
    let mm = state::read_length_unit_mm(rsh).await?;
    let mut before = state::read_numbers(rsh, "abs_act_pos").await?;
    for _ in 0..2 {
        sleep(MAX_STATE_UPDATE_TIME).await;
        let now = state::read_numbers(rsh, "abs_act_pos").await?;
        let moved = before.iter().zip(&now).any(|(a, b)| (a - b).abs() * mm > MAX_MOVEMENT_AT_REST_MM_OR_DEG);
        if moved || rsh.get("program_status").await? != "IDLE" {
            return Ok(false);
        }
        before = now;
    }
    Ok(true)
}

/// Whether the emergency stop is active or the machine is switched off.
async fn is_off(rsh: &mut RshClient) -> Result<bool, ControllerError> {
    Ok(rsh.get("estop").await? != "OFF" || rsh.get("machine").await? != "ON")
}

/// Returns `None` for an odd answer or for none; a lost link is an error.
fn ignore_odd_reply<T>(result: Result<T, ControllerError>) -> Result<Option<T>, ControllerError> {
    use ControllerError as E;
    match result {
        Err(
            E::LineRefused { .. }
            | E::NoAnswer { .. }
            | E::UnreadableReply { .. }
            | E::ControlFrozen
            | E::NotReady { .. },
        ) => Ok(None),
        result => result.map(Some),
    }
}

fn paused_error(reason: &str) -> ControllerError {
    ControllerError::ProgramPaused { reason: reason.to_owned() }
}
