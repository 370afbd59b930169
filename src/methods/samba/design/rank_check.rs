//! Check of rank and condition of a design, before the first motion.

use faer::Mat;
use nalgebra::Vector3;

use super::setup::DesignSetup;
use crate::MethodRefusal;
use crate::ball_measurement::BallVisit;
use crate::samba::model::length_u_mm;
use estimation::linear::{RANK_THRESHOLD, RankAnalysis, analyse_rank};
use estimation::null_names::name_null_space;

/// Maximum scaled condition number. Beyond it a mistake in the design is more likely than a machine that
/// needs it.
const MAX_CONDITION: f64 = 1e4;

/// All rows of the design, weighted, for machine errors, tool and balls; and the names of these unknowns.
pub fn design_matrix(setup: &DesignSetup<'_>, visits: &[BallVisit]) -> Result<(Mat<f64>, Vec<String>), MethodRefusal> {
    let parameters = setup.model.parameters();
    let shared = setup.shared_unknown_count();
    let balls = &setup.balls.balls;
    let unknowns = shared + 3 * balls.len();
    let zero = vec![0.0; parameters.len()];
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for visit in visits {
        for index in &visit.balls {
            let Some(ball) = balls.get(*index) else { continue };
            let centre = Vector3::from(ball.centre_mm);
            let measured = setup.model.rows(&setup.position_at_ball(&visit.rotary, ball)?, &zero, setup.tip.mm, centre);
            let tool = setup
                .model
                .free_stylus_coordinates()
                .iter()
                .map(|k| measured.stylus_derivatives.column(*k).into_owned());
            let common: Vec<Vector3<f64>> = measured.error_derivatives.iter().copied().chain(tool).collect();
            for axis in 0..3 {
                let known = common.iter().map(|column| column[axis]);
                let mut row: Vec<f64> = known.map(|entry| entry / setup.centre_u_mm()).collect();
                row.resize(unknowns, 0.0);
                let entries = row.get_mut(shared + 3 * index + axis);
                entries.into_iter().for_each(|entry| *entry = -1.0 / setup.centre_u_mm());
                rows.push(row);
            }
        }
    }
    for length in &setup.balls.lengths {
        let Some((ends, direction)) = setup.length_ends(length) else { continue };
        let mut row = vec![0.0; unknowns];
        for (end, sign) in ends.into_iter().zip([-1.0, 1.0]) {
            let entries = row.iter_mut().skip(shared + 3 * end);
            entries.zip(&direction).for_each(|(entry, part)| *entry = sign * part / length_u_mm(length));
        }
        rows.push(row);
    }
    let of_balls = balls.iter().flat_map(|ball| ["x", "y", "z"].map(|c| format!("{c}_{}", ball.id)));
    let tool = setup.model.free_stylus_coordinates().iter().map(|k| ["t_x", "t_y", "t_z"][*k].to_owned());
    let names = parameters.iter().map(ToString::to_string).chain(tool).chain(of_balls).collect();
    Ok((Mat::from_fn(rows.len(), unknowns, |i, j| rows[i][j]), names))
}

/// # Errors
/// The design leaves a combination undetermined; the text names it.
pub fn check_design(setup: &DesignSetup<'_>, visits: &[BallVisit]) -> Result<RankAnalysis, MethodRefusal> {
    let (matrix, names) = design_matrix(setup, visits)?;
    let result = analyse_rank(matrix.as_ref(), None, RANK_THRESHOLD).map_err(|error| MethodRefusal {
        reason: format!("the rank of the design cannot be computed: {error}"),
        remedy: "correct [machine], [axes] and [artefact]".to_owned(),
    })?;
    if result.nullity > 0 {
        // Undetermined machine errors make the balls undetermined as well; only the machine errors and the
        // tool are named.
        let of_machine = result.null_space.get(..setup.shared_unknown_count(), ..);
        let lost = name_null_space(of_machine, &names);
        return Err(undetermined_refusal(setup, format!("{} of {}", result.rank, names.len()), &lost));
    }
    if result.condition > MAX_CONDITION {
        return Err(MethodRefusal {
            reason: format!("the design hardly separates its unknowns: scaled condition {:.0}", result.condition),
            remedy: "allow more indexations that are further apart, or remove \
                      parameters"
                .to_owned(),
        });
    }
    Ok(result)
}

/// Error for a design that leaves combinations undetermined, with a remedy.
fn undetermined_refusal(setup: &DesignSetup<'_>, rank: String, lost: &[String]) -> MethodRefusal {
    let gains = |line: &&String| ["EXX1", "EYY1", "EZZ1"].iter().filter(|g| line.contains(**g)).count();
    let no_scale = setup.balls.lengths.is_empty() && lost.iter().any(|line| gains(&line) > 1);
    let (reason, instead) = if no_scale {
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
    MethodRefusal {
        reason: format!("{reason}the design determines {rank} unknowns; not determined: {}", lost.join("; ")),
        remedy: instead.to_owned(),
    }
}
