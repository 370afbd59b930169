//! The measured rotary axis, and the frame in which its readings are reduced: the machine frame with the linear
//! axes that carry the workpiece at zero. The rays pass through the stated axis.

use nalgebra::Vector3;

use super::settings::{MIN_COSINE_TO_MACHINE_Z, SelfCalibrationSettings};
use crate::MethodRefusal;
use crate::identification::KnownErrorMotions;
use machine::frame::{Point, Pose, SpindleFrame, TableFrame};
use machine::kinematics::{AxisLine, KinematicChain, KinematicsError};
use machine::record::artefact::Cylinder;
use machine::record::machine::StatedAxis;
use machine::record::plan::{Plan, Step};
use machine::record::reading::Reading;
use machine::{Axis, Position};

/// The measured axis: of the rotary axes that carry the workpiece and are along Z at the configured positions, the one
/// next to the workpiece; an axis that the setting `at` positions is excluded. With the geometry for its touches.
pub struct MeasuredTableAxis {
    pub axis: Axis,
    /// The entry of this axis in the machine file.
    pub stated_axis: StatedAxis,
    /// 1 if a positive command turns the table clockwise seen from +Z, otherwise −1.
    pub clockwise_sign: f64,
    /// Positions of all rotary axes except S in the measurement, with the measured axis at zero.
    pub rotary_position_with_axis_at_zero: Position,
    /// Line of the stated axis, machine frame.
    line: AxisLine,
    chain: KinematicChain,
    /// Stated centre of the stylus ball.
    stylus_tip: Point<SpindleFrame>,
    /// Pose of the table with all rotary axes at `rotary_position_with_axis_at_zero`.
    table_pose: Pose,
}

impl MeasuredTableAxis {
    /// # Errors
    /// No axis of the table is along Z at the configured positions, the spindle is not along Z, or a position is not
    /// possible on this machine.
    pub fn new(plan: &Plan, settings: &SelfCalibrationSettings) -> Result<Self, MethodRefusal> {
        let chain = KinematicChain::new(&plan.machine)?;
        let still = configured_rotary_position(plan, &settings.other_rotary_positions)?;
        // The search starts with the axis next to the workpiece.
        let mut carriers = chain.topology().workpiece_branch().iter().rev().copied();
        let found = carriers.find_map(|axis| {
            let line = chain.axis_line(axis, &still).filter(is_parallel_to_machine_z)?;
            let spec = plan.machine.axes.get(&axis)?;
            settings.other_rotary_positions.get(axis).is_none().then_some((axis, line, spec))
        });
        let Some((axis, line, spec)) = found else {
            return Err(no_axis_along_z_refusal(plan, &chain, &still));
        };
        let spindle = chain.machine_from_spindle(&still, &[]).rotation * Vector3::z();
        MethodRefusal::require(
            spindle.z >= MIN_COSINE_TO_MACHINE_Z,
            format!("the spindle is not along Z with {}", describe_positions(&still, axis)),
            "correct `at` in [method.self-calibration]",
        )?;
        Ok(Self {
            axis,
            stated_axis: spec.clone(),
            clockwise_sign: spec.positive.direction_sign() * line.direction.z.signum(),
            table_pose: chain.machine_from_table(&still, &[]),
            stylus_tip: Point::from_vec(Vector3::from(plan.machine.tool_mm)),
            rotary_position_with_axis_at_zero: still,
            line,
            chain,
        })
    }

    /// Text of the rotary axes, except the measured axis, that are not at 0, such as `A at 90°`. Empty if all are at 0.
    pub fn describe_other_nonzero_axes(&self) -> String {
        describe_positions(
            &self
                .rotary_position_with_axis_at_zero
                .filter_axes(|axis| self.rotary_position_with_axis_at_zero.get_or_zero(axis) != 0.0),
            self.axis,
        )
    }

    /// Point of the stated axis at the height `z`, machine frame, mm.
    pub fn axis_point_at_height(&self, z: f64) -> Vector3<f64> {
        let AxisLine { point, direction, .. } = self.line;
        let along = (z - point.z) / direction.z;
        Vector3::new(point.x + along * direction.x, point.y + along * direction.y, z)
    }

    /// `point_mm` in the machine file of an axis that is displaced from the stated one by `off` (machine frame, mm).
    pub fn displaced_axis_point_mm(&self, off: Vector3<f64>) -> Vector3<f64> {
        Vector3::from(self.stated_axis.point_mm) + self.line.carrier_pose.rotation.inverse() * off
    }

    /// Positions X, Y, Z at which the ball's centre is at `centre` (machine frame). `spindle_position` must contain S
    /// if the spindle turns.
    pub fn solve_linear_axes(
        &self,
        centre: Vector3<f64>,
        spindle_position: &Position,
    ) -> Result<Position, KinematicsError> {
        let target = self.table_pose.inverse_transform_point(&centre.into()).coords;
        let target = Point::<TableFrame>::from_vec(target);
        let others = self.rotary_position_with_axis_at_zero.updated_by(spindle_position);
        let linear = self.chain.solve_linear_axes(target, self.stylus_tip, &others, &[])?;
        Ok(linear.filter_axes(Axis::is_linear))
    }

    /// Ball centre of a reading by the linear axes alone, with the measured axis at zero, machine frame, mm.
    pub fn ball_centre(&self, step: &Step, reading: &Reading) -> Vector3<f64> {
        let position = step.from.updated_by(&reading.position);
        let position = position.updated_by(&Position::new().with(self.axis, 0.0));
        let on_table = self.chain.tip_in_table(&position, self.stylus_tip, &[]).mm;
        self.table_pose.transform_point(&on_table.into()).coords
    }

    /// The ball centre, machine frame, mm, without the displacement of the table by the `known_motions` of this axis.
    pub fn corrected_ball_centre(
        &self,
        step: &Step,
        reading: &Reading,
        known_motions: &KnownErrorMotions<'_>,
    ) -> Vector3<f64> {
        if known_motions.is_empty() {
            return self.ball_centre(step, reading);
        }
        let position = step.from.updated_by(&reading.position);
        let angle = position.get_or_zero(self.axis);
        let on_table = self.chain.tip_in_table(&position, self.stylus_tip, &known_motions.error_terms_at(angle)).mm;
        let turned = self.rotary_position_with_axis_at_zero.clone().with(self.axis, angle);
        self.chain.machine_from_table(&turned, &[]).transform_point(&on_table.into()).coords
    }

    /// Derivative of the radius of a touch by the error motion of this axis along or about `component`, if this
    /// motion is subtracted: mm per mm or rad. `centre`: centre of the ball, and `normal`: outward unit vector,
    /// both in the machine frame.
    pub fn radius_derivative_by_motion(&self, component: Axis, centre: Vector3<f64>, normal: Vector3<f64>) -> f64 {
        let along = self.line.carrier_pose.rotation * component.nominal_direction();
        match component.is_linear() {
            true => -normal.dot(&along),
            false => -normal.dot(&along.cross(&(centre - self.line.point))),
        }
    }

    /// Converts a part from the table frame to the machine frame, with the measured axis at zero.
    pub fn part_in_machine_frame(&self, part: &Cylinder) -> Cylinder {
        transform_part(part, &self.table_pose)
    }

    /// Converts a part from the machine frame, with the measured axis at zero, to the table frame.
    pub fn part_in_table_frame(&self, standing: &Cylinder) -> Cylinder {
        transform_part(standing, &self.table_pose.inverse())
    }
}

fn transform_part(part: &Cylinder, by: &Pose) -> Cylinder {
    Cylinder {
        foot_mm: by.transform_point(&part.foot_mm.into()).into(),
        axis: (by.rotation * Vector3::from(part.axis)).into(),
        ..part.clone()
    }
}

/// Positions of all rotary axes except S: as configured, otherwise zero. Error: `at` contains a linear axis, S, an axis
/// that the machine does not have, or a position outside the limits.
fn configured_rotary_position(plan: &Plan, at: &Position) -> Result<Position, MethodRefusal> {
    let turns = |axis: Axis| !axis.is_linear() && axis != Axis::S;
    for (axis, value) in at.iter() {
        let spec = plan.machine.axes.get(&axis).filter(|_| turns(axis));
        let degrees = axis.to_mm_or_deg(value);
        MethodRefusal::require(
            spec.is_some_and(|spec| (spec.min..=spec.max).contains(&degrees)),
            format!(
                "`at` contains {axis} = {degrees}, which is not a rotary axis of this machine or is \
                outside its limits"
            ),
            "give in `at` of [method.self-calibration] only rotary axes of [axes], within their limits",
        )?;
    }
    let axes = plan.machine.axes.keys().copied().filter(|axis| turns(*axis));
    Ok(axes.map(|axis| (axis, at.get_or_zero(axis))).collect())
}

/// Whether the line is within one degree of Z, in either direction.
fn is_parallel_to_machine_z(line: &AxisLine) -> bool {
    line.direction.z.abs() >= MIN_COSINE_TO_MACHINE_Z
}

fn no_axis_along_z_refusal(plan: &Plan, chain: &KinematicChain, still: &Position) -> MethodRefusal {
    let carriers = chain.topology().workpiece_branch();
    if carriers.iter().all(|axis| axis.is_linear()) {
        return MethodRefusal::new(
            "this method requires a rotary axis that carries the workpiece",
            "add the axis on the workpiece side of the topology (w-C-…) and as [axes.C] in the machine file",
        );
    }
    let is_axis_along_z = |other: Axis, degrees: f64| {
        let at = still.clone().with(other, other.to_mm_or_rad(degrees));
        let mut turned = carriers.iter().filter(|axis| **axis != other);
        let reached = plan.machine.axes.get(&other);
        reached.is_some_and(|spec| (spec.min..=spec.max).contains(&degrees))
            && turned.any(|axis| chain.axis_line(*axis, &at).as_ref().is_some_and(is_parallel_to_machine_z))
    };
    let places = still.iter().flat_map(|(other, _)| [90.0, -90.0].map(|degrees| (other, degrees)));
    let place = places.into_iter().find(|(other, degrees)| is_axis_along_z(*other, *degrees));
    let example =
        place.map_or(String::new(), |(other, degrees)| format!(", for example at = {{ {other} = {degrees:.1} }}"));
    MethodRefusal::new(
        format!("no rotary axis that carries the workpiece is along Z with {}", describe_positions(still, Axis::S)),
        format!(
            "set `at` in [method.self-calibration] to positions of the other axes at which one axis is \
            along Z{example}; or correct direction in [axes]"
        ),
    )
}

/// Text such as `A at 90°, B at 0°`, without the axis `except`.
fn describe_positions(position: &Position, except: Axis) -> String {
    let others = position.iter().filter(|(axis, _)| *axis != except);
    let parts = others.map(|(axis, value)| format!("{axis} at {}°", axis.to_mm_or_deg(value)));
    parts.collect::<Vec<_>>().join(", ")
}
