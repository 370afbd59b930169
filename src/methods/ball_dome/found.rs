//! The variants that can be computed from the readings and the prior.

use nalgebra::Vector3;

use super::full_fit::full_fit;
use super::points::Points;
use super::prior::is_of_spindle;
use super::stylus::{stylus_change, stylus_gain};
use super::variant::{Found, KINDS, Kind, StylusFrom, Variant};
use crate::identification::KnownErrors;
use machine::kinematics::ErrorTerm;

/// Derivative of each point by the errors of the prior, with the stated stylus.
pub fn by_errors(points: &Points, known: Option<&KnownErrors<'_>>) -> Vec<Vec<Vector3<f64>>> {
    let errors = known.map_or(&[][..], |known| &known.errors);
    let parameters: Vec<_> = errors.iter().map(|error| error.parameter).collect();
    points.by_errors(errors, points.stylus, &parameters)
}

/// All variants that the readings and the prior determine; and those that they do not, in words.
pub fn variants(
    points: &Points,
    known: Option<&KnownErrors<'_>>,
    tool_ball: usize,
) -> (Vec<Variant>, Vec<String>) {
    let (mut variants, mut lost) = (Vec::new(), Vec::new());
    for kind in KINDS {
        let errors = match (kind.is_calibrated, known) {
            (false, _) => &[][..],
            (true, Some(known)) => &known.errors,
            (true, None) => continue,
        };
        match found(kind, points, errors, known, tool_ball) {
            Some(found) => variants.push(Variant::new(kind, points, errors, found)),
            None => lost.push(format!(
                "{}: the measured indexations do not determine {}",
                kind.name,
                match kind.stylus {
                    StylusFrom::FullFit => "machine errors and stylus at once",
                    _ => "the stylus",
                }
            )),
        }
    }
    (variants, lost)
}

fn found(
    kind: Kind,
    points: &Points,
    errors: &[ErrorTerm],
    known: Option<&KnownErrors<'_>>,
    tool_ball: usize,
) -> Option<Found> {
    let of_balls = |counts: &dyn Fn(usize) -> bool| {
        let gain = stylus_gain(&points.by_stylus(errors), &points.ball, counts)?;
        let change = stylus_change(&gain, &points.seen(errors, points.stylus));
        Some(Found { stylus: points.stylus + change, gain: Some(gain), by_prior: Vec::new() })
    };
    match kind.stylus {
        StylusFrom::Stated => {
            Some(Found { stylus: points.stylus, gain: None, by_prior: Vec::new() })
        }
        StylusFrom::OneBall => of_balls(&|ball| ball == tool_ball),
        StylusFrom::AllBalls => of_balls(&|_| true),
        StylusFrom::FullFit => {
            let (known, fit) = (known?, full_fit(points, known?).ok()?);
            let by_prior = by_spindle(points, known);
            let offset = by_prior.iter().zip(&known.errors).map(|(by, error)| by * error.value);
            let stylus = fit.stylus + offset.sum::<Vector3<f64>>();
            Some(Found { stylus, gain: Some(fit.gain), by_prior })
        }
    }
}

/// Change of the stylus by each error of the prior, for a stylus that includes the offset of the spindle
/// (paper 4, Eqs. 5 to 7).
fn by_spindle(points: &Points, known: &KnownErrors<'_>) -> Vec<Vector3<f64>> {
    let of = |error: &ErrorTerm| {
        if !is_of_spindle(error) {
            return Vector3::zeros();
        }
        let by_error = points.by_errors(&[], points.stylus, &[error.parameter]);
        let by_stylus = points.by_stylus(&[]);
        -(by_stylus[0].transpose() * by_error[0][0])
    };
    known.errors.iter().map(of).collect()
}
