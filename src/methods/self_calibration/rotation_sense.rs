//! Check of the axis' sense of rotation against the machine file.

use super::fit::SelfCalibrationFit;
use super::model::{RadiusObservation, UnknownsLayout};
use super::outputs::error_motion_coefficients;
use crate::identification::dot_product;

/// Result of the check of the stated sense of the axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RotationSenseCheck {
    /// The stated sense explains the readings far better than the opposite one.
    Confirmed,
    /// Neither sense explains the readings far better: the part is too round and centred, or the design has too few
    /// touches.
    NotConfirmed,
    /// The opposite sense explains the readings far better.
    Contradicted,
}

/// Solves with the opposite sense as well. With the wrong sense an eccentric part appears as an error motion of
/// twice its eccentricity. With the correct sense the error motion is small.
pub fn check_rotation_sense(fit: &SelfCalibrationFit) -> RotationSenseCheck {
    let n = fit.layout.design.angle_count;
    let turn = |one: &RadiusObservation| RadiusObservation { c_index: (n - one.c_index) % n, ..*one };
    let turned: Vec<RadiusObservation> = fit.observations.iter().map(turn).collect();
    let Ok(other) = SelfCalibrationFit::new(fit.layout.clone(), turned, fit.sigma.clone(), false) else {
        return RotationSenseCheck::NotConfirmed;
    };
    let stated = error_motion_norm(&fit.layout, &fit.x);
    let opposite = error_motion_norm(&fit.layout, &other.x);
    // Scatter does not change the ratio of the two values by a factor of five.
    if opposite > 5.0 * stated {
        RotationSenseCheck::Confirmed
    } else if stated > 5.0 * opposite {
        RotationSenseCheck::Contradicted
    } else {
        RotationSenseCheck::NotConfirmed
    }
}

/// Root of the sum of squares of the error motion in X and Y over all angles, first height, mm.
fn error_motion_norm(layout: &UnknownsLayout, x: &[f64]) -> f64 {
    let at = |i| [false, true].map(|along_y| dot_product(&error_motion_coefficients(layout, 0, i, along_y), x).powi(2));
    (0..layout.design.angle_count).flat_map(at).sum::<f64>().sqrt()
}
