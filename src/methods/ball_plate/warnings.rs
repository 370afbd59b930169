//! Warnings of the estimate.

use nalgebra::Vector3;

use super::solved::SolvedRun;
use crate::identification::{Identification, MisfitAdvice};

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    possible_causes: "a loose ball, drift, error motions above the highest harmonic, error motions that do not repeat",
    declaring_settings: "repeatability_um or error_motion_um",
};
/// Minimum mean displacement of a ball in one revolution for a warning, as a multiple of the standard uncertainty of
/// one coordinate of that mean.
const LOOSE_BALL_THRESHOLD_SIGMAS: f64 = 5.0;

pub fn collect_warnings(solved: &SolvedRun<'_>, identified: &Identification) -> Vec<String> {
    let mut lines = solved.measured.observed_balls.skipped_measurements.clone();
    lines.extend(identified.misfit_warning(&MISFIT_ADVICE));
    lines.extend(identified.outlier_check.warnings.iter().cloned());
    lines.extend(describe_loose_ball(solved));
    lines.extend(identified.trial_contradiction_warning());
    lines
}

/// Stability watch: the largest mean residual of a ball in one revolution. Only that ball is named, because
/// its displacement leaves smaller residuals at all others.
fn describe_loose_ball(solved: &SolvedRun<'_>) -> Option<String> {
    let turns = solved.design.stops.len().div_ceil(solved.settings.positions);
    let all = solved.plate.balls.balls.iter().enumerate();
    let means = all.flat_map(|(ball, of)| {
        let mean = move |revolution: usize| {
            let (mean, u_mm) = mean_ball_residual_and_u_mm(solved, ball, revolution)?;
            Some((of, revolution, mean.norm(), u_mm))
        };
        (0..turns).filter_map(mean)
    });
    let (ball, revolution, off_mm, u_mm) = means.max_by(|a, b| a.2.total_cmp(&b.2))?;
    (off_mm > LOOSE_BALL_THRESHOLD_SIGMAS * u_mm).then(|| {
        format!(
            "ball {} is displaced by {:.1} µm from its mean position in revolution {} of {turns} (standard \
            uncertainty of the mean: {:.1} µm). The ball may be loose: tighten the ball and measure again, \
            or remove the ball from [artefact]",
            ball.id,
            off_mm * 1e3,
            revolution + 1,
            u_mm * 1e3
        )
    })
}

/// Mean residual of a ball in one revolution, table frame, mm, and the standard uncertainty of one of its
/// coordinates.
fn mean_ball_residual_and_u_mm(solved: &SolvedRun<'_>, ball: usize, revolution: usize) -> Option<(Vector3<f64>, f64)> {
    let positions = solved.settings.positions;
    let observations = solved.measured.observations.iter().enumerate();
    let here = observations.filter(|(_, s)| s.ball_index == ball && s.stop_index / positions == revolution);
    let here = here.map(|(i, observation)| {
        let in_axes = Vector3::from_column_slice(&solved.solution.residuals[3 * i..][..3]);
        let to_table = observation.derivative_by_ball_position.try_inverse().unwrap_or_default();
        (to_table * in_axes, solved.coordinate_sigmas_mm[3 * i])
    });
    let all: Vec<(Vector3<f64>, f64)> = here.collect();
    let count = all.len() as f64;
    let sum: Vector3<f64> = all.iter().map(|(residual, _)| residual).sum();
    let variance: f64 = all.iter().map(|(_, sigma)| sigma * sigma).sum();
    (!all.is_empty()).then(|| (sum / count, variance.sqrt() / count))
}

pub fn describe_gauge(solved: &SolvedRun<'_>) -> Vec<String> {
    let (axis, plate) = (solved.plate.rotary_axis, solved.plate);
    let point = plate.axis_point_mm;
    let mut lines = vec![
        format!("the mean of each error motion is zero; the location of {axis} is part of DX, DY and DZ"),
        format!(
            "the co-rotating first harmonic of EX{axis} and EY{axis} is the eccentricity of the plate (e_x, e_y), \
             that of EA{axis} and EB{axis} its tilt (dz_dx, dz_dy)"
        ),
        format!("EX{axis} and EY{axis} are valid at Z = {:.3} mm (point_mm)", point.z),
        "mean radius, mean height and mean rotation of the plate: as in the first measurement".to_owned(),
    ];
    if solved.design.layout.interruption_count > 0 {
        lines.push(format!(
            "a step of X, Y and Z fitted at each of {} interruption(s)",
            solved.design.layout.interruption_count
        ));
    }
    if solved.design.layout.drift_order > 0 {
        lines.push(format!(
            "drift of X, Y and Z fitted (order {}) and removed; values are valid at the middle of the run",
            solved.design.layout.drift_order
        ));
    }
    lines
}

pub fn describe_not_identifiable(solved: &SolvedRun<'_>, identified: &Identification) -> Vec<String> {
    let axis = solved.plate.rotary_axis;
    let mut lines = vec![
        format!("location of {axis}: inseparable from the deviations of X, Y and Z at the measuring positions"),
        "scale of X and Y: inseparable from the radius of the plate".to_owned(),
        format!(
            "harmonics above {}: orders below {half} are in the residuals; an order k above {half} is \
            inseparable from {positions} - k ({positions} positions per revolution)",
            solved.settings.harmonics,
            half = solved.settings.positions / 2,
            positions = solved.settings.positions
        ),
    ];
    if !solved.settings.both_directions {
        lines.push(format!("reversal of {axis}: both_directions = true is required"));
    }
    lines.extend(identified.outlier_check.describe_detection_limits());
    lines
}
