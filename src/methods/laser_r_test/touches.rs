//! Chase-the-ball: the sphere's centre from touches instead of samples.

use super::bench::Bench;
use super::cross::{Place, Wanted};
use super::label::{Pass, in_words};
use super::model::placed;
use super::parameters;
use crate::Refused;
use machine::frame::Point;
use machine::record::artefact::Ball;
use machine::record::plan::{Step, StepKind};
use planning::{Access, Approach, BallTask};

/// Touches of one measurement.
const TOUCHES: usize = 5;
/// Clear distance before the expected contact, and how far beyond it a slow touch may go, beside how far
/// the sphere may be from where it is expected, mm.
const CLEAR_MM: f64 = 0.2;

/// The touches of one measurement, not yet numbered.
///
/// # Errors
/// A sphere that cannot be touched there.
pub fn steps(
    bench: &Bench<'_>,
    place: &Place,
    pass: Pass,
    wanted: &Wanted,
) -> Result<Vec<Step>, Refused> {
    let refused = |why: String| Refused {
        why: format!("at {}: {why}", in_words(&wanted.rotary)),
        instead: "take the position out of tilt_deg and turn_deg, or set the sphere up elsewhere"
            .to_owned(),
    };
    let access =
        Access::new(bench.plan, &bench.plan.artefact).map_err(|why| refused(why.to_string()))?;
    // Where the stylus as stated meets what the stylus as found does.
    let xyz = parameters::expected(&bench.chain, &wanted.rotary, place.zero, place.ball)?;
    let at = placed(&wanted.rotary, xyz);
    let centre = bench.chain.tip_in_table(&at, Point::from_vec(bench.zero()), &[]).mm;
    let ball = Ball { centre_mm: centre.into(), ..bench.ball.clone() };
    let approach = match pass {
        Pass::Find => {
            let uncertainty_mm = bench.balls.uncertainty_mm;
            Approach::Find { uncertainty_mm, standoff_mm: CLEAR_MM }
        }
        _ => {
            let margin_mm = bench.settings.margin_mm + CLEAR_MM;
            Approach::Slow { standoff_mm: margin_mm, search_mm: margin_mm }
        }
    };
    let kind = if wanted.reference { StepKind::Reference } else { StepKind::Touch };
    let task = BallTask { ball: &ball, rotary: &wanted.rotary, approach, touches: TOUCHES };
    let label = |touch: &str| format!("{}/{touch}", wanted.label);
    access
        .steps(&task, &bench.plan.probe, kind, (0, 0), label)
        .map_err(|why| refused(why.to_string()))
}
