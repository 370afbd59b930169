//! What of an artefact cannot be measured, refused before the first move.

use glam::DVec3;

use crate::artefact::{Part, Shape, parts};
use crate::methods::Refused;
use crate::record::artefact::{Artefact, Ball, Balls};

/// With fewer the machine's errors cannot be told from those of the places of the balls.
const LEAST_BALLS: usize = 3;
/// Two certified balls stand this near to their stated distance at least, beside their uncertainty, mm.
const LENGTH_SLACK_MM: f64 = 0.5;

/// The balls of the artefact.
///
/// # Errors
/// No balls, fewer than three, numbers that stand twice, balls that touch each other or a stem,
/// lengths between balls that are not there or stand otherwise.
pub fn balls(artefact: &Artefact) -> Result<&Balls, Refused> {
    let Artefact::Balls(set) = artefact else {
        return refuse(
            "samba touches balls; [artefact] states a cylinder".to_owned(),
            "describe the balls with kind = \"balls\", or measure the cylinder with self-calibration",
        );
    };
    if set.balls.len() < LEAST_BALLS {
        return refuse(
            format!("{} ball(s): samba needs three or more", set.balls.len()),
            "set up and describe at least three balls that do not stand in one line",
        );
    }
    for (index, ball) in set.balls.iter().enumerate() {
        check_ball(ball)?;
        if set.balls.iter().take(index).any(|other| other.id == ball.id) {
            return refuse(
                format!("two balls have the number {}", ball.id),
                "give every ball of [artefact] an id of its own",
            );
        }
    }
    check_apart(artefact, set)?;
    check_lengths(set)?;
    Ok(set)
}

fn refuse<T>(why: String, instead: &str) -> Result<T, Refused> {
    Err(Refused { why, instead: instead.to_owned() })
}

fn check_ball(ball: &Ball) -> Result<(), Refused> {
    let id = &ball.id;
    if id.is_empty() || id.contains('/') {
        return refuse(
            format!("`{id}` cannot be the number of a ball"),
            "choose a short id without `/`: it stands in the labels of the steps",
        );
    }
    let finite = ball.centre_mm.iter().chain(&ball.stem).all(|value| value.is_finite());
    if !(finite && ball.radius_mm > 0.0 && ball.radius_mm.is_finite()) {
        return refuse(
            format!("ball {id} has no radius or no place"),
            "state centre_mm and a radius_mm greater than 0",
        );
    }
    if DVec3::from_array(ball.stem).try_normalize().is_none() {
        return refuse(
            format!("the stem of ball {id} has no direction"),
            "state stem as the direction from the centre to the foot, e.g. [0, 0, -1]",
        );
    }
    Ok(())
}

/// No ball may touch another or another's stem.
fn check_apart(artefact: &Artefact, set: &Balls) -> Result<(), Refused> {
    let bodies = parts(artefact);
    for (index, ball) in set.balls.iter().enumerate() {
        let centre = DVec3::from_array(ball.centre_mm);
        let own = |part: &Part| part.name == format!("stem of ball {}", ball.id);
        let others = bodies.iter().enumerate().filter(|(at, part)| *at != index && !own(part));
        for (_, part) in others {
            let gap = distance(&part.shape, centre) - ball.radius_mm;
            if gap <= 0.0 {
                return refuse(
                    format!(
                        "ball {} and {} touch or overlap by {:.2} mm",
                        ball.id, part.name, -gap
                    ),
                    "set them further apart, or correct centre_mm, radius_mm and stem in [artefact]",
                );
            }
        }
    }
    Ok(())
}

/// Of a point from the surface of a body, mm; a flat end counts as round.
fn distance(shape: &Shape, point: DVec3) -> f64 {
    match *shape {
        Shape::Ball { centre, radius } => centre.distance(point) - radius,
        Shape::Cylinder { from, to, radius } => {
            let way = to - from;
            let share = (point - from).dot(way) / way.length_squared().max(f64::MIN_POSITIVE);
            (from + way * share.clamp(0.0, 1.0)).distance(point) - radius
        }
    }
}

fn check_lengths(set: &Balls) -> Result<(), Refused> {
    for length in &set.lengths {
        let find = |id: &String| set.balls.iter().find(|ball| ball.id == *id);
        let (Some(from), Some(to)) = (find(&length.from), find(&length.to)) else {
            return refuse(
                format!(
                    "there is no pair of balls {} and {} for the length",
                    length.from, length.to
                ),
                "name the ids of two balls of [artefact] in from and to",
            );
        };
        let stated = DVec3::from_array(from.centre_mm).distance(DVec3::from_array(to.centre_mm));
        let slack = LENGTH_SLACK_MM + 2.0 * set.uncertainty_mm;
        let agrees = (stated - length.mm).abs() <= slack;
        if from.id == to.id || !agrees {
            return refuse(
                format!(
                    "the length {} to {} is {} mm, but the stated centres are {stated:.3} mm apart",
                    length.from, length.to, length.mm
                ),
                "correct the certificate's length, its balls, or their centre_mm",
            );
        }
        if !(length.u_mm >= 0.0 && length.u_mm.is_finite()) {
            return refuse(
                format!("the length {} to {} has no uncertainty", length.from, length.to),
                "state u_mm, the standard uncertainty of its certificate",
            );
        }
    }
    Ok(())
}
