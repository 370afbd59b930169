//! Check of rank and condition of a design, before the first motion.

use faer::Mat;
use nalgebra::Vector3;

use super::bench::DesignSetup;
use crate::Refused;
use crate::ball_measurement::Visit;
use crate::samba::model::length_u_mm;
use estimation::linear::{RANK_THRESHOLD, Survey, survey};
use estimation::null_names::name_null_space;

/// Maximum scaled condition number. Beyond it a mistake in the design is more likely than a machine that
/// needs it.
const WORST_CONDITION: f64 = 1e4;

/// All rows of the design, weighted, for machine errors, tool and balls; and the names of these unknowns.
pub fn matrix(
    bench: &DesignSetup<'_>,
    visits: &[Visit],
) -> Result<(Mat<f64>, Vec<String>), Refused> {
    let parameters = bench.model.parameters();
    let shared = bench.shared();
    let balls = &bench.balls.balls;
    let unknowns = shared + 3 * balls.len();
    let zero = vec![0.0; parameters.len()];
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for visit in visits {
        for index in &visit.balls {
            let Some(ball) = balls.get(*index) else { continue };
            let centre = Vector3::from(ball.centre_mm);
            let seen =
                bench.model.rows(&bench.on_ball(&visit.at, ball)?, &zero, bench.tip.mm, centre);
            let tool = bench.model.stylus().iter().map(|k| seen.tool.column(*k).into_owned());
            let common: Vec<Vector3<f64>> = seen.machine.iter().copied().chain(tool).collect();
            for axis in 0..3 {
                let known = common.iter().map(|column| column[axis]);
                let mut row: Vec<f64> = known.map(|entry| entry / bench.u_mm()).collect();
                row.resize(unknowns, 0.0);
                let own = row.get_mut(shared + 3 * index + axis);
                own.into_iter().for_each(|entry| *entry = -1.0 / bench.u_mm());
                rows.push(row);
            }
        }
    }
    for length in &bench.balls.lengths {
        let Some((ends, direction)) = bench.ends(length) else { continue };
        let mut row = vec![0.0; unknowns];
        for (end, sign) in ends.into_iter().zip([-1.0, 1.0]) {
            let own = row.iter_mut().skip(shared + 3 * end);
            own.zip(&direction)
                .for_each(|(entry, part)| *entry = sign * part / length_u_mm(length));
        }
        rows.push(row);
    }
    let of_balls =
        balls.iter().flat_map(|ball| ["x", "y", "z"].map(|c| format!("{c}_{}", ball.id)));
    let tool = bench.model.stylus().iter().map(|k| ["t_x", "t_y", "t_z"][*k].to_owned());
    let names = parameters.iter().map(ToString::to_string).chain(tool).chain(of_balls).collect();
    Ok((Mat::from_fn(rows.len(), unknowns, |i, j| rows[i][j]), names))
}

/// # Errors
/// The design leaves a combination undetermined; the text names it.
pub fn check(bench: &DesignSetup<'_>, visits: &[Visit]) -> Result<Survey, Refused> {
    let (matrix, names) = matrix(bench, visits)?;
    let found = survey(matrix.as_ref(), None, RANK_THRESHOLD).map_err(|error| Refused {
        why: format!("the design cannot be judged: {error}"),
        instead: "correct [machine], [axes] and [artefact]".to_owned(),
    })?;
    if found.nullity > 0 {
        // Undetermined machine errors make the balls undetermined as well; only the machine errors and the
        // tool are named.
        let of_machine = found.null_space.get(..bench.shared(), ..);
        let lost = name_null_space(of_machine, &names);
        return Err(open(bench, format!("{} of {}", found.rank, names.len()), &lost));
    }
    if found.condition > WORST_CONDITION {
        return Err(Refused {
            why: format!(
                "this design hardly tells its unknowns apart: scaled condition {:.0}",
                found.condition
            ),
            instead: "allow more indexations, further apart, or take parameters out".to_owned(),
        });
    }
    Ok(found)
}

/// Error for a design that leaves combinations undetermined, with a remedy.
fn open(bench: &DesignSetup<'_>, sees: String, lost: &[String]) -> Refused {
    let gains =
        |line: &&String| ["EXX1", "EYY1", "EZZ1"].iter().filter(|g| line.contains(**g)).count();
    let no_scale = bench.balls.lengths.is_empty() && lost.iter().any(|line| gains(&line) > 1);
    let (because, instead) = if no_scale {
        (
            "there is no certified length, which would give the scale; ",
            "declare [[artefact.lengths]], or name the errors in parameters and leave one of EXX1, \
             EYY1, EZZ1 out: the other gains are then against that one",
        )
    } else {
        (
            "",
            "allow more indexations (tilt_deg, turn_deg, spindle_deg) or a larger budget, add balls \
             or a certified length, or take parameters out",
        )
    };
    Refused {
        why: format!(
            "{because}this design sees {sees} unknowns; it cannot tell {}",
            lost.join("; ")
        ),
        instead: instead.to_owned(),
    }
}
