//! The body that a touch meets, the length of the touch, and the bodies that may come near.
//!
//! The true position of the body is unknown within its uncertainty, and contact occurs at the *true* position. An
//! offset of the body along the touch shifts contact and all parts that move with the stylus ball alike; an offset
//! across the touch does not.
//! Therefore stem, probe body and all other parts on the spindle are checked as far as the ball gets when that body
//! is offset across the touch in any direction. They are checked against the body (and its stem, which moves with
//! it) enlarged across the touch. Against everything else, including the other balls of an artefact, the touch is
//! checked over its full length.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::body::{CollisionBody, CollisionShape};
use super::body_gap::LateralMisplacement;
use super::collision_scene::CollisionScene;
use super::refusal::RefusalReason;
use super::sweep::JointPath;
use machine::frame::{Pose, perpendicular_directions, unit_vector};
use machine::kinematics::AxisCommands;

/// Maximum distance between contact and trigger, mm.
const MAX_PRE_TRAVEL_MM: f64 = 0.1;
/// Number of directions across the touch in which the artefact is shifted.
const LATERAL_SHIFT_DIRECTION_COUNT: u32 = 8;
/// Number of bisections of the path when the contact is searched.
const BISECTION_STEP_COUNT: u32 = 40;
/// Maximum angle between the expected contact with a ball and the normal of the step, degrees.
const MAX_CONTACT_ANGLE_ERROR_DEG: f64 = 25.0;
/// Rounding tolerance of the text, mm.
const TEXT_ROUNDING_TOLERANCE_MM: f64 = 2e-3;

/// Part of a touch up to the farthest point that the stylus ball can reach before contact stops it.
pub struct TouchReach {
    /// Number of the touched body, as in `BodyRole::Touchable`.
    pub touched_body_number: usize,
    /// From the start of the touch; includes pre-travel and braking distance, but not more than the whole touch.
    pub joint_path: JointPath,
    pub lateral_misplacement: LateralMisplacement,
}

/// Straight path of the stylus ball's centre in the frame of the artefact, mm: only linear axes move, whether or not
/// they carry the table.
struct StylusBallLine {
    /// Pose of the table in the machine frame at the start of the touch.
    table_pose_at_start: Pose,
    from: Vector3<f64>,
    to: Vector3<f64>,
    unit_direction: Vector3<f64>,
    stylus_ball_radius_mm: f64,
}

/// Finds the body that the ball meets first when all bodies are at their assumed positions: this is the touched
/// body. `braking`: braking distance from the touch's feed, mm; `normal`: of the surface at the expected contact,
/// machine frame.
///
/// # Errors
/// The ball meets no body before the end of the path, or would miss a ball at some position within its uncertainty,
/// or meets it on another side than the step states.
pub fn find_touch_reach(
    scene: &CollisionScene,
    joint_path: &JointPath,
    braking: f64,
    normal: [f64; 3],
) -> Result<TouchReach, RefusalReason> {
    let line = StylusBallLine::new(scene, joint_path).ok_or(RefusalReason::TouchWithoutContact)?;
    let met = scene
        .touchable_bodies()
        .filter_map(|(number, body)| Some((number, body, line.contact_share(&body.shape, Vector3::zeros())?)));
    let (touched_body_number, body, at) =
        met.min_by(|a, b| a.2.total_cmp(&b.2)).ok_or(RefusalReason::TouchWithoutContact)?;
    if let Some(ball) = body.shape.ball_centre_and_radius() {
        line.check_touch_cannot_miss(body, ball.0, ball.1, scene.max_artefact_misplacement_mm)?;
        line.check_contact_side(body, ball.0, at, Vector3::from(normal))?;
    }
    let farthest = line.latest_contact_share(&body.shape, at, scene.max_artefact_misplacement_mm);
    let end = (farthest + (MAX_PRE_TRAVEL_MM + braking) / line.from.metric_distance(&line.to)).min(1.0);
    let stop = joint_path.commands_at_share(end);
    let lateral_misplacement = LateralMisplacement {
        perpendicular_to: line.table_pose_at_start.rotation * line.unit_direction,
        max_misplacement_mm: scene.max_artefact_misplacement_mm,
    };
    let joint_path = JointPath { from: joint_path.from, to: stop };
    Ok(TouchReach { touched_body_number, joint_path, lateral_misplacement })
}

impl StylusBallLine {
    /// `None`: no body can be touched, the scene has no stylus ball, or the path has no length.
    fn new(scene: &CollisionScene, joint_path: &JointPath) -> Option<Self> {
        let (_, artefact) = scene.touchable_bodies().next()?;
        let tip = scene.stylus_ball()?;
        let (centre, stylus_ball_radius_mm) = tip.shape.bounding_ball();
        let ball_at = |commands: &AxisCommands| {
            let table = artefact.carrier_chain.pose(commands);
            let tool = tip.carrier_chain.pose(commands);
            table.inverse_transform_point(&tool.transform_point(&centre.into())).coords
        };
        let (from, to) = (ball_at(&joint_path.from), ball_at(&joint_path.to));
        let unit_direction = unit_vector(to - from)?;
        let table_pose_at_start = artefact.carrier_chain.pose(&joint_path.from);
        Some(Self { table_pose_at_start, from, to, unit_direction, stylus_ball_radius_mm })
    }

    fn point_at(&self, share: f64) -> Vector3<f64> {
        self.from + share * (self.to - self.from)
    }

    /// Position of the ball, as a share of the path, at which it meets a shape that is displaced by `shift`.
    /// `None`: the ball is clear of the shape at the end of the path.
    fn contact_share(&self, shape: &CollisionShape, shift: Vector3<f64>) -> Option<f64> {
        first_contact_share(|share| shape.distance_to_point(self.point_at(share) - shift) - self.stylus_ball_radius_mm)
    }

    /// Latest contact, as a share of the path, with a shape that is displaced across the path by at most
    /// `uncertainty`; 1 if a displaced shape is not met. `undisplaced_share`: contact without displacement.
    fn latest_contact_share(&self, shape: &CollisionShape, undisplaced_share: f64, uncertainty: f64) -> f64 {
        let [right, up] = perpendicular_directions(self.unit_direction);
        // Contact is a convex function of the displacement: the corners of a polygon around the circle bound it.
        let corner = uncertainty / (TAU / f64::from(2 * LATERAL_SHIFT_DIRECTION_COUNT)).cos();
        (0..LATERAL_SHIFT_DIRECTION_COUNT).fold(undisplaced_share, |farthest, k| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(LATERAL_SHIFT_DIRECTION_COUNT)).sin_cos();
            let shifted = self.contact_share(shape, corner * (cos * right + sin * up));
            farthest.max(shifted.unwrap_or(1.0))
        })
    }

    /// Checks that the touch meets the ball at every possible position: all possible positions of its centre are
    /// within the round-ended rod that the touch sweeps.
    fn check_touch_cannot_miss(
        &self,
        body: &CollisionBody,
        centre: Vector3<f64>,
        radius: f64,
        uncertainty: f64,
    ) -> Result<(), RefusalReason> {
        let ahead = (centre - self.from).dot(&self.unit_direction).clamp(0.0, self.from.metric_distance(&self.to));
        let apart = centre.metric_distance(&(self.from + ahead * self.unit_direction));
        if apart <= radius + self.stylus_ball_radius_mm - uncertainty + TEXT_ROUNDING_TOLERANCE_MM {
            return Ok(());
        }
        Err(RefusalReason::TouchCanMiss { body: body.name.clone(), uncertainty })
    }

    /// Checks that contact with a ball is within [`MAX_CONTACT_ANGLE_ERROR_DEG`] of the normal of the step; a step
    /// without a normal is refused.
    fn check_contact_side(
        &self,
        body: &CollisionBody,
        centre: Vector3<f64>,
        contact_share: f64,
        normal: Vector3<f64>,
    ) -> Result<(), RefusalReason> {
        let expected = self.table_pose_at_start.rotation.inverse() * normal;
        let out = self.point_at(contact_share) - centre;
        // Without a normal, the value is NaN, and the touch is refused.
        let cos = out.dot(&expected) / (out.norm() * expected.norm());
        let off = cos.clamp(-1.0, 1.0).acos().to_degrees();
        if off <= MAX_CONTACT_ANGLE_ERROR_DEG {
            return Ok(());
        }
        Err(RefusalReason::WrongContactSide { body: body.name.clone(), off_deg: off })
    }
}

/// Share of the path at which a distance becomes zero; the distance is convex over the path and positive at its
/// beginning. `None` if it is positive at the end.
fn first_contact_share(free: impl Fn(f64) -> f64) -> Option<f64> {
    if free(1.0) > 0.0 {
        return None;
    }
    let (mut clear, mut met) = (0.0, 1.0);
    for _ in 0..BISECTION_STEP_COUNT {
        let middle = (clear + met) / 2.0;
        if free(middle) > 0.0 { clear = middle } else { met = middle }
    }
    Some(met)
}
