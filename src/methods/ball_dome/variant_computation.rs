//! The variants that can be computed from the readings and the prior.

use nalgebra::Vector3;

use super::error_and_stylus_fit::fit_machine_errors_and_stylus;
use super::measured_points::MeasuredPoints;
use super::stylus_gain::{stylus_change, stylus_gain};
use super::variant::{DomeVariant, StylusEstimate, StylusSource, VARIANT_KINDS, VariantKind};
use crate::identification::KnownErrors;
use machine::kinematics::ErrorTerm;

/// Derivative of each point by the errors of the prior, at their values and with the stated stylus: points × errors.
pub fn point_derivatives_by_prior_errors(
    points: &MeasuredPoints,
    known: Option<&KnownErrors<'_>>,
) -> Vec<Vec<Vector3<f64>>> {
    let errors = known.map_or(&[][..], |known| &known.errors);
    let parameters: Vec<_> = errors.iter().map(|error| error.parameter).collect();
    points.point_derivatives_by_errors(errors, points.stated_stylus, &parameters)
}

/// All variants that the readings and the prior determine, and one text for each that they do not determine. Without
/// a prior, S1 to S4 are omitted without a text.
pub fn compute_variants(
    points: &MeasuredPoints,
    known: Option<&KnownErrors<'_>>,
    tool_ball: usize,
) -> (Vec<DomeVariant>, Vec<String>) {
    let (mut variants, mut lost) = (Vec::new(), Vec::new());
    for kind in VARIANT_KINDS {
        let errors = match (kind.uses_calibrated_machine, known) {
            (false, _) => &[][..],
            (true, Some(known)) => &known.errors,
            (true, None) => continue,
        };
        match find_stylus(kind, points, errors, known, tool_ball) {
            Some(found) => variants.push(DomeVariant::new(kind, points, errors, found)),
            None => lost.push(format!(
                "{}: the measured indexations do not determine {}",
                kind.name,
                match kind.stylus {
                    StylusSource::FittedWithMachineErrors => "machine errors and stylus together",
                    _ => "the stylus",
                }
            )),
        }
    }
    (variants, lost)
}

/// Stylus of a variant. `None`: the readings do not determine it, or S4 has no prior.
fn find_stylus(
    kind: VariantKind,
    points: &MeasuredPoints,
    errors: &[ErrorTerm],
    known: Option<&KnownErrors<'_>>,
    tool_ball: usize,
) -> Option<StylusEstimate> {
    let of_balls = |includes_ball: &dyn Fn(usize) -> bool| {
        let gain = stylus_gain(&points.point_derivatives_by_stylus(errors), &points.ball_indices, includes_ball)?;
        let change = stylus_change(&gain, &points.table_positions_mm(errors, points.stated_stylus));
        Some(StylusEstimate {
            vector_mm: points.stated_stylus + change,
            gain: Some(gain),
            stylus_derivatives_by_prior_errors: Vec::new(),
        })
    };
    match kind.stylus {
        StylusSource::Stated => Some(StylusEstimate {
            vector_mm: points.stated_stylus,
            gain: None,
            stylus_derivatives_by_prior_errors: Vec::new(),
        }),
        StylusSource::OneBall => of_balls(&|ball| ball == tool_ball),
        StylusSource::AllBalls => of_balls(&|_| true),
        StylusSource::FittedWithMachineErrors => fit_machine_errors_and_stylus(points, known?),
    }
}
