//! From touch to touch of one ball: round it instead of over it.
//!
//! A touch ends aside, as far from the ball as an unguarded move may begin. From there the way leads
//! guarded over the corner where the tangents of both places meet, so that it is nowhere nearer to the
//! ball than where the nearer touch begins.

use glam::DVec3;

use super::limits;
use super::over_balls::LIFT;
use super::surroundings::{OneBall, Surroundings};
use crate::base::{Axis, Position};
use crate::record::machine::Machine;

/// Further round, the corner stands out so far that over the ball is as short.
const WIDEST_COS: f64 = -0.5;
/// Rounding of a place, mm.
const SLACK: f64 = 1e-3;

/// The places to go through from where the machine stands beside a ball, or over it, to the start of
/// the next touch of the same ball: a corner if one is wanted, and the start. `None`: not that near to
/// the ball, too far round it, out of travel, or something else is in the way.
pub(super) fn round(
    about: &Surroundings,
    machine: &Machine,
    stands: &Position,
    start: &Position,
) -> Option<Vec<Position>> {
    let ball = about.ball_at(start)?;
    let (here, there) = (about.off(&ball, stands), about.off(&ball, start));
    let near = ball.reach + ball.loose;
    let about_it = |off: DVec3| (near..near + 2.0 * LIFT).contains(&off.length());
    // Below its middle the stylus would come nearer with its stem than with its ball.
    let upper = here.z.min(there.z) >= -SLACK;
    if !(about_it(here) && about_it(there) && upper) {
        return None;
    }
    let mut places = Vec::new();
    if nearest(here, there) < here.length().min(there.length()) - SLACK {
        places.push(place(about, machine, &ball, (start, corner(here, there)?))?);
    }
    places.push(start.clone());
    let mut from = stands;
    for to in &places {
        if !about.passes(from, to, &ball.name) {
            return None;
        }
        from = to;
    }
    Some(places)
}

/// Straight away from the ball that was touched from `start`, so far that the next way may be fast.
/// `None`: out of travel, or something else is near.
pub(super) fn aside(about: &Surroundings, machine: &Machine, start: &Position) -> Option<Position> {
    let ball = about.ball_at(start)?;
    let there = about.off(&ball, start);
    let far = (ball.reach + ball.loose + LIFT + SLACK).max(there.length());
    let end = place(about, machine, &ball, (start, there.try_normalize()? * far))?;
    let free = about.passes(start, &end, &ball.name) && about.is_clear(&end, LIFT);
    free.then_some(end)
}

fn place(
    about: &Surroundings,
    machine: &Machine,
    ball: &OneBall,
    (rotary, off): (&Position, DVec3),
) -> Option<Position> {
    let place = about.beside(ball, rotary, off).ok()?;
    limits::within(&place.only(Axis::is_linear), machine).then_some(place)
}

/// Of the straight way, from the origin.
fn nearest(here: DVec3, there: DVec3) -> f64 {
    let way = there - here;
    let share = -here.dot(way) / way.length_squared().max(f64::MIN_POSITIVE);
    (here + way * share.clamp(0.0, 1.0)).length()
}

/// Where the tangents of two places meet, in the plane of both and the origin.
fn corner(here: DVec3, there: DVec3) -> Option<DVec3> {
    let (a, b) = (here.length(), there.length());
    let (u, v) = (here.try_normalize()?, there.try_normalize()?);
    let cos = u.dot(v);
    let square = 1.0 - cos * cos;
    (cos >= WIDEST_COS && square > 0.0).then(|| (u * (a - b * cos) + v * (b - a * cos)) / square)
}
