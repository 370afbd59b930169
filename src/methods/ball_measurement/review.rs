//! Review of the readings of a stage: accept, measure again, or hold the run.

use nalgebra::Vector3;

use super::known::{BallMeasurement, FoundBalls, taken};
use super::label::Pass;
use super::setup::{MeasurementSetup, describe_position};
use crate::Refused;
use machine::Axis;
use machine::record::plan::{Stage, StepKind};
use machine::record::reading::Reading;
use planning::{BallDoubt, BallLimits};

/// Checks the measurements of the `last` stage. Returns the steps of those that must be measured again, and
/// the number of their repeat.
///
/// # Errors
/// A measurement was outside the limits for the second time; a ball is outside its possible range. Neither is
/// an error if the run was stopped and resumed since then.
pub fn review(
    setup: &MeasurementSetup<'_>,
    last: &Stage,
    readings: &[Reading],
) -> Result<Option<(Vec<u32>, u32)>, Refused> {
    let all = taken(setup, readings);
    let of_stage =
        |taken: &&BallMeasurement<'_>| taken.steps.iter().any(|step| last.steps.contains(&step.id));
    let mut again = Vec::new();
    for taken in all.iter().filter(of_stage) {
        // After a stop the operator has checked the ball and may have cleaned it.
        let newest_s = taken.readings.iter().map(|reading| reading.t_s).fold(f64::MIN, f64::max);
        let looked_after = setup.plan.gaps_s.last().is_some_and(|gap_s| *gap_s >= newest_s);
        let doubt = match fault(setup, taken) {
            Some(fault) if last.repeat > 0 => Some(outside(setup, &fault)),
            Some(_) => None,
            None => match check_place(setup, &all, taken) {
                Ok(()) => continue,
                Err(elsewhere) => Some(elsewhere),
            },
        };
        match doubt {
            Some(doubt) if !looked_after => return Err(doubt),
            _ => again.extend(taken.steps.iter().map(|step| step.id)),
        }
    }
    Ok((!again.is_empty()).then_some((again, last.repeat + 1)))
}

/// Reason to reject a measurement. Fast touches trigger late, and the first ones are not along the normals;
/// for them it is sufficient that they lie on a sphere.
fn fault(setup: &MeasurementSetup<'_>, taken: &BallMeasurement<'_>) -> Option<BallDoubt> {
    let measured = match taken.measured(setup)? {
        Ok(measured) => measured,
        Err(doubt) => return Some(doubt),
    };
    let stated_mm = 2.0 * setup.balls.balls.get(taken.ball)?.radius_mm;
    let limits = BallLimits {
        form_mm: setup.touch.form_limit_mm,
        diameter_mm: setup.touch.diameter_limit_mm,
    };
    let slow = taken.label.pass != Pass::Find;
    slow.then(|| measured.check(&taken.label.ball, stated_mm, &limits).err()).flatten()
}

fn outside(setup: &MeasurementSetup<'_>, fault: &BallDoubt) -> Refused {
    Refused {
        why: format!("twice the same: {fault}"),
        instead: format!(
            "clean and tighten the ball and the stylus and compare both radii with the machine file, \
             {}. form_limit_um and diameter_limit_um stand in [method.{}]",
            way_on(setup),
            setup.method
        ),
    }
}

/// How to continue. A run can be resumed only by its references, and the first searches precede them.
pub fn way_on(setup: &MeasurementSetup<'_>) -> &'static str {
    match setup.plan.steps.iter().any(|step| step.kind == StepKind::Reference) {
        true => "then resume the run: it measures the ball again",
        false => "then start a new run",
    }
}

fn name(setup: &MeasurementSetup<'_>, taken: &BallMeasurement<'_>) -> String {
    let ball = setup.balls.balls.get(taken.ball).map_or("", |ball| &ball.id);
    let at = taken.steps.first().map(|step| step.from.only(|axis: Axis| !axis.is_linear()));
    format!("ball {ball} at {}", describe_position(&at.unwrap_or_default()))
}

/// Checks that a ball is within the position uncertainty of its expected position.
fn check_place(
    setup: &MeasurementSetup<'_>,
    all: &[BallMeasurement<'_>],
    taken: &BallMeasurement<'_>,
) -> Result<(), Refused> {
    let (Some(Ok(measured)), Some(ball)) =
        (taken.measured(setup), setup.balls.balls.get(taken.ball))
    else {
        return Ok(());
    };
    if taken.label.pass != Pass::Find {
        return Ok(());
    }
    // The results of its own stage were unknown when the stage was planned.
    let stage = |of: &BallMeasurement<'_>| (of.label.pass, of.label.indexation);
    let before = all.iter().take_while(|other| stage(other) != stage(taken));
    let known = FoundBalls::of_taken(setup, before);
    let stated = Vector3::from(ball.centre_mm);
    let expected = known.centre(setup, taken.ball, taken.label.indexation as usize);
    let (away, limit) =
        (measured.centre_mm.metric_distance(&expected), known.uncertainty_mm(setup));
    if away <= limit {
        return Ok(());
    }
    let place = name(setup, taken);
    if expected == stated {
        return Err(Refused {
            why: format!(
                "{place} was found {away:.3} mm from its stated place, beyond uncertainty_mm = {limit}"
            ),
            instead: format!(
                "check centre_mm of the ball and how the artefact stands on the table, {}",
                way_on(setup)
            ),
        });
    }
    Err(Refused {
        why: format!(
            "{place} was found {away:.3} mm from where the indexations before put it, beyond {limit} \
             mm: the ball has moved, or the rotary axes stand that far from where the file says"
        ),
        instead: format!(
            "clean the ball and put it back if it has moved, {}. Where point_mm of the rotary axes, \
             standoff_mm or uncertainty_mm must be changed, start a new run",
            way_on(setup)
        ),
    })
}
