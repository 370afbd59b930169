//! Chase-the-ball: the sphere's centre from touches instead of sensor samples.

use super::bench::LaserSetup;
use super::cross::{Place, ScanRequest};
use super::label::{Pass, in_words};
use super::model::placed;
use super::parameters;
use crate::Refused;
use machine::frame::Point;
use machine::record::artefact::Ball;
use machine::record::plan::{Step, StepKind};
use planning::{Access, Approach, BallTask};

/// Number of touches of one measurement.
const TOUCHES: usize = 5;
/// Clearance before the expected contact, and overtravel of a slow touch, in addition to the position uncertainty
/// of the sphere, mm.
const CLEAR_MM: f64 = 0.2;

/// The touches of one measurement, without step numbers.
///
/// # Errors
/// The sphere cannot be touched at this position.
pub fn steps(
    bench: &LaserSetup<'_>,
    place: &Place,
    pass: Pass,
    wanted: &ScanRequest,
) -> Result<Vec<Step>, Refused> {
    let refused = |why: String| Refused {
        why: format!("at {}: {why}", in_words(&wanted.rotary)),
        instead: "take the position out of tilt_deg and turn_deg, or set the sphere up elsewhere"
            .to_owned(),
    };
    let access =
        Access::new(bench.plan, &bench.plan.artefact).map_err(|why| refused(why.to_string()))?;
    // Centre of the sphere for which the stated stylus has the same axis positions as the measured stylus.
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
