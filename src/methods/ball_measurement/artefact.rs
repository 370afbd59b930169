//! Check that an artefact is sufficient for the method, before the first motion.

use crate::Refused;
use machine::artefact::{Entry, check};
use machine::record::artefact::{Artefact, Balls};

/// Minimum number of balls. With fewer the errors of the machine cannot be separated from the positions of
/// the balls.
const LEAST_BALLS: usize = 3;

/// The balls of the artefact, for `method`.
///
/// # Errors
/// The artefact has no balls or fewer than three; stated balls or lengths are inconsistent ([`check`]).
pub fn balls<'a>(method: &str, artefact: &'a Artefact) -> Result<&'a Balls, Refused> {
    let Artefact::Balls(set) = artefact else {
        return refuse(
            format!("{method} touches balls; [artefact] states none"),
            "describe the balls with kind = \"balls\", or measure the cylinder with self-calibration",
        );
    };
    if set.balls.len() < LEAST_BALLS {
        return refuse(
            format!("{} ball(s): {method} needs three or more", set.balls.len()),
            "set up and describe at least three balls that do not stand in one line",
        );
    }
    if let Err(flaw) = check(set) {
        let of = match flaw.of {
            Entry::Ball(index) => set.balls.get(index).map(|ball| format!("ball {}", ball.id)),
            Entry::Length(index) => {
                let length = set.lengths.get(index);
                length.map(|length| format!("the length {}–{}", length.from, length.to))
            }
        };
        return refuse(
            format!("{}: {flaw}", of.unwrap_or_default()),
            "correct [artefact] in the machine file",
        );
    }
    Ok(set)
}

fn refuse<T>(why: String, instead: &str) -> Result<T, Refused> {
    Err(Refused { why, instead: instead.to_owned() })
}
