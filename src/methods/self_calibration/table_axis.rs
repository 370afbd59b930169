//! The rotary axis that is measured, and the frame in which its readings are reduced: the machine frame,
//! linear axes that carry the workpiece at zero. Rays go through the stated axis.

use nalgebra::Vector3;

use super::settings::{Settings, UPRIGHT};
use crate::Refused;
use machine::frame::{Point, Pose, Spindle, Table};
use machine::kinematics::{AxisLine, Chain, KinematicsError};
use machine::record::artefact::Cylinder;
use machine::record::machine::AxisSpec;
use machine::record::plan::{Plan, Step};
use machine::record::reading::Reading;
use machine::{Axis, Position};

pub struct TableAxis {
    pub axis: Axis,
    pub spec: AxisSpec,
    /// 1 where a positive command turns the table clockwise seen from +Z, otherwise −1.
    pub sense: f64,
    /// All rotary axes but S as the cycle commands them, this one at zero.
    pub still: Position,
    line: AxisLine,
    chain: Chain,
    tip: Point<Spindle>,
    /// Of the table while all stands `still`.
    table: Pose,
}

impl TableAxis {
    /// # Errors
    /// A machine without such an axis, or whose axis does not stand along the spindle.
    pub fn new(plan: &Plan, _settings: &Settings) -> Result<Self, Refused> {
        let chain = Chain::new(&plan.machine)?;
        let turning =
            plan.machine.axes.keys().filter(|axis| !axis.is_linear() && **axis != Axis::S);
        let still: Position = turning.map(|axis| (*axis, 0.0)).collect();
        let carries = chain.topology().workpiece().contains(&Axis::C);
        let spec = plan.machine.axes.get(&Axis::C).filter(|_| carries);
        let (Some(spec), Some(line)) = (spec, chain.axis_line(Axis::C, &still)) else {
            return Err(Refused {
                why: "this method needs a rotary axis C that carries the workpiece".to_owned(),
                instead: "state C on the workpiece side of the topology (w-C-…) and as [axes.C]"
                    .to_owned(),
            });
        };
        if line.direction.z.abs() < UPRIGHT {
            return Err(Refused {
                why: "the axis C does not stand along Z".to_owned(),
                instead: "correct direction in [axes.C]".to_owned(),
            });
        }
        Ok(Self {
            axis: Axis::C,
            spec: spec.clone(),
            sense: spec.positive.sign() * line.direction.z.signum(),
            table: chain.machine_from_table(&still, &[]),
            tip: Point::from_vec(Vector3::from(plan.machine.tool_mm)),
            still,
            line,
            chain,
        })
    }

    /// The point of the stated axis at the height `z`.
    pub fn at_height(&self, z: f64) -> Vector3<f64> {
        let AxisLine { point, direction, .. } = self.line;
        let along = (z - point.z) / direction.z;
        Vector3::new(point.x + along * direction.x, point.y + along * direction.y, z)
    }

    /// `point_mm` of the axis if it stands off the stated one by `off`.
    pub fn point_mm(&self, off: Vector3<f64>) -> Vector3<f64> {
        Vector3::from(self.spec.point_mm) + self.line.carrier.rotation.inverse() * off
    }

    /// X, Y, Z that bring the ball's centre to `centre`; `orientation` names S where the spindle turns.
    pub fn linear_axes_for(
        &self,
        centre: Vector3<f64>,
        orientation: &Position,
    ) -> Result<Position, KinematicsError> {
        let target = self.table.inverse_transform_point(&centre.into()).coords;
        let target = Point::<Table>::from_vec(target);
        let others = self.still.updated_by(orientation);
        let linear = self.chain.linear_axes_for(target, self.tip, &others, &[])?;
        Ok(linear.only(Axis::is_linear))
    }

    /// Ball centre of a reading as if the axis stood at zero, mm: what the linear axes alone say.
    pub fn ball_centre(&self, step: &Step, reading: &Reading) -> Vector3<f64> {
        let position = step.from.updated_by(&reading.position);
        let position = position.updated_by(&Position::new().with(self.axis, 0.0));
        let on_table = self.chain.tip_in_table(&position, self.tip, &[]).mm;
        self.table.transform_point(&on_table.into()).coords
    }

    /// A part of the table frame, where it stands.
    pub fn standing(&self, part: &Cylinder) -> Cylinder {
        moved(part, &self.table)
    }

    /// The same part in the table frame.
    pub fn on_table(&self, standing: &Cylinder) -> Cylinder {
        moved(standing, &self.table.inverse())
    }
}

fn moved(part: &Cylinder, by: &Pose) -> Cylinder {
    Cylinder {
        centre_mm: by.transform_point(&part.centre_mm.into()).into(),
        axis: (by.rotation * Vector3::from(part.axis)).into(),
        ..part.clone()
    }
}
