//! Checks that a halt stops the machine.

use std::pin::pin;
use std::time::{Duration, Instant};

use tokio::time::timeout;

use super::axes::NO_PROBE_REASON;
use super::jog::{self, Proven};
use super::{Check, Ended, Part};
use crate::setup::{Pace, SetupError};
use devices::controllers::ControllerError;
use machine::Axis;
use machine::record::motion::Outcome;
use machine::record::question::{Answer, Jog, Question};

/// Length of the path that is held, mm.
const BY: f64 = 5.0;
/// Time from the start of the motion to the halt.
const HALT_DELAY: Duration = Duration::from_millis(1500);
/// Maximum travel after the halt, mm; one second at the slow feed of a jog.
const MAX_TRAVEL_AFTER_HALT_MM: f64 = 1.0;
/// Maximum number of questions to the operator, who may answer too early.
const MAX_RELEASE_QUESTIONS: usize = 3;
/// Maximum distance from the end at which the axis has reached it, mm.
const AT_END: f64 = 0.05;
/// Remedy for the person who configures the hold of the control.
const HOLD_REMEDY: &str = "how does the control take one? Modbus: hold in [controller.registers.command] \
                   (docs/line-window.md); grblHAL: `!` in real time; LinuxCNC: abort by linuxcncrsh";

/// Result of the held jog.
struct Held {
    /// Time from the start to the halt, s; `None`: the motion had ended before.
    before_s: Option<f64>,
    /// Time from the halt to the end of the motion, s.
    took_s: f64,
    ended: Result<Outcome, ControllerError>,
}

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    if check.strays {
        check.not_looked_at(
            Part::Hold,
            "an axis does not go as it is told to: put that right first",
        );
        return Ok(());
    }
    if !check.probe_answers {
        check.not_looked_at(Part::Hold, NO_PROBE_REASON);
        return Ok(());
    }
    let Some(jog) = longest(check) else {
        check.not_looked_at(Part::Hold, format!("no linear axis can be shown to be free for {BY} mm: raise Z clear of the declared bodies"));
        return Ok(());
    };
    if check.ask(Question::MayHold(jog)).await? != Answer::Yes {
        check.not_looked_at(Part::Hold, "nobody let an axis move");
        return Ok(());
    }
    let since = Instant::now();
    if check.site.bystander().is_some() {
        // At real pace, otherwise the motion ends before the halt.
        if let Err(error) = ready(check, Pace::Real).await {
            check.failed(Part::Hold, since, error.to_string(), error.remedy().unwrap_or_default());
            return Err(Ended::Unsafe);
        }
    }
    let proven = match jog::proven_there(check, &jog).await {
        Ok(proven) => proven,
        Err(error) => {
            check.go_on()?;
            check.failed(Part::Hold, since, error.to_string(), error.remedy());
            return if error.is_harmless() { Ok(()) } else { Err(Ended::Unsafe) };
        }
    };
    let held = run(check, proven).await?;
    check.summary.held = held.before_s.is_some();
    check.go_on()?;
    if judge(check, &jog, held, since).await? { released(check).await } else { Ok(()) }
}

/// A jog of the linear axis with the most travel.
fn longest(check: &Check<'_>) -> Option<Jog> {
    let stands = check.stands.as_ref()?;
    let room = |axis: Axis| {
        if check.beyond_limits.contains(&axis) {
            return None;
        }
        let spec = check.file.machine.axes.get(&axis)?;
        let jog = jog::inwards(axis, BY, spec, stands)?;
        let here = axis.to_edge(stands.at(axis));
        jog::proven(check, &jog).ok()?;
        Some((jog, if jog.by > 0.0 { spec.max - here } else { here - spec.min }))
    };
    let all = Axis::LINEAR.into_iter().filter_map(room);
    all.max_by(|one, other| one.1.total_cmp(&other.1)).map(|(jog, _)| jog)
}

async fn run(check: &Check<'_>, proven: Proven) -> Result<Held, Ended> {
    let controller = check.controller()?;
    let _motion = check.stop.motion().ok_or(Ended::Stopped)?;
    let mut executing = pin!(controller.execute(proven.block));
    let begun = Instant::now();
    // The motion continues after the timeout.
    if let Ok(ended) = timeout(HALT_DELAY, &mut executing).await {
        return Ok(Held { before_s: None, took_s: 0.0, ended });
    }
    let before_s = Some(begun.elapsed().as_secs_f64());
    controller.halt().now();
    let halted = Instant::now();
    let ended = executing.await;
    Ok(Held { before_s, took_s: halted.elapsed().as_secs_f64(), ended })
}

/// Judges the jog; returns whether the control is held.
async fn judge(
    check: &mut Check<'_>,
    jog: &Jog,
    held: Held,
    since: Instant,
) -> Result<bool, Ended> {
    let axis = jog.axis;
    let before_s = match (&held.ended, held.before_s) {
        (Err(ControllerError::Halted), Some(before_s)) => before_s,
        (Ok(_), _) => {
            let by = jog.by.abs();
            let why = format!(
                "{axis} had gone its {by} mm before it could be held: the feed was not kept (a simulated \
                 machine needs --speed real)"
            );
            check.not_looked_at(Part::Hold, why);
            return Ok(held.before_s.is_some());
        }
        (Err(error @ ControllerError::NotHeld { .. }), _) => {
            let remedy = format!("{}; {HOLD_REMEDY}", error.remedy());
            check.failed(Part::Hold, since, error.to_string(), remedy);
            return Err(Ended::Unsafe);
        }
        (Err(error), _) => {
            check.failed(Part::Hold, since, error.to_string(), error.remedy());
            return Err(Ended::Unsafe);
        }
    };
    let now = check.controller()?.look().await;
    let (Ok(now), Some(before)) = (now, &check.stands) else {
        check.not_looked_at(Part::Hold, "where it stands after a halt is not told by the control");
        return Ok(true);
    };
    let gone = (now.stands.at(axis) - before.at(axis)).abs();
    let went_on = (gone - before_s * jog.feed_per_min / 60.0).max(0.0);
    if gone > BY - AT_END || went_on > MAX_TRAVEL_AFTER_HALT_MM {
        let what = format!(
            "the hold has no effect: {axis} went on for {went_on:.1} mm after it, to {gone:.2} of {BY} mm"
        );
        check.failed(
            Part::Hold,
            since,
            what,
            format!("run nothing on this machine until a hold stops it: {HOLD_REMEDY}"),
        );
        return Err(Ended::Unsafe);
    }
    let what = format!(
        "held on its way: {axis} stands at {gone:.2} of {BY} mm, {:.2} s after the halt",
        held.took_s
    );
    check.well(Part::Hold, since, what);
    Ok(true)
}

/// Waits until the operator has released the control, as a held link accepts no line. The operator may answer
/// too early.
async fn released(check: &mut Check<'_>) -> Result<(), Ended> {
    let mut not_yet = None;
    for _ in 0..MAX_RELEASE_QUESTIONS {
        check.devices = None;
        check.stands = None;
        if check.ask(Question::Released { not_yet }).await? != Answer::Yes {
            return Ok(());
        }
        match ready(check, check.pace).await {
            Ok(()) => {
                check.summary.held = false;
                return check.go_on();
            }
            Err(error) => not_yet = Some(error.to_string()),
        }
    }
    let what = format!("it is not ready after the hold: {}", not_yet.unwrap_or_default());
    check.not_looked_at(Part::Hold, what);
    Ok(())
}

/// Opens the control again and prepares it.
async fn ready(check: &mut Check<'_>, pace: Pace) -> Result<(), SetupError> {
    check.open(pace).await?;
    let controller = check.controller().map_err(|_| ControllerError::DriverGone)?;
    let prepared = controller.prepare().await?;
    check.stands = Some(prepared.stands);
    check.transmission = Some(prepared.transmission);
    Ok(())
}
