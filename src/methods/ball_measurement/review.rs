//! What a stage's readings say: good, once more, or the run holds.

use nalgebra::Vector3;

use super::known::{Known, Taken, taken};
use crate::Refused;
use crate::samba::design::{Bench, in_words};
use crate::samba::label::Pass;
use machine::Axis;
use machine::record::plan::{Stage, StepKind};
use machine::record::reading::Reading;
use planning::{BallDoubt, BallLimits};

/// Looks at the measurements of the `last` stage. Returns the steps of those that must be measured
/// once more, and in which repeat.
///
/// # Errors
/// A measurement that was outside the limits before already; a ball that is not where it can be. Both
/// unless a person has looked since.
pub fn review(
    bench: &Bench<'_>,
    last: &Stage,
    readings: &[Reading],
) -> Result<Option<(Vec<u32>, u32)>, Refused> {
    let all = taken(bench, readings);
    let of_stage =
        |taken: &&Taken<'_>| taken.steps.iter().any(|step| last.steps.contains(&step.id));
    let mut again = Vec::new();
    for taken in all.iter().filter(of_stage) {
        // After a stop a person has looked, and perhaps cleaned.
        let newest_s = taken.readings.iter().map(|reading| reading.t_s).fold(f64::MIN, f64::max);
        let looked_after = bench.plan.gaps_s.last().is_some_and(|gap_s| *gap_s >= newest_s);
        let doubt = match fault(bench, taken) {
            Some(fault) if last.repeat > 0 => Some(outside(bench, &fault)),
            Some(_) => None,
            None => match check_place(bench, &all, taken) {
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

/// Why a measurement does not count. Fast touches come late, and the first do not come along the
/// normals: of them it is enough that they lie on a sphere.
fn fault(bench: &Bench<'_>, taken: &Taken<'_>) -> Option<BallDoubt> {
    let measured = match taken.measured(bench)? {
        Ok(measured) => measured,
        Err(doubt) => return Some(doubt),
    };
    let stated_mm = 2.0 * bench.balls.balls.get(taken.ball)?.radius_mm;
    let limits = BallLimits {
        form_mm: bench.settings.form_limit_um * 1e-3,
        diameter_mm: bench.settings.diameter_limit_um * 1e-3,
    };
    let slow = taken.label.pass != Pass::Find;
    slow.then(|| measured.check(&taken.label.ball, stated_mm, &limits).err()).flatten()
}

fn outside(bench: &Bench<'_>, fault: &BallDoubt) -> Refused {
    Refused {
        why: format!("twice the same: {fault}"),
        instead: format!(
            "clean and tighten the ball and the stylus and compare both radii with the machine file, \
             {}. form_limit_um and diameter_limit_um stand in [method.samba]",
            way_on(bench)
        ),
    }
}

/// A run goes on by its references only, and the first searches come before them.
fn way_on(bench: &Bench<'_>) -> &'static str {
    match bench.plan.steps.iter().any(|step| step.kind == StepKind::Reference) {
        true => "then resume the run: it measures the ball again",
        false => "then start a new run",
    }
}

fn name(bench: &Bench<'_>, taken: &Taken<'_>) -> String {
    let ball = bench.balls.balls.get(taken.ball).map_or("", |ball| &ball.id);
    let at = taken.steps.first().map(|step| step.from.only(|axis: Axis| !axis.is_linear()));
    format!("ball {ball} at {}", in_words(&at.unwrap_or_default()))
}

/// A ball may be no further from where it was expected than was granted.
fn check_place(bench: &Bench<'_>, all: &[Taken<'_>], taken: &Taken<'_>) -> Result<(), Refused> {
    let (Some(Ok(measured)), Some(ball)) =
        (taken.measured(bench), bench.balls.balls.get(taken.ball))
    else {
        return Ok(());
    };
    if taken.label.pass != Pass::Find {
        return Ok(());
    }
    // What its own stage found was not known when it was planned.
    let stage = |of: &Taken<'_>| (of.label.pass, of.label.indexation);
    let before = all.iter().take_while(|other| stage(other) != stage(taken));
    let known = Known::of_taken(bench, before);
    let stated = Vector3::from(ball.centre_mm);
    let expected = known.centre(bench, taken.ball, taken.label.indexation as usize);
    let (away, limit) =
        (measured.centre_mm.metric_distance(&expected), known.uncertainty_mm(bench));
    if away <= limit {
        return Ok(());
    }
    let place = name(bench, taken);
    if expected == stated {
        return Err(Refused {
            why: format!(
                "{place} was found {away:.3} mm from its stated place, beyond uncertainty_mm = {limit}"
            ),
            instead: format!(
                "check centre_mm of the ball and how the artefact stands on the table, {}",
                way_on(bench)
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
            way_on(bench)
        ),
    })
}
