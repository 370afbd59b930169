//! Check that the declared balls are geometrically possible.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::frame::unit_vector;
use crate::record::artefact::{Ball, Balls, CertifiedLength};

/// A fault in the declared balls: the ball or length (counted from 0), the wrong key, and a message to print after it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{key}` {message}")]
pub struct ArtefactFault {
    pub entry: ArtefactEntry,
    pub key: &'static str,
    pub message: String,
}

/// Faulty entry of the artefact: index of a ball or of a certified length, from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArtefactEntry {
    Ball(usize),
    Length(usize),
}

type CheckResult = Result<(), ArtefactFault>;

/// Checks the balls and the certified lengths.
///
/// # Errors
/// The first fault: of each ball and its pairs with earlier balls, in the order of the list, then of the lengths.
pub fn check_balls(balls: &Balls) -> CheckResult {
    for (index, ball) in balls.balls.iter().enumerate() {
        let entry = EntryCheck(ArtefactEntry::Ball(index));
        check_ball(&entry, ball)?;
        for other in balls.balls.iter().take(index) {
            check_ball_pair(&entry, ball, other)?;
        }
    }
    let centres: BTreeMap<&str, Vector3<f64>> =
        balls.balls.iter().map(|ball| (ball.id.as_str(), ball_centre(ball))).collect();
    let mut lengths = balls.lengths.iter().enumerate();
    lengths.try_for_each(|(index, length)| {
        check_certified_length(&EntryCheck(ArtefactEntry::Length(index)), length, &centres, balls.uncertainty_mm)
    })
}

/// Checks of one entry; a fault contains this entry.
struct EntryCheck(ArtefactEntry);

impl EntryCheck {
    fn require(&self, holds: bool, key: &'static str, message: impl FnOnce() -> String) -> CheckResult {
        if holds { Ok(()) } else { Err(ArtefactFault { entry: self.0, key, message: message() }) }
    }
}

fn check_ball(entry: &EntryCheck, ball: &Ball) -> CheckResult {
    let Ball { id, radius_mm, stem, stem_radius_mm, stem_length_mm, .. } = ball;
    entry.require(!id.is_empty(), "id", || "must not be empty".to_owned())?;
    let is_id_char = |c: char| !(c == '/' || c == ',' || c.is_whitespace() || c.is_control());
    entry.require(id.chars().all(is_id_char), "id", || format!("is `{id}`; it must be one word without `/` or `,`"))?;
    let is_finite = ball.centre_mm.iter().all(|coordinate| coordinate.is_finite());
    entry.require(is_finite, "centre_mm", || "must be three finite numbers".to_owned())?;
    let must_be_positive = |value: &f64| format!("is {value}; it must be greater than 0");
    let is_positive = *radius_mm > 0.0 && radius_mm.is_finite();
    entry.require(is_positive, "radius_mm", || must_be_positive(radius_mm))?;
    let must_not_be_negative = |value: &f64| format!("is {value}; it must not be negative");
    entry.require(*stem_radius_mm >= 0.0, "stem_radius_mm", || must_not_be_negative(stem_radius_mm))?;
    entry.require(*stem_length_mm >= 0.0, "stem_length_mm", || must_not_be_negative(stem_length_mm))?;
    entry.require(stem_radius_mm < radius_mm, "stem_radius_mm", || {
        format!("is {stem_radius_mm}; the stem must be thinner than its ball (radius {radius_mm})")
    })?;
    let direction = unit_vector(Vector3::from(*stem));
    entry.require(direction.is_some(), "stem", || {
        "must be a direction from the ball to the foot of the stem, e.g. [0, 0, -1]".to_owned()
    })?;
    entry.require(*stem_length_mm == 0.0 || stem_length_mm > radius_mm, "stem_length_mm", || {
        format!(
            "is {stem_length_mm}; the length is measured from the centre of the ball and must be more than {radius_mm}"
        )
    })
}

/// Checks a pair; `other` comes before `ball` in the list.
fn check_ball_pair(entry: &EntryCheck, ball: &Ball, other: &Ball) -> CheckResult {
    entry.require(ball.id != other.id, "id", || {
        format!("is `{}`, as for another ball; give each ball its own id", ball.id)
    })?;
    let distance = ball_centre(ball).metric_distance(&ball_centre(other));
    entry.require(distance > ball.radius_mm + other.radius_mm, "centre_mm", || {
        format!("is {distance:.3} mm from ball `{}`; the two balls would touch", other.id)
    })?;
    for (body, stemmed) in [(ball, other), (other, ball)] {
        let (distance, min_distance) = (distance_to_stem(stemmed, body), body.radius_mm + stem_radius(stemmed));
        entry.require(stem_radius(stemmed) == 0.0 || distance > min_distance, "centre_mm", || {
            format!(
                "puts ball `{}` into the stem of ball `{}`: {distance:.3} mm from the centre line of the stem",
                body.id, stemmed.id
            )
        })?;
    }
    Ok(())
}

/// Checks a certified length: its balls, its numbers, and its agreement with the stated centres within twice
/// `uncertainty_mm`.
fn check_certified_length(
    entry: &EntryCheck,
    length: &CertifiedLength,
    centres: &BTreeMap<&str, Vector3<f64>>,
    uncertainty_mm: f64,
) -> CheckResult {
    let CertifiedLength { from, to, mm, u_mm, u_temperature_k, .. } = length;
    let unknown = |id: &str| format!("is `{id}`; no ball in the list has this id");
    let (from_centre, to_centre) = (centres.get(from.as_str()), centres.get(to.as_str()));
    entry.require(from_centre.is_some(), "from", || unknown(from))?;
    entry.require(to_centre.is_some(), "to", || unknown(to))?;
    entry.require(from != to, "to", || {
        format!("is `{to}`, the same ball as `from`; a length needs two different balls")
    })?;
    entry.require(*mm > 0.0, "mm", || format!("is {mm}; it must be greater than 0"))?;
    entry.require(*u_mm > 0.0, "u_mm", || {
        format!("is {u_mm}; the standard uncertainty of a certificate is greater than 0")
    })?;
    entry.require(*u_temperature_k >= 0.0, "u_temperature_k", || {
        format!("is {u_temperature_k}; it must not be negative")
    })?;
    let stated = from_centre.zip(to_centre).map_or(0.0, |(from, to)| from.metric_distance(to));
    entry.require((mm - stated).abs() <= 2.0 * uncertainty_mm, "mm", || {
        format!(
            "is {mm}, but the stated centres of balls `{from}` and `{to}` are {stated:.3} mm apart; the \
             difference is more than twice uncertainty_mm"
        )
    })
}

fn ball_centre(ball: &Ball) -> Vector3<f64> {
    Vector3::from(ball.centre_mm)
}

/// Radius of the stem, mm; 0 if no stem is declared.
fn stem_radius(ball: &Ball) -> f64 {
    if ball.stem_length_mm > 0.0 { ball.stem_radius_mm } else { 0.0 }
}

/// Distance of the centre of `other` from the centre line of the stem of `ball`, mm.
fn distance_to_stem(ball: &Ball, other: &Ball) -> f64 {
    let along = unit_vector(Vector3::from(ball.stem)).unwrap_or_default();
    let from_ball = ball_centre(other) - ball_centre(ball);
    let foot = along * from_ball.dot(&along).clamp(0.0, ball.stem_length_mm.max(0.0));
    from_ball.metric_distance(&foot)
}
