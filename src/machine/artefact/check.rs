//! Check that the declared balls are geometrically possible.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::frame::unit_vector;
use crate::record::artefact::{Ball, Balls, Length};

/// One fault, the ball or length (counted from 0) that has it, and a text that follows the key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{key}` {why}")]
pub struct ArtefactFault {
    pub of: Entry,
    pub key: &'static str,
    pub why: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry {
    Ball(usize),
    Length(usize),
}

type Checked = Result<(), ArtefactFault>;

/// # Errors
/// The first fault: of single balls and of pairs in their order, then of the lengths.
pub fn check(balls: &Balls) -> Checked {
    for (index, ball) in balls.balls.iter().enumerate() {
        let at = At(Entry::Ball(index));
        alone(&at, ball)?;
        for other in balls.balls.iter().take(index) {
            apart(&at, ball, other)?;
        }
    }
    let centres: BTreeMap<&str, Vector3<f64>> =
        balls.balls.iter().map(|ball| (ball.id.as_str(), centre(ball))).collect();
    let mut lengths = balls.lengths.iter().enumerate();
    lengths.try_for_each(|(index, length)| {
        certified(&At(Entry::Length(index)), length, &centres, balls.uncertainty_mm)
    })
}

struct At(Entry);

impl At {
    fn that(&self, holds: bool, key: &'static str, why: impl FnOnce() -> String) -> Checked {
        if holds { Ok(()) } else { Err(ArtefactFault { of: self.0, key, why: why() }) }
    }
}

fn alone(at: &At, ball: &Ball) -> Checked {
    let Ball { id, radius_mm, stem, stem_radius_mm, stem_length_mm, .. } = ball;
    at.that(!id.is_empty(), "id", || "must not be empty".to_owned())?;
    let plain = |c: char| !(c == '/' || c == ',' || c.is_whitespace() || c.is_control());
    at.that(id.chars().all(plain), "id", || {
        format!("is `{id}`; it must be one word without `/` or `,`")
    })?;
    let places = ball.centre_mm.iter().all(|place| place.is_finite());
    at.that(places, "centre_mm", || "must be three finite numbers".to_owned())?;
    let above = |value: &f64| format!("is {value}; it must be greater than 0");
    let sound = *radius_mm > 0.0 && radius_mm.is_finite();
    at.that(sound, "radius_mm", || above(radius_mm))?;
    let negative = |value: &f64| format!("is {value}; it must not be negative");
    at.that(*stem_radius_mm >= 0.0, "stem_radius_mm", || negative(stem_radius_mm))?;
    at.that(*stem_length_mm >= 0.0, "stem_length_mm", || negative(stem_length_mm))?;
    at.that(stem_radius_mm < radius_mm, "stem_radius_mm", || {
        format!("is {stem_radius_mm}; the stem must be thinner than its ball (radius {radius_mm})")
    })?;
    let direction = unit_vector(Vector3::from(*stem));
    at.that(direction.is_some(), "stem", || {
        "must have a direction, from the ball to the stem's foot: [0, 0, -1]".to_owned()
    })?;
    at.that(*stem_length_mm == 0.0 || stem_length_mm > radius_mm, "stem_length_mm", || {
        format!(
            "is {stem_length_mm}; it counts from the ball's centre and must be more than {radius_mm}"
        )
    })
}

/// Checks a pair; `other` comes before `ball` in the list.
fn apart(at: &At, ball: &Ball, other: &Ball) -> Checked {
    at.that(ball.id != other.id, "id", || {
        format!("is `{}`, and so is another one's: give each ball its own", ball.id)
    })?;
    let distance = centre(ball).metric_distance(&centre(other));
    at.that(distance > ball.radius_mm + other.radius_mm, "centre_mm", || {
        format!("stands {distance:.3} mm from ball `{}`: the two would touch", other.id)
    })?;
    for (one, beside) in [(ball, other), (other, ball)] {
        let (near, free) = (to_stem(beside, one), one.radius_mm + one_stem(beside));
        at.that(one_stem(beside) == 0.0 || near > free, "centre_mm", || {
            format!(
                "puts ball `{}` into the stem of ball `{}`: {near:.3} mm from its middle line",
                one.id, beside.id
            )
        })?;
    }
    Ok(())
}

fn certified(
    at: &At,
    length: &Length,
    centres: &BTreeMap<&str, Vector3<f64>>,
    uncertainty_mm: f64,
) -> Checked {
    let Length { from, to, mm, u_mm, u_temperature_k, .. } = length;
    let unknown = |id: &str| format!("is `{id}`, a ball that is not in the list");
    let (one, other) = (centres.get(from.as_str()), centres.get(to.as_str()));
    at.that(one.is_some(), "from", || unknown(from))?;
    at.that(other.is_some(), "to", || unknown(to))?;
    at.that(from != to, "to", || format!("is `{to}`, as `from` is: a length has two ends"))?;
    at.that(*mm > 0.0, "mm", || format!("is {mm}; it must be greater than 0"))?;
    at.that(*u_mm > 0.0, "u_mm", || {
        format!("is {u_mm}; the standard uncertainty of a certificate is greater than 0")
    })?;
    at.that(*u_temperature_k >= 0.0, "u_temperature_k", || {
        format!("is {u_temperature_k}; it must not be negative")
    })?;
    let stated = one.zip(other).map_or(0.0, |(one, other)| one.metric_distance(other));
    at.that((mm - stated).abs() <= 2.0 * uncertainty_mm, "mm", || {
        format!(
            "is {mm}, but balls `{from}` and `{to}` are stated {stated:.3} mm apart: more than twice \
             uncertainty_mm between the two"
        )
    })
}

fn centre(ball: &Ball) -> Vector3<f64> {
    Vector3::from(ball.centre_mm)
}

/// Radius of the stem, mm; 0 if no stem is declared.
fn one_stem(ball: &Ball) -> f64 {
    if ball.stem_length_mm > 0.0 { ball.stem_radius_mm } else { 0.0 }
}

/// Distance of the centre of `of` from the centre line of the stem of `ball`, mm.
fn to_stem(ball: &Ball, of: &Ball) -> f64 {
    let along = unit_vector(Vector3::from(ball.stem)).unwrap_or_default();
    let from_ball = centre(of) - centre(ball);
    let foot = along * from_ball.dot(&along).clamp(0.0, ball.stem_length_mm.max(0.0));
    from_ball.metric_distance(&foot)
}
