//! Check that an artefact is sufficient for the method, before the first motion.

use crate::MethodRefusal;
use machine::artefact::{ArtefactEntry, check_balls};
use machine::record::artefact::{Artefact, Balls};

/// Minimum number of balls. With fewer the errors of the machine cannot be separated from the positions of
/// the balls.
const MIN_BALL_COUNT: usize = 3;

/// The balls of the artefact, for `method`.
///
/// # Errors
/// The artefact has no balls or fewer than three; stated balls or lengths are inconsistent ([`check_balls`]).
pub fn require_balls<'a>(method: &str, artefact: &'a Artefact) -> Result<&'a Balls, MethodRefusal> {
    let Artefact::Balls(set) = artefact else {
        return Err(MethodRefusal::new(
            format!("{method} measures balls, but [artefact] has none"),
            "describe the balls with kind = \"balls\", or measure the cylinder with self-calibration",
        ));
    };
    MethodRefusal::require(
        set.balls.len() >= MIN_BALL_COUNT,
        format!("[artefact] has {} ball(s): {method} requires three or more", set.balls.len()),
        "set up and describe at least three balls that are not in one line",
    )?;
    check_balls(set).map_err(|flaw| {
        let of = match flaw.entry {
            ArtefactEntry::Ball(index) => set.balls.get(index).map(|ball| format!("ball {}", ball.id)),
            ArtefactEntry::Length(index) => {
                set.lengths.get(index).map(|length| format!("the length {}–{}", length.from, length.to))
            }
        };
        MethodRefusal::new(format!("{}: {flaw}", of.unwrap_or_default()), "correct [artefact] in the machine file")
    })?;
    Ok(set)
}

/// Index of the ball with this name.
pub fn ball_index(balls: &Balls, id: &str) -> Option<usize> {
    balls.balls.iter().position(|ball| ball.id == id)
}
