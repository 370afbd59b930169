//! Check of rank and condition of a design, before the first motion.

use faer::Mat;

use super::design_setup::DesignSetup;
use crate::MethodRefusal;
use crate::ball_measurement::BallVisit;
use crate::samba::confounding::COORDINATE_NAMES;
use crate::samba::geometry_solution::is_uniform_scale;
use estimation::linear_least_squares::{RANK_THRESHOLD, RankAnalysis, analyse_rank};
use estimation::null_space_names::name_null_space;

/// Maximum scaled condition number. A larger value indicates a mistake in the design rather than a property of the
/// machine.
const MAX_SCALED_CONDITION: f64 = 1e4;

/// All rows of the design, weighted, for machine errors, tool and balls; and the names of these unknowns.
pub fn design_matrix(setup: &DesignSetup<'_>, visits: &[BallVisit]) -> Result<(Mat<f64>, Vec<String>), MethodRefusal> {
    let shared = setup.model.shared_unknown_count();
    let balls = &setup.balls.balls;
    let unknowns = shared + 3 * balls.len();
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for visit in visits {
        for index in &visit.ball_indices {
            let Some(ball) = balls.get(*index) else { continue };
            let common =
                setup.model.nominal_tip_derivatives(&setup.position_at_ball(&visit.rotary_position, ball)?, setup.tip);
            for axis in 0..3 {
                let mut row: Vec<f64> = common.iter().map(|column| column[axis] / setup.centre_u_mm()).collect();
                row.resize(unknowns, 0.0);
                row[shared + 3 * index + axis] = -1.0 / setup.centre_u_mm();
                rows.push(row);
            }
        }
    }
    for bar in setup.length_bars() {
        let mut row = vec![0.0; unknowns];
        for (end, sign) in bar.ball_indices.into_iter().zip([-1.0, 1.0]) {
            let entries = row.iter_mut().skip(shared + 3 * end);
            entries.zip(&bar.direction).for_each(|(entry, part)| *entry = sign * part / bar.u_mm);
        }
        rows.push(row);
    }
    let of_balls = balls.iter().flat_map(|ball| COORDINATE_NAMES.map(|c| format!("{c}_{}", ball.id)));
    let tool = setup.model.free_stylus_coordinates().iter().map(|k| format!("t_{}", COORDINATE_NAMES[*k]));
    let names = setup.model.parameters().iter().map(ToString::to_string).chain(tool).chain(of_balls).collect();
    Ok((Mat::from_fn(rows.len(), unknowns, |i, j| rows[i][j]), names))
}

/// # Errors
/// The design leaves a combination of unknowns undetermined, or its condition is too large. The text names the
/// combination.
pub fn check_rank_and_condition(setup: &DesignSetup<'_>, visits: &[BallVisit]) -> Result<RankAnalysis, MethodRefusal> {
    let (matrix, names) = design_matrix(setup, visits)?;
    let result = analyse_rank(matrix.as_ref(), None, RANK_THRESHOLD).map_err(|error| {
        MethodRefusal::new(
            format!("the rank of the design cannot be computed: {error}"),
            "correct [machine], [axes] and [artefact]",
        )
    })?;
    if result.nullity > 0 {
        // Undetermined machine errors make the balls undetermined as well; only the machine errors and the
        // tool are named.
        let of_machine = result.null_space.get(..setup.model.shared_unknown_count(), ..);
        let lost = name_null_space(of_machine, &names);
        return Err(undetermined_refusal(setup, format!("{} of {}", result.rank, names.len()), &lost));
    }
    if result.condition > MAX_SCALED_CONDITION {
        return Err(MethodRefusal::new(
            format!("the design hardly separates its unknowns: scaled condition {:.0}", result.condition),
            "allow more indexations that are further apart, or remove parameters",
        ));
    }
    Ok(result)
}

/// Error for a design that leaves combinations undetermined, with a remedy.
fn undetermined_refusal(setup: &DesignSetup<'_>, rank: String, lost: &[String]) -> MethodRefusal {
    let (reason, remedy) = if setup.balls.lengths.is_empty() && lost.iter().any(|line| is_uniform_scale(line)) {
        (
            "the artefact has no certified length for the scale; ",
            "declare [[artefact.lengths]], or list the errors in parameters without one of EXX1, \
             EYY1, EZZ1: the other gains are then relative to that axis",
        )
    } else {
        (
            "",
            "allow more indexations (tilt_deg, turn_deg, spindle_deg) or a larger budget, add \
             balls or a certified length, or remove parameters",
        )
    };
    let lost = lost.join("; ");
    MethodRefusal::new(format!("{reason}the design determines {rank} unknowns; not determined: {lost}"), remedy)
}
