//! Runs a program and watches that it moves and that LinuxCNC's task is alive.
//!
//! linuxcncrsh answers `get` from a copy of the task's state. If the task is frozen or dead, the copy
//! becomes outdated and the answers continue. Only an acknowledgement of the task proves that it is alive:
//! a `set` waits for it. So after [`SIGN_OF_LIFE_INTERVAL`] without a change, the driver sets a setting to its present
//! value.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::files::Files;
use super::result::Log;
use super::rsh::Rsh;
use super::{state, way};
use crate::controllers::{ControllerError, Halt};
use machine::record::motion::Motion;
use machine::{Axis, Position};
use planning::gcode::Unit;

/// Polling interval. LinuxCNC's task runs every 5 ms in its own samples.
const POLL: Duration = Duration::from_millis(4);
/// Time idle without the log's end, before and again after a sign of life, after which the program counts
/// as stopped.
const STOPPED: Duration = Duration::from_millis(60);
/// Time without a change after which a sign of life is requested, and interval of the requests.
const SIGN_OF_LIFE_INTERVAL: Duration = Duration::from_secs(1);
/// Maximum time for which a running program on a live task may neither move nor log: after it something
/// holds the program.
const STALL: Duration = Duration::from_secs(10);

/// Maximum time for the machine to come to rest after a hold, from any speed.
const BRAKES: Duration = Duration::from_secs(5);
/// Maximum time until the task updates its reported state. `AT_REST` is the largest change of the feedback
/// at rest, mm or degrees.
const STATE_UPDATE_TIME: Duration = Duration::from_millis(30);
const AT_REST: f64 = 0.01;

/// The program that is watched.
#[derive(Debug, Clone, Copy)]
pub(super) struct Watched<'a> {
    pub step: u32,
    /// Time without motion that the program may need, in addition to [`STALL`].
    pub rests: Duration,
    /// End position of its rotary axes, if one of them turns at feed: a contact before that position is
    /// unexpected.
    pub turns_to: Option<&'a Position>,
}

/// Time for which a program is at rest by itself.
pub(super) fn rests(part: &Unit) -> Duration {
    let seconds = part.motions.iter().map(|motion| match motion {
        Motion::Dwell { seconds } => seconds.max(0.0),
        // Maximum time that the dialect allows.
        Motion::Orient { .. } => 20.0,
        _ => 0.0,
    });
    let seconds = seconds.sum::<f64>() + part.clamps_rest_s;
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO)
}

/// Runs the open program and waits until the machine is at rest. If the program has ended, its log is
/// returned even if `halt` came meanwhile.
///
/// # Errors
/// A contact, if the probe is read; an obstacle that holds the program; a halt; a fault of the link.
pub(super) async fn run(
    rsh: &mut Rsh,
    files: &Files,
    halt: &Halt,
    watched: Watched<'_>,
) -> Result<Log, ControllerError> {
    let Watched { step, rests, turns_to } = watched;
    rsh.command("run").await?;
    let (mut idle_since, mut settled) = (None, false);
    let mut halted_since = None;
    let mut still = NoProgress::now();
    loop {
        if let Some(ends) = turns_to
            && touches_in_turn(rsh, ends).await?
        {
            return Err(ControllerError::UnexpectedContact { step });
        }
        let status = rsh.get("program_status").await?;
        let log = files.log(step)?;
        match status.as_str() {
            "IDLE" if log.ended => return Ok(log),
            // A measured result is kept, unless the program does not end at once.
            _ if halt.is_halted()
                && (!log.ended
                    || halted_since.get_or_insert_with(Instant::now).elapsed() > STOPPED) =>
            {
                return Err(ControllerError::Halted);
            }
            "IDLE" => {
                let since = *idle_since.get_or_insert_with(Instant::now);
                let stopped = since.elapsed() > STOPPED;
                if stopped && settled {
                    return Ok(log);
                }
                if stopped {
                    settle(rsh).await?;
                    (idle_since, settled) = (None, true);
                }
            }
            "PAUSED" => return Err(held("pause was pressed")),
            _ => {
                (idle_since, settled) = (None, false);
                still.judge(rsh, log.lines, rests).await?;
            }
        }
        sleep(POLL).await;
    }
}

/// Whether the probe reads closed before the rotary axes have reached `ends`. The touch of the same program
/// begins after that.
async fn touches_in_turn(rsh: &mut Rsh, ends: &Position) -> Result<bool, ControllerError> {
    if rsh.get("probe_value").await? == "0" {
        return Ok(false);
    }
    let axes: Vec<Axis> = ends.iter().map(|(axis, _)| axis).collect();
    let stands = state::stands(rsh, &axes).await?;
    Ok(way::away_from(ends, &stands).is_some())
}

/// Time without a change.
struct NoProgress {
    since: Instant,
    last: (String, usize),
    /// Time of the last request for a sign of life.
    asked: Instant,
}

impl NoProgress {
    fn now() -> Self {
        Self { since: Instant::now(), last: (String::new(), 0), asked: Instant::now() }
    }

    async fn judge(
        &mut self,
        rsh: &mut Rsh,
        lines: usize,
        rests: Duration,
    ) -> Result<(), ControllerError> {
        let now = (rsh.get("abs_act_pos").await?, lines);
        if now != self.last {
            *self = Self { last: now, ..Self::now() };
        }
        if self.asked.elapsed() < SIGN_OF_LIFE_INTERVAL {
            return Ok(());
        }
        sign_of_life(rsh).await?;
        if rsh.get("feed_override").await? == "0" {
            return Err(held("the feed override stands at 0 %"));
        }
        if self.since.elapsed() > STALL + rests {
            return Err(held("it runs and nothing moves: a feed hold, or an interlock"));
        }
        self.asked = Instant::now();
        Ok(())
    }
}

/// Ensures that the reported state is current. On a slow computer, idle may date from before the program
/// began, and a message may be outstanding: a task that accepts a command has updated its state. While it
/// is stopped, it refuses the command.
async fn settle(rsh: &mut Rsh) -> Result<(), ControllerError> {
    match sign_of_life(rsh).await {
        Err(ControllerError::Refused { .. }) => Ok(()),
        told => told,
    }
}

/// Sets a harmless setting to its present value. The task must acknowledge it, which it does at once, also
/// while a program runs. (`set mode auto` is not harmless: it aborts.)
pub(super) async fn sign_of_life(rsh: &mut Rsh) -> Result<(), ControllerError> {
    let stop = rsh.get("optional_stop").await?;
    rsh.command(&format!("optional_stop {stop}")).await
}

/// Repeats a hold until the machine is at rest. The first hold, on a connection of its own, may be lost:
/// linuxcncrsh (2.9) has a thread for each connection and parses in all of them with one `strtok`, so that
/// of two lines that come together one or both may be answered as other lines (two holds of 125 were lost
/// under load; the answer to one was `SET NAK`). A request with an odd answer, or with none, is repeated.
///
/// # Errors
/// The control has not accepted an abort in time, or the machine is not at rest; a fault of the link.
pub(super) async fn stop(rsh: &mut Rsh) -> Result<(), ControllerError> {
    let deadline = Instant::now() + BRAKES;
    // Wait, so that the first hold is processed alone.
    sleep(STATE_UPDATE_TIME).await;
    while Instant::now() < deadline {
        if heard(rsh.enable().await)?.is_some()
            && heard(rsh.command("abort").await)?.is_some()
            && heard(at_rest(rsh).await)? == Some(true)
        {
            return Ok(());
        }
        // A control that is off refuses everything, and its machine is at rest.
        if heard(is_off(rsh).await)? == Some(true) {
            return Ok(());
        }
    }
    Err(ControllerError::NotHeld { seconds: BRAKES.as_secs_f64() })
}

/// Whether three reports in a row show no motion: a report may be older than the one before.
async fn at_rest(rsh: &mut Rsh) -> Result<bool, ControllerError> {
    let mm = state::unit_mm(rsh).await?;
    let mut before = state::numbers(rsh, "abs_act_pos").await?;
    for _ in 0..2 {
        sleep(STATE_UPDATE_TIME).await;
        let now = state::numbers(rsh, "abs_act_pos").await?;
        let moved = before.iter().zip(&now).any(|(one, other)| (one - other).abs() * mm > AT_REST);
        if moved || rsh.get("program_status").await? != "IDLE" {
            return Ok(false);
        }
        before = now;
    }
    Ok(true)
}

async fn is_off(rsh: &mut Rsh) -> Result<bool, ControllerError> {
    Ok(rsh.get("estop").await? != "OFF" || rsh.get("machine").await? != "ON")
}

/// Returns `None` for an odd answer or for none; a lost link is an error.
fn heard<T>(told: Result<T, ControllerError>) -> Result<Option<T>, ControllerError> {
    use ControllerError as E;
    match told {
        Err(
            E::Refused { .. }
            | E::NoAnswer { .. }
            | E::Garbled { .. }
            | E::Frozen
            | E::NotReady { .. },
        ) => Ok(None),
        told => told.map(Some),
    }
}

fn held(how: &str) -> ControllerError {
    ControllerError::Paused { how: how.to_owned() }
}
