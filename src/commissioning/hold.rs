//! Checks that a halt stops the machine.

use std::pin::pin;
use std::time::{Duration, Instant};

use tokio::time::timeout;

use super::axes::PROBE_UNTESTED_REASON;
use super::jog::{self, ProvenJog};
use super::{CheckEnd, CheckPart, MachineCheck, PartTimer};
use crate::setup::{SetupError, SimulationPace, control_hints};
use devices::controllers::ControllerError;
use machine::Axis;
use machine::record::motion::MotionBlockOutcome;
use machine::record::question::{Jog, OperatorAnswer, OperatorQuestion};

/// Length of the jog that is stopped by a hold, mm.
const HELD_JOG_LENGTH_MM: f64 = 5.0;
/// Time from the start of the motion to the halt.
const TIME_FROM_START_TO_HALT: Duration = Duration::from_millis(1500);
/// Maximum travel after the halt, mm; one second at the slow feed of a jog. The travel after the halt is the whole
/// travel less feed times the time to the halt.
const MAX_TRAVEL_AFTER_HALT_MM: f64 = 1.0;
/// Maximum number of questions whether the control is released: the operator may answer too early.
const MAX_RELEASE_QUESTIONS: usize = 3;
/// Maximum distance from the end of the jog at which the axis counts as arrived there, mm.
const JOG_END_TOLERANCE_MM: f64 = 0.05;

/// Result of the held jog.
struct HeldJog {
    /// Time from the start to the halt, s; `None`: the motion had ended before.
    time_to_halt_s: Option<f64>,
    /// Time from the halt to the end of the motion, s; 0 without a halt.
    stopping_time_s: f64,
    /// Result of the jog; `Halted` after an effective halt.
    block_result: Result<MotionBlockOutcome, ControllerError>,
}

/// Halts a jog and judges its travel after the halt; then the operator releases the control. Not checked after a
/// fault of an axis, with an untested probe, without a collision-free jog, or without the operator's permission.
pub(super) async fn check_hold(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    if check.has_axis_fault {
        check.report_unchecked(CheckPart::Hold, "an axis did not follow its command; correct this first");
        return Ok(());
    }
    if !check.is_probe_working {
        check.report_unchecked(CheckPart::Hold, PROBE_UNTESTED_REASON);
        return Ok(());
    }
    let Some(jog) = jog_of_axis_with_most_travel(check) else {
        let why = format!(
            "no linear axis has a collision-free path of {HELD_JOG_LENGTH_MM} mm: raise Z above the declared bodies"
        );
        check.report_unchecked(CheckPart::Hold, why);
        return Ok(());
    };
    if check.prompt_operator(OperatorQuestion::AllowJogWithHold(jog)).await? != OperatorAnswer::Yes {
        check.report_unchecked(CheckPart::Hold, "the operator did not permit the motion");
        return Ok(());
    }
    let timer = PartTimer::start(CheckPart::Hold);
    if check.reopenable_machine.simulated_operator().is_some() {
        // Reopens at real pace, otherwise the motion ends before the halt.
        if let Err(error) = reopen_and_prepare_control(check, SimulationPace::RealTime).await {
            check.report_failed(timer, error.to_string(), error.remedy().unwrap_or_default());
            return Err(CheckEnd::Unsafe);
        }
    }
    let proven = match jog::prove_jog_and_check_position_unchanged(check, &jog).await {
        Ok(proven) => proven,
        Err(error) => {
            check.require_no_stop_request()?;
            check.report_failed(timer, error.to_string(), error.remedy());
            return if error.is_proof_failure() { Ok(()) } else { Err(CheckEnd::Unsafe) };
        }
    };
    let held = run_and_halt_jog(check, proven).await?;
    check.summary.held = held.time_to_halt_s.is_some();
    check.require_no_stop_request()?;
    if judge_hold_and_return_held(check, &jog, held, timer).await? { prompt_for_release(check).await } else { Ok(()) }
}

/// The collision-free jog of the linear axis that has the most travel in the direction of the jog (away from the
/// nearer limit); `None` if no linear axis has a collision-free jog. Axes with a travel beyond the limits of the
/// control are left out.
fn jog_of_axis_with_most_travel(check: &MachineCheck<'_>) -> Option<Jog> {
    let stands = check.position.as_ref()?;
    let room = |axis: Axis| {
        if check.axes_beyond_limits.contains(&axis) {
            return None;
        }
        let spec = check.machine_file.machine.axes.get(&axis)?;
        let jog = jog::jog_away_from_limit(axis, HELD_JOG_LENGTH_MM, spec, stands)?;
        let here = axis.to_mm_or_deg(stands.get_or_zero(axis));
        jog::prove_planned_jog(check, &jog).ok()?;
        Some((jog, if jog.by > 0.0 { spec.max - here } else { here - spec.min }))
    };
    let all = Axis::LINEAR.into_iter().filter_map(room);
    all.max_by(|one, other| one.1.total_cmp(&other.1)).map(|(jog, _)| jog)
}

/// Executes the jog and halts it after `TIME_FROM_START_TO_HALT`, unless it has ended before.
async fn run_and_halt_jog(check: &MachineCheck<'_>, proven: ProvenJog) -> Result<HeldJog, CheckEnd> {
    let controller = check.controller()?;
    let _motion = check.stop.begin_motion().ok_or(CheckEnd::Stopped)?;
    let mut executing = pin!(controller.execute(proven.block));
    let begun = Instant::now();
    // The motion continues after the timeout.
    if let Ok(ended) = timeout(TIME_FROM_START_TO_HALT, &mut executing).await {
        return Ok(HeldJog { time_to_halt_s: None, stopping_time_s: 0.0, block_result: ended });
    }
    let time_to_halt_s = Some(begun.elapsed().as_secs_f64());
    controller.halt_handle().trigger();
    let halted = Instant::now();
    let ended = executing.await;
    Ok(HeldJog { time_to_halt_s, stopping_time_s: halted.elapsed().as_secs_f64(), block_result: ended })
}

/// Remedy for the person who configures the hold of the control.
fn hold_remedy() -> String {
    format!("check how the control receives a hold. {}", control_hints(|control| Some(control.hold_command_hint)))
}

/// Judges the jog and reports the finding; returns whether the control is held. A hold without effect, and any
/// error of the jog other than `Halted`, end the check with `Unsafe`.
async fn judge_hold_and_return_held(
    check: &mut MachineCheck<'_>,
    jog: &Jog,
    held: HeldJog,
    timer: PartTimer,
) -> Result<bool, CheckEnd> {
    let axis = jog.axis;
    let time_to_halt_s = match (&held.block_result, held.time_to_halt_s) {
        (Err(ControllerError::Halted), Some(time_to_halt_s)) => time_to_halt_s,
        (Ok(_), _) => {
            let by = jog.by.abs();
            let why = format!(
                "{axis} had moved by {by} mm before the hold was sent: the feed was too high (a simulated \
                machine needs --speed real)"
            );
            check.report_unchecked(CheckPart::Hold, why);
            return Ok(held.time_to_halt_s.is_some());
        }
        (Err(error @ ControllerError::HoldFailed { .. }), _) => {
            let remedy = format!("{}; {}", error.remedy(), hold_remedy());
            check.report_failed(timer, error.to_string(), remedy);
            return Err(CheckEnd::Unsafe);
        }
        (Err(error), _) => {
            check.report_failed(timer, error.to_string(), error.remedy());
            return Err(CheckEnd::Unsafe);
        }
    };
    let now = check.controller()?.read_snapshot().await;
    let (Ok(now), Some(before)) = (now, &check.position) else {
        check.report_unchecked(CheckPart::Hold, "the control does not report its position after a halt");
        return Ok(true);
    };
    let gone = (now.position.get_or_zero(axis) - before.get_or_zero(axis)).abs();
    let went_on = (gone - time_to_halt_s * jog.feed_per_min / 60.0).max(0.0);
    if gone > HELD_JOG_LENGTH_MM - JOG_END_TOLERANCE_MM || went_on > MAX_TRAVEL_AFTER_HALT_MM {
        let what = format!(
            "the hold has no effect: {axis} moved on by {went_on:.1} mm after the halt, to {gone:.2} of \
            {HELD_JOG_LENGTH_MM} mm"
        );
        let remedy = format!("do not start a run on this machine until a hold stops it; {}", hold_remedy());
        check.report_failed(timer, what, remedy);
        return Err(CheckEnd::Unsafe);
    }
    let what = format!(
        "the hold stopped the jog: {axis} stopped after {gone:.2} of {HELD_JOG_LENGTH_MM} mm, {:.2} s after the halt",
        held.stopping_time_s
    );
    check.report_ok(timer, what);
    Ok(true)
}

/// Waits until the operator has released the control, because a halted connection accepts no commands. The question
/// is repeated while the control is not ready; after `MAX_RELEASE_QUESTIONS`, or another answer than yes, the check
/// goes on without a known position.
async fn prompt_for_release(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    let mut not_yet = None;
    for _ in 0..MAX_RELEASE_QUESTIONS {
        check.devices = None;
        check.position = None;
        if check.prompt_operator(OperatorQuestion::HoldReleased { last_failure: not_yet }).await? != OperatorAnswer::Yes
        {
            return Ok(());
        }
        match reopen_and_prepare_control(check, check.pace).await {
            Ok(()) => {
                check.summary.held = false;
                return check.require_no_stop_request();
            }
            Err(error) => not_yet = Some(error.to_string()),
        }
    }
    let what = format!("the control is not ready after the hold: {}", not_yet.unwrap_or_default());
    check.report_unchecked(CheckPart::Hold, what);
    Ok(())
}

/// Opens the control again and prepares it.
async fn reopen_and_prepare_control(check: &mut MachineCheck<'_>, pace: SimulationPace) -> Result<(), SetupError> {
    check.open_devices(pace).await?;
    let controller = check.controller().map_err(|_| ControllerError::DriverTaskEnded)?;
    let prepared = controller.prepare().await?;
    check.position = Some(prepared.position);
    check.transmission = Some(prepared.transmission);
    Ok(())
}
