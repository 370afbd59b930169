//! The ball plate on the rotary table: the axis of the table, and the positions of the balls about that axis.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::settings::BallPlateSettings;
use crate::MethodRefusal;
use crate::ball_measurement::require_balls;
use machine::kinematics::{KinematicChain, ZParallelTableAxis};
use machine::record::artefact::Balls;
use machine::record::plan::Plan;
use machine::{Axis, Position};

/// Maximum distance of a stated ball centre from its measuring position, mm, to which the position uncertainty of the
/// artefact is added; beyond it the artefact is refused. Within this distance the deviations of the linear axes count
/// as equal (paper 5, section 2.2).
pub const MAX_BALL_OFFSET_FROM_MEASURING_POSITION_MM: f64 = 1.0;
/// Minimum radius of the circle, mm: a smaller circle does not determine tilt sufficiently.
const MIN_CIRCLE_RADIUS_MM: f64 = 10.0;

/// The ball plate on the rotary table.
pub struct Plate<'a> {
    pub balls: &'a Balls,
    /// The axis that turns the plate.
    pub rotary_axis: Axis,
    /// Positions of the rotary axes, all at zero; the entry of `rotary_axis` is replaced at each stop.
    pub rotary_positions_at_zero: Position,
    /// A point on the axis at the height of `point_mm`, table frame, mm.
    pub axis_point_mm: Vector3<f64>,
    /// Sense of rotation: +1 if a rising command turns the table right-handed about +Z.
    pub turn_sign: f64,
    /// Mean distance of the stated ball centres from the axis, mm.
    pub circle_radius_mm: f64,
    /// Unit vector from the axis to each ball, in XY of the table frame.
    pub radial_directions: Vec<Vector3<f64>>,
    /// Position of each ball in steps of 360°/M, counted from the first ball, counter-clockwise.
    pub ball_steps: Vec<usize>,
}

impl<'a> Plate<'a> {
    /// # Errors
    /// The machine has no rotary table along Z, or the balls are not on one circle at multiples of 360°/M, where M is
    /// the number of stops per revolution.
    pub fn new(plan: &'a Plan, settings: &BallPlateSettings) -> Result<Self, MethodRefusal> {
        let set = require_balls(super::METHOD_NAME, &plan.artefact)?;
        let chain = KinematicChain::new(&plan.machine)?;
        let table =
            ZParallelTableAxis::of_machine(&plan.machine, &chain).ok_or_else(MethodRefusal::missing_rotary_table)?;
        let ZParallelTableAxis { axis, position_with_rotary_axes_at_zero: still, turn_sign: turn } = table;
        let line = chain.axis_line(axis, &still).ok_or_else(MethodRefusal::missing_rotary_table)?;
        let to_table = chain.machine_from_table(&still, &[]).inverse();
        let point = to_table.transform_point(&line.point.into()).coords;
        let seen = set.balls.iter().map(|ball| Vector3::from(ball.centre_mm) - point);
        let radial: Vec<Vector3<f64>> = seen.map(|from_axis| from_axis.xy().push(0.0)).collect();
        let radius_mm = radial.iter().map(|r| r.norm()).sum::<f64>() / radial.len() as f64;
        let plate = Self {
            balls: set,
            rotary_axis: axis,
            rotary_positions_at_zero: still,
            axis_point_mm: point,
            turn_sign: turn,
            circle_radius_mm: radius_mm,
            ball_steps: nearest_position_steps(&radial, settings.positions),
            radial_directions: radial.iter().map(|r| r / r.norm().max(f64::MIN_POSITIVE)).collect(),
        };
        plate.check_ball_positions(settings)?;
        Ok(plate)
    }

    /// Checks that the balls are on one circle, at one height, each on its step.
    fn check_ball_positions(&self, settings: &BallPlateSettings) -> Result<(), MethodRefusal> {
        if self.circle_radius_mm < MIN_CIRCLE_RADIUS_MM {
            let Self { circle_radius_mm: radius_mm, rotary_axis: axis, .. } = self;
            return Err(MethodRefusal::new(
                format!("the circle of the balls has a radius of {radius_mm:.1} mm about the axis {axis}"),
                format!("centre the plate on the axis, and choose a radius of at least {MIN_CIRCLE_RADIUS_MM} mm"),
            ));
        }
        let first = self.radial_directions.first().copied().unwrap_or_default();
        let height = self.balls.balls.first().map_or(0.0, |ball| ball.centre_mm[2]);
        let limit = MAX_BALL_OFFSET_FROM_MEASURING_POSITION_MM + self.balls.uncertainty_mm;
        for (ball, step) in self.balls.balls.iter().zip(&self.ball_steps) {
            let angle = TAU * *step as f64 / settings.positions as f64;
            let turned = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), angle) * first;
            let nominal = self.axis_point_mm.xy().push(height) + turned * self.circle_radius_mm;
            let off = Vector3::from(ball.centre_mm) - nominal;
            if off.norm() > limit {
                return Err(MethodRefusal {
                    reason: format!(
                        "ball {} is {:.2} mm from its required position: the balls must be on one circle at \
                        one height, at multiples of 360°/{} from the first ball, within {limit:.1} mm",
                        ball.id,
                        off.norm(),
                        settings.positions
                    ),
                    remedy: format!(
                        "correct centre_mm of the ball (required: {:.2}, {:.2}, {:.2}), or choose another \
                        number of positions",
                        nominal.x, nominal.y, nominal.z
                    ),
                });
            }
        }
        Ok(())
    }

    /// Mean height of the balls above `point_mm` of the axis, mm.
    pub fn mean_ball_height_mm(&self) -> f64 {
        let heights = self.balls.balls.iter().map(|ball| ball.centre_mm[2] - self.axis_point_mm.z);
        heights.sum::<f64>() / self.balls.balls.len().max(1) as f64
    }

    /// Index of the measuring position of a ball at the stop `number` steps from zero. Measuring positions are counted
    /// in steps of 360°/M from the position of the first ball at table zero.
    pub fn measuring_position_index(&self, ball: usize, number: i64, positions: usize) -> usize {
        let turned = if self.turn_sign > 0.0 { number } else { -number };
        let step = self.ball_steps.get(ball).copied().unwrap_or(0) as i64;
        (step + turned).rem_euclid(positions as i64) as usize
    }
}

/// For each ball the nearest multiple of 360°/M, as a step number, counted from the first ball.
fn nearest_position_steps(radial: &[Vector3<f64>], positions: usize) -> Vec<usize> {
    let azimuth = |r: &Vector3<f64>| r.y.atan2(r.x);
    let first = radial.first().map_or(0.0, azimuth);
    let step = |r: &Vector3<f64>| {
        let turns = (azimuth(r) - first).rem_euclid(TAU) / TAU;
        (turns * positions as f64).round() as usize % positions.max(1)
    };
    radial.iter().map(step).collect()
}
