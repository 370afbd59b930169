//! Runs a program and watches it: that it moves, and that LinuxCNC's task is alive.
//!
//! linuxcncrsh answers `get` from a copy of the task's state. When the task is frozen or dead the
//! copy grows old and the answers go on. Only what the task must acknowledge proves that it lives: a
//! `set` waits for it. So when nothing has changed for [`QUIET`], a setting is set to what it is.

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

/// LinuxCNC's task runs every 5 ms in its own samples.
const POLL: Duration = Duration::from_millis(4);
/// Idle for so long without the log's end, and again after a sign of life: the program was stopped.
const STOPPED: Duration = Duration::from_millis(60);
/// After so long without a change it is asked for a sign of life, and again each time.
const QUIET: Duration = Duration::from_secs(1);
/// Alive, running, and neither moving nor logging for so long: something holds it.
const STALL: Duration = Duration::from_secs(10);

/// A machine that was told to hold stands after this, from any speed.
const BRAKES: Duration = Duration::from_secs(5);
/// A task shows its state anew within this, and feedback is so quiet at rest, mm or degrees.
const SHOWN: Duration = Duration::from_millis(30);
const AT_REST: f64 = 0.01;

/// The program that is watched.
#[derive(Debug, Clone, Copy)]
pub(super) struct Watched<'a> {
    pub step: u32,
    /// How long it may do nothing, beside [`STALL`].
    pub rests: Duration,
    /// Where its rotary axes end, if it turns one at feed: a contact before they are there is unexpected.
    pub turns_to: Option<&'a Position>,
}

/// How long a program stands still by itself.
pub(super) fn rests(part: &Unit) -> Duration {
    let seconds = part.motions.iter().map(|motion| match motion {
        Motion::Dwell { seconds } => seconds.max(0.0),
        // As long as the dialect lets it take.
        Motion::Orient { .. } => 20.0,
        _ => 0.0,
    });
    let seconds = seconds.sum::<f64>() + part.clamps_rest_s;
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO)
}

/// Run the program that is open and wait until it stands still. What has ended is told, also if `halt`
/// came beside it.
///
/// # Errors
/// A contact, where the probe is read; what holds the program; a halt; the link.
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
    let mut still = Still::now();
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
            // What is measured is kept, unless it does not come to its end at once.
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

/// Whether the probe reads closed before the rotary axes have come to `ends`. The touch of the same program
/// begins after that.
async fn touches_in_turn(rsh: &mut Rsh, ends: &Position) -> Result<bool, ControllerError> {
    if rsh.get("probe_value").await? == "0" {
        return Ok(false);
    }
    let axes: Vec<Axis> = ends.iter().map(|(axis, _)| axis).collect();
    let stands = state::stands(rsh, &axes).await?;
    Ok(way::away_from(ends, &stands).is_some())
}

/// How long nothing has changed.
struct Still {
    since: Instant,
    last: (String, usize),
    /// When it was last asked for a sign of life.
    asked: Instant,
}

impl Still {
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
        if self.asked.elapsed() < QUIET {
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

/// On a computer that is late, idle may be from before the program began, and a message still on its way:
/// a task that takes a command has shown its state anew. While it is stopped it refuses.
async fn settle(rsh: &mut Rsh) -> Result<(), ControllerError> {
    match sign_of_life(rsh).await {
        Err(ControllerError::Refused { .. }) => Ok(()),
        told => told,
    }
}

/// Set a harmless setting to what it is. The task must acknowledge that; it is done at once, also
/// while a program runs. (`set mode auto` is not harmless: it aborts.)
pub(super) async fn sign_of_life(rsh: &mut Rsh) -> Result<(), ControllerError> {
    let stop = rsh.get("optional_stop").await?;
    rsh.command(&format!("optional_stop {stop}")).await
}

/// See a hold through until the machine stands. The one that went ahead on a connection of its own may be
/// lost: linuxcncrsh (2.9) has a thread for each connection and parses in all of them with one `strtok`, so
/// that of two lines that come together one, or both, may be answered as others (two holds of 125 were
/// lost under load; on the wire of one stood `SET NAK`). What is answered oddly, or not, is asked again.
///
/// # Errors
/// In the end it has not taken an abort, or does not stand; the link.
pub(super) async fn stop(rsh: &mut Rsh) -> Result<(), ControllerError> {
    let deadline = Instant::now() + BRAKES;
    // Let the hold be alone.
    sleep(SHOWN).await;
    while Instant::now() < deadline {
        if heard(rsh.enable().await)?.is_some()
            && heard(rsh.command("abort").await)?.is_some()
            && heard(at_rest(rsh).await)? == Some(true)
        {
            return Ok(());
        }
        // It refuses everything then, and stands.
        if heard(is_off(rsh).await)? == Some(true) {
            return Ok(());
        }
    }
    Err(ControllerError::NotHeld { seconds: BRAKES.as_secs_f64() })
}

/// Seen three times: one look may be older than the other.
async fn at_rest(rsh: &mut Rsh) -> Result<bool, ControllerError> {
    let mm = state::unit_mm(rsh).await?;
    let mut before = state::numbers(rsh, "abs_act_pos").await?;
    for _ in 0..2 {
        sleep(SHOWN).await;
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

/// What was told, if it was; an odd answer or none is `None`, a lost link an error.
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
