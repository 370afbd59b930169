//! Paths from touch to touch of one ball: around the ball instead of over it.
//!
//! A touch ends beside the ball, at the distance at which an unguarded move may begin. From there, the guarded path
//! leads over one corner along two tangents, so that it is nowhere nearer to the ball than the start of the next
//! touch.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Unit, Vector3};

use super::obstacle_body::ObstacleBody;
use super::safe_heights::PLANNED_GUARDED_CLEARANCE_MM;
use super::surroundings::{Obstacle, Surroundings};
use super::travel_limits;
use machine::artefact::BodyShape;
use machine::frame::unit_vector;
use machine::record::machine::Machine;
use machine::{Axis, Position};

/// Maximum angle, at the centre of the ball, between the points where the two tangents of the path touch, rad; with a
/// larger angle, the corner is so far out that a path over the ball is as short.
const MAX_ANGLE_BETWEEN_TANGENT_POINTS_RAD: f64 = 2.0 / 3.0 * PI;
/// Rounding tolerance of a position, mm.
const POSITION_TOLERANCE_MM: f64 = 1e-3;

/// A ball of the artefact.
#[derive(Debug, Clone)]
struct ArtefactBall {
    name: String,
    /// Centre, table frame, mm.
    centre: Vector3<f64>,
    /// Distance of the stylus ball's centre from this centre at contact, mm.
    contact_distance_mm: f64,
    /// Maximum distance of the ball from its expected position, mm.
    max_misplacement_mm: f64,
}

/// Positions of the path from the position of the machine, beside a ball or above it, to the start of the next
/// touch of the same ball: a corner if necessary, and the start. `None`: the artefact has no ball, the machine or the
/// start is not near the ball or is below its centre, or the path is too long, out of travel or blocked.
pub(super) fn plan_path_around_ball(
    surroundings: &Surroundings,
    machine: &Machine,
    position: &Position,
    start: &Position,
) -> Option<Vec<Position>> {
    let ball = surroundings.nearest_ball(start)?;
    let [here, there] = [position, start].map(|at| surroundings.tip_offset_in_machine_directions(&ball, at));
    let near = ball.contact_distance_mm + ball.max_misplacement_mm;
    let about_it = |off: Vector3<f64>| (near..near + 2.0 * PLANNED_GUARDED_CLEARANCE_MM).contains(&off.norm());
    // Below the centre of the ball, the stylus stem would come nearer to the ball than the stylus ball.
    let upper = here.z.min(there.z) >= -POSITION_TOLERANCE_MM;
    if !(about_it(here) && about_it(there) && upper) {
        return None;
    }
    let corner = tangent_corner(here, there)?.into_iter();
    let corner = corner.map(|off| reachable_position_beside_ball(surroundings, machine, &ball, start, off));
    let places: Vec<Position> = corner.chain([Some(start.clone())]).collect::<Option<_>>()?;
    let starts = [position].into_iter().chain(&places);
    let is_free = starts.zip(&places).all(|(from, to)| surroundings.is_path_free(from, to, &ball.name));
    is_free.then_some(places)
}

/// Position on the line from the centre of the touched ball through `start`, far enough from the ball for the next
/// path to begin with a rapid. `None`: out of travel, or an obstacle is near.
pub(super) fn block_end_beside_ball(
    surroundings: &Surroundings,
    machine: &Machine,
    start: &Position,
) -> Option<Position> {
    let ball = surroundings.nearest_ball(start)?;
    let there = surroundings.tip_offset_in_machine_directions(&ball, start);
    let far =
        (ball.contact_distance_mm + ball.max_misplacement_mm + PLANNED_GUARDED_CLEARANCE_MM + POSITION_TOLERANCE_MM)
            .max(there.norm());
    let end = reachable_position_beside_ball(surroundings, machine, &ball, start, unit_vector(there)? * far)?;
    let free = surroundings.is_path_free(start, &end, &ball.name)
        && surroundings.is_tool_clear(&end, PLANNED_GUARDED_CLEARANCE_MM);
    free.then_some(end)
}

/// Position at which the stylus ball is displaced by `off` (machine directions, mm) from the centre of `ball`, with
/// the rotary axes as in `rotary`. `None`: out of the travel of a linear axis.
fn reachable_position_beside_ball(
    surroundings: &Surroundings,
    machine: &Machine,
    ball: &ArtefactBall,
    rotary: &Position,
    off: Vector3<f64>,
) -> Option<Position> {
    let table = surroundings.chain.machine_from_table(rotary, &[]).rotation;
    let place = surroundings.position_at_table_point(ball.centre + table.transpose() * off, rotary).ok()?;
    travel_limits::is_position_within_limits(&place.filter_axes(Axis::is_linear), machine).then_some(place)
}

/// Corner at which the tangents from two places meet, in the plane of the places and the origin. The tangents touch
/// a ball about the origin whose radius is the distance of the nearer place. Empty if the straight path is clear of
/// that ball. `None`: the angle is too large.
fn tangent_corner(here: Vector3<f64>, there: Vector3<f64>) -> Option<Vec<Vector3<f64>>> {
    let radius = here.norm().min(there.norm());
    let (u, v) = (unit_vector(here)?, unit_vector(there)?);
    let to_tangent = |from: Vector3<f64>| (radius / from.norm()).min(1.0).acos();
    let left = u.angle(&v) - to_tangent(here) - to_tangent(there);
    if left <= 0.0 {
        return Some(Vec::new());
    }
    let turn = Rotation3::from_axis_angle(&Unit::try_new(u.cross(&v), 0.0)?, to_tangent(here) + left / 2.0);
    (left <= MAX_ANGLE_BETWEEN_TANGENT_POINTS_RAD).then(|| vec![turn * u * (radius / (left / 2.0).cos())])
}

impl Surroundings {
    /// The ball of the artefact with the smallest gap to the stylus ball at this position.
    fn nearest_ball(&self, at: &Position) -> Option<ArtefactBall> {
        let ball = |obstacle: &Obstacle| match obstacle.body {
            ObstacleBody::BallOrCylinder(BodyShape::Ball { centre, radius }) if obstacle.is_artefact_part => {
                let (name, max_misplacement_mm) = (obstacle.name.clone(), obstacle.max_misplacement_mm);
                let contact_distance_mm = radius + self.stylus_ball_radius_mm;
                Some(ArtefactBall { name, centre, contact_distance_mm, max_misplacement_mm })
            }
            _ => None,
        };
        let gap =
            |ball: &ArtefactBall| self.tip_offset_in_machine_directions(ball, at).norm() - ball.contact_distance_mm;
        let balls = self.obstacles.iter().filter_map(ball);
        balls.min_by(|one, other| gap(one).total_cmp(&gap(other)))
    }

    /// Vector from the centre of a ball to the stylus ball's centre, machine directions.
    fn tip_offset_in_machine_directions(&self, ball: &ArtefactBall, at: &Position) -> Vector3<f64> {
        let table = self.chain.machine_from_table(at, &[]).rotation;
        table * (self.chain.tip_in_table(at, self.tip, &[]).mm - ball.centre)
    }
}
