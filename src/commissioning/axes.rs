//! Checks direction and distance of each axis against its command.

use std::time::Instant;

use super::jog::{self, JogError};
use super::question_text::{amount, look_for, told, unit};
use super::{Check, Ended, Part};
use machine::Axis;
use machine::record::machine::Sense;
use machine::record::question::{Answer, Jog, Question, Seen};

/// Length of a jog, mm or degrees.
const JOG_LENGTH: f64 = 1.0;
/// Tolerance of an observed distance, mm or degrees.
const EYE_TOLERANCE: f64 = 0.2;

/// Reason why no axis is jogged.
pub(super) const NO_PROBE_REASON: &str =
    "nobody is there to show that the probe answers: without it nothing stops at a contact";

/// Outcome of one axis.
enum Looked {
    Told,
    /// No operator is present.
    Nobody,
}

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    if !check.probe_answers {
        check.not_looked_at(Part::Axes, NO_PROBE_REASON);
        return Ok(());
    }
    let axes: Vec<Axis> = check.file.machine.axes.keys().copied().collect();
    for axis in axes.iter().copied().filter(|axis| *axis != Axis::S) {
        if let Looked::Nobody = one(check, axis).await? {
            check.not_looked_at(Part::Axes, "nobody is there to let the axes move and to see it");
            return Ok(());
        }
    }
    if axes.contains(&Axis::S) {
        let why = "S: the spindle is not jogged; see by eye that it orients as [axes.S] says";
        check.not_looked_at(Part::Axes, why);
    }
    Ok(())
}

async fn one(check: &mut Check<'_>, axis: Axis) -> Result<Looked, Ended> {
    if check.beyond_limits.contains(&axis) {
        let why = format!("{axis}: its limits differ from the control's: correct them first");
        check.not_looked_at(Part::Axes, why);
        return Ok(Looked::Told);
    }
    let Some(jog) = planned(check, axis) else { return Ok(Looked::Told) };
    loop {
        let since = Instant::now();
        // The operator is asked only about a jog that is proven to be free of collision.
        if let Err(error) = jog::proven(check, &jog) {
            trouble(check, &jog, since, &error).await?;
            return Ok(Looked::Told);
        }
        let stands = check.stands.clone().unwrap_or_default();
        let expected = look_for(&check.file.machine, &stands, &jog).unwrap_or_default();
        let may = Question::MayJog { jog, look_for: expected.clone() };
        match check.ask(may).await? {
            Answer::Yes => {}
            Answer::Nobody => return Ok(Looked::Nobody),
            _ => {
                check.not_looked_at(Part::Axes, format!("{axis}: a person did not let it move"));
                return Ok(Looked::Told);
            }
        }
        if let Err(error) = jog::go(check, &jog).await {
            trouble(check, &jog, since, &error).await?;
            return Ok(Looked::Told);
        }
        let Answer::Saw(seen) =
            check.ask(Question::Jogged { jog, look_for: expected.clone() }).await?
        else {
            left_there(check, &jog, since);
            return Err(Ended::Unsafe);
        };
        if let Err(error) = jog::go(check, &jog::back(&jog)).await {
            trouble(check, &jog, since, &error).await?;
            return Ok(Looked::Told);
        }
        if seen != Seen::ResumableRun {
            judge(check, &jog, seen, since, &expected);
            return Ok(Looked::Told);
        }
    }
}

/// Reports that the operator has left: the axis stays where it is.
fn left_there(check: &mut Check<'_>, jog: &Jog, since: Instant) {
    let axis = jog.axis;
    let what = format!("{axis} {}: nobody told what was seen, so it was not moved back", told(jog));
    check.failed(
        Part::Axes,
        since,
        what,
        format!("look at the machine; move {axis} back by hand, then check again"),
    );
}

/// The jog of an axis; `None`, with a finding, if the axis cannot be jogged from its position.
fn planned(check: &mut Check<'_>, axis: Axis) -> Option<Jog> {
    let (since, machine) = (Instant::now(), &check.file.machine);
    let spec = machine.axes.get(&axis)?;
    let stands = check.stands.as_ref()?;
    let jog = jog::inwards(axis, JOG_LENGTH, spec, stands);
    if jog.is_none() {
        let here = axis.to_edge(stands.at(axis));
        let what = format!(
            "{axis} stands at {here:.3}, outside its travel from {} to {}",
            spec.min, spec.max
        );
        let remedy = format!(
            "home the machine; if it is homed, correct [axes.{axis}] min and max: they are machine \
             coordinates"
        );
        check.strays = true;
        check.failed(Part::Axes, since, what, remedy);
    }
    jog
}

/// Reports a jog that was refused or that the control did not execute.
///
/// # Errors
/// The control cannot continue.
async fn trouble(
    check: &mut Check<'_>,
    jog: &Jog,
    since: Instant,
    error: &JogError,
) -> Result<(), Ended> {
    check.go_on()?;
    check.strays = true;
    let reported = if error.is_harmless() { None } else { reported(check, jog).await };
    let what = format!("{} {}: {error}{}", jog.axis, told(jog), reported.unwrap_or_default());
    check.failed(Part::Axes, since, what, error.remedy());
    if error.is_harmless() { Ok(()) } else { Err(Ended::Unsafe) }
}

/// Reported motion since the jog, in words: the axis with the largest change. `None` if no position is known.
async fn reported(check: &Check<'_>, jog: &Jog) -> Option<String> {
    let (before, now) = (check.stands.as_ref()?, check.controller().ok()?.look().await.ok()?);
    let gone = |axis: Axis| -> Option<f64> {
        Some(axis.to_edge(now.stands.get(axis)? - before.get(axis)?))
    };
    let moved = check.file.machine.axes.keys().copied();
    let moved = moved.filter_map(|axis| Some((axis, gone(axis)?)));
    let (axis, by) = moved.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()))?;
    if by.abs() < 1e-3 {
        return Some("; its reports show no motion".to_owned());
    }
    let of = if axis == jog.axis { "" } else { ", another axis" };
    Some(format!(
        "; its reports say that {axis} went {}{of}",
        amount(axis, format_args!("{by:+.3}"))
    ))
}

fn judge(check: &mut Check<'_>, jog: &Jog, seen: Seen, since: Instant, expected: &str) {
    let (axis, by) = (jog.axis, told(jog));
    let seen = match seen {
        Seen::Distance(seen) if (seen - jog.by).abs() <= EYE_TOLERANCE => Seen::AsSaid,
        Seen::Distance(seen) if (seen + jog.by).abs() <= EYE_TOLERANCE => Seen::OtherWay,
        Seen::Distance(0.0) => Seen::Nothing,
        Seen::Another(other) if other == axis => Seen::AsSaid,
        seen => seen,
    };
    let (what, remedy) = match seen {
        Seen::AsSaid | Seen::ResumableRun => {
            return check.well(Part::Axes, since, format!("{axis} {by}: {expected}, as it should"));
        }
        Seen::OtherWay => (
            format!("{axis} {by}: it went the other way round: the sense of {axis} is wrong"),
            sense(axis, check.file.machine.axes.get(&axis).map(|spec| spec.positive)),
        ),
        Seen::Another(other) => (
            format!("{axis} {by}: {other} moved in its stead: {axis} and {other} are swapped"),
            format!(
                "exchange the motors' cables of {axis} and {other}, or their places in the control's \
                 list of joints; then check again"
            ),
        ),
        Seen::Nothing => (
            format!(
                "{axis} {by}: the control says that it went there, but nothing was seen to move"
            ),
            format!(
                "is the drive of {axis} enabled, its motor plugged in, its coupling tight? Or its steps \
                 per {} are far too few",
                unit(axis)
            ),
        ),
        Seen::Distance(seen) => too_far(jog, seen),
    };
    check.strays = true;
    check.failed(Part::Axes, since, what, remedy);
}

fn sense(axis: Axis, stated: Option<Sense>) -> String {
    if axis.is_linear() {
        return format!(
            "turn {axis} round at the control (grblHAL: $3; LinuxCNC: the sign of its joint's SCALE); \
             does [machine] topology say rightly whether {axis} carries the table or the spindle? What \
             carries the table goes against the sign of its command"
        );
    }
    let other = if stated == Some(Sense::Reversed) { "iso" } else { "reversed" };
    format!("write positive = \"{other}\" in [axes.{axis}], or turn it round at the control")
}

fn too_far(jog: &Jog, seen: f64) -> (String, String) {
    let (axis, unit, gain) = (jog.axis, unit(jog.axis), (seen / jog.by).abs());
    let inches = if axis.is_linear() && (gain - 25.4).abs() < 1.5 {
        ": an inch in place of a millimetre?"
    } else {
        ""
    };
    // Rounded to a hundredth, the resolution of the eye.
    let seen = (seen * 100.0).round() / 100.0;
    let turned = if seen * jog.by < 0.0 { ", and the other way round" } else { "" };
    let what = format!(
        "{axis} {}: it went {}{turned}: the gain of {axis} is {gain:.3}{inches}",
        told(jog),
        amount(axis, format_args!("{seen:+}"))
    );
    let remedy = format!(
        "divide the steps per {unit} of {axis} at the control by {gain:.3} (grblHAL: $100 and on, in the \
         order of its axes; LinuxCNC: SCALE of the joint); measure more exactly over a longer way"
    );
    (what, remedy)
}
