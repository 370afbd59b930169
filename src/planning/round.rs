//! Paths from touch to touch of one ball: round the ball instead of over it.
//!
//! A touch ends beside the ball, at the distance at which an unguarded move may begin. From there, the guarded path
//! leads over one corner along two tangents, so that it is nowhere nearer to the ball than the start of the next
//! touch.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Unit, Vector3};

use super::clearance::LIFT;
use super::hull::Body;
use super::limits;
use super::surroundings::{Obstacle, Surroundings};
use machine::artefact::Shape;
use machine::frame::unit_vector;
use machine::kinematics::KinematicsError;
use machine::record::machine::Machine;
use machine::{Axis, Position, frame::Point};

/// Maximum angle of a path round the ball, rad; with a larger angle, the corner is so far out that a path over the
/// ball is as short.
const WIDEST: f64 = 2.0 / 3.0 * PI;
/// Rounding tolerance of a position, mm.
const SLACK: f64 = 1e-3;

/// A ball of the artefact.
#[derive(Debug, Clone)]
struct OneBall {
    name: String,
    /// Centre, table frame, mm.
    centre: Vector3<f64>,
    /// Distance of the stylus ball's centre from this centre at contact, mm.
    reach: f64,
    /// Maximum distance of the ball from its expected position, mm.
    loose: f64,
}

/// Positions of the path from the position of the machine, beside a ball or above it, to the start of the next
/// touch of the same ball: a corner if necessary, and the start. `None`: the machine is not near the ball, the path
/// round it is too long or out of travel, or an obstacle blocks it.
pub(super) fn round(
    about: &Surroundings,
    machine: &Machine,
    stands: &Position,
    start: &Position,
) -> Option<Vec<Position>> {
    let ball = about.ball_at(start)?;
    let (here, there) = (about.off(&ball, stands), about.off(&ball, start));
    let near = ball.reach + ball.loose;
    let about_it = |off: Vector3<f64>| (near..near + 2.0 * LIFT).contains(&off.norm());
    // Below the ball's centre, the stem of the stylus would come nearer than its ball.
    let upper = here.z.min(there.z) >= -SLACK;
    if !(about_it(here) && about_it(there) && upper) {
        return None;
    }
    let corner = corner(here, there)?.into_iter();
    let corner = corner.map(|off| place(about, machine, &ball, (start, off)));
    let places: Vec<Position> = corner.chain([Some(start.clone())]).collect::<Option<_>>()?;
    let mut from = stands;
    for to in &places {
        if !about.passes(from, to, &ball.name) {
            return None;
        }
        from = to;
    }
    Some(places)
}

/// Position straight away from the ball that was touched from `start`, at a distance from which the next path may
/// begin with a rapid. `None`: out of travel, or an obstacle is near.
pub(super) fn aside(about: &Surroundings, machine: &Machine, start: &Position) -> Option<Position> {
    let ball = about.ball_at(start)?;
    let there = about.off(&ball, start);
    let far = (ball.reach + ball.loose + LIFT + SLACK).max(there.norm());
    let end = place(about, machine, &ball, (start, unit_vector(there)? * far))?;
    let free = about.passes(start, &end, &ball.name) && about.is_clear(&end, LIFT);
    free.then_some(end)
}

fn place(
    about: &Surroundings,
    machine: &Machine,
    ball: &OneBall,
    (rotary, off): (&Position, Vector3<f64>),
) -> Option<Position> {
    let place = about.beside(ball, rotary, off).ok()?;
    limits::within(&place.only(Axis::is_linear), machine).then_some(place)
}

/// Corner at which the tangents from two places meet, in the plane of the places and the origin. The tangents touch
/// a ball about the origin whose radius is the distance of the nearer place. Empty if the straight path is clear of
/// that ball. `None`: the angle is too large.
fn corner(here: Vector3<f64>, there: Vector3<f64>) -> Option<Vec<Vector3<f64>>> {
    let radius = here.norm().min(there.norm());
    let (u, v) = (unit_vector(here)?, unit_vector(there)?);
    let to_tangent = |from: Vector3<f64>| (radius / from.norm()).min(1.0).acos();
    let left = u.angle(&v) - to_tangent(here) - to_tangent(there);
    if left <= 0.0 {
        return Some(Vec::new());
    }
    let turn = Rotation3::from_axis_angle(
        &Unit::try_new(u.cross(&v), 0.0)?,
        to_tangent(here) + left / 2.0,
    );
    (left <= WIDEST).then(|| vec![turn * u * (radius / (left / 2.0).cos())])
}

impl Surroundings {
    /// The ball nearest to the stylus ball.
    fn ball_at(&self, at: &Position) -> Option<OneBall> {
        let ball = |obstacle: &Obstacle| match obstacle.body {
            Body::Round(Shape::Ball { centre, radius }) if obstacle.of_artefact => Some(OneBall {
                name: obstacle.name.clone(),
                centre,
                reach: radius + self.ball_radius,
                loose: obstacle.loose,
            }),
            _ => None,
        };
        let gap = |ball: &OneBall| self.off(ball, at).norm() - ball.reach;
        let balls = self.obstacles.iter().filter_map(ball);
        balls.min_by(|one, other| gap(one).total_cmp(&gap(other)))
    }

    /// Vector from the centre of a ball to the stylus ball's centre, machine directions.
    fn off(&self, ball: &OneBall, at: &Position) -> Vector3<f64> {
        let table = self.chain.machine_from_table(at, &[]).rotation;
        table * (self.chain.tip_in_table(at, self.tip, &[]).mm - ball.centre)
    }

    /// Position at which the stylus ball is at `off` from a ball, with the rotary axes as in `rotary`.
    ///
    /// # Errors
    /// The linear axes of the machine do not span space.
    fn beside(
        &self,
        ball: &OneBall,
        rotary: &Position,
        off: Vector3<f64>,
    ) -> Result<Position, KinematicsError> {
        let rotary = rotary.only(|axis| !axis.is_linear());
        let table = self.chain.machine_from_table(&rotary, &[]).rotation;
        let target = Point::from_vec(ball.centre + table.transpose() * off);
        let linear = self.chain.linear_axes_for(target, self.tip, &rotary, &[])?;
        Ok(rotary.updated_by(&linear))
    }
}
