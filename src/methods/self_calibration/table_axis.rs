//! The measured rotary axis, and the frame in which its readings are reduced: the machine frame with the linear
//! axes that carry the workpiece at zero. The rays pass through the stated axis.

use nalgebra::Vector3;

use super::settings::{Settings, UPRIGHT};
use crate::Refused;
use crate::identification::KnownMotions;
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
    /// 1 if a positive command turns the table clockwise seen from +Z, otherwise −1.
    pub sense: f64,
    /// Positions of all rotary axes except S during the cycle, with the measured axis at zero.
    pub still: Position,
    line: AxisLine,
    chain: Chain,
    tip: Point<Spindle>,
    /// Pose of the table with all rotary axes at `still`.
    table: Pose,
}

impl TableAxis {
    /// # Errors
    /// No axis of the table is along Z at the configured positions, or a position is not possible on this machine.
    pub fn new(plan: &Plan, settings: &Settings) -> Result<Self, Refused> {
        let chain = Chain::new(&plan.machine)?;
        let still = still(plan, &settings.at)?;
        // The search starts with the axis next to the workpiece.
        let mut carriers = chain.topology().workpiece().iter().rev().copied();
        let found = carriers.find_map(|axis| {
            let line = chain.axis_line(axis, &still).filter(is_upright)?;
            let spec = plan.machine.axes.get(&axis)?;
            settings.at.get(axis).is_none().then_some((axis, line, spec))
        });
        let Some((axis, line, spec)) = found else {
            return Err(none_upright(plan, &chain, &still));
        };
        let spindle = chain.machine_from_spindle(&still, &[]).rotation * Vector3::z();
        if spindle.z < UPRIGHT {
            return Err(Refused {
                why: format!("the spindle is not along Z with {}", in_words(&still, axis)),
                instead: "correct at in [method.self-calibration]".to_owned(),
            });
        }
        Ok(Self {
            axis,
            spec: spec.clone(),
            sense: spec.positive.sign() * line.direction.z.signum(),
            table: chain.machine_from_table(&still, &[]),
            tip: Point::from_vec(Vector3::from(plan.machine.tool_mm)),
            still,
            line,
            chain,
        })
    }

    /// The other rotary axes that are not at 0, such as `A at 90°`. Empty if all are at 0.
    pub fn others_in_words(&self) -> String {
        in_words(&self.still.only(|axis| self.still.at(axis) != 0.0), self.axis)
    }

    /// Point of the stated axis at the height `z`.
    pub fn at_height(&self, z: f64) -> Vector3<f64> {
        let AxisLine { point, direction, .. } = self.line;
        let along = (z - point.z) / direction.z;
        Vector3::new(point.x + along * direction.x, point.y + along * direction.y, z)
    }

    /// `point_mm` of an axis that is displaced from the stated one by `off`.
    pub fn point_mm(&self, off: Vector3<f64>) -> Vector3<f64> {
        Vector3::from(self.spec.point_mm) + self.line.carrier.rotation.inverse() * off
    }

    /// Positions X, Y, Z at which the ball's centre is at `centre`. `orientation` contains S if the spindle turns.
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

    /// Ball centre of a reading by the linear axes alone, with the measured axis at zero, mm.
    pub fn ball_centre(&self, step: &Step, reading: &Reading) -> Vector3<f64> {
        let position = step.from.updated_by(&reading.position);
        let position = position.updated_by(&Position::new().with(self.axis, 0.0));
        let on_table = self.chain.tip_in_table(&position, self.tip, &[]).mm;
        self.table.transform_point(&on_table.into()).coords
    }

    /// The ball centre without the displacement of the table by the `known` error motions of this axis.
    pub fn corrected_ball_centre(
        &self,
        step: &Step,
        reading: &Reading,
        known: &KnownMotions<'_>,
    ) -> Vector3<f64> {
        if known.is_empty() {
            return self.ball_centre(step, reading);
        }
        let position = step.from.updated_by(&reading.position);
        let angle = position.at(self.axis);
        let on_table = self.chain.tip_in_table(&position, self.tip, &known.errors(angle)).mm;
        let turned = self.still.clone().with(self.axis, angle);
        self.chain.machine_from_table(&turned, &[]).transform_point(&on_table.into()).coords
    }

    /// Derivative of the radius of a touch by the error motion of this axis along or about `component`, if this
    /// motion is subtracted: mm per mm or rad. `centre`: centre of the ball. `normal`: outward unit vector, machine
    /// frame.
    pub fn radius_by_motion(
        &self,
        component: Axis,
        centre: Vector3<f64>,
        normal: Vector3<f64>,
    ) -> f64 {
        let along = self.line.carrier.rotation * component.direction();
        match component.is_linear() {
            true => -normal.dot(&along),
            false => -normal.dot(&along.cross(&(centre - self.line.point))),
        }
    }

    /// Converts a part from the table frame to the machine frame.
    pub fn standing(&self, part: &Cylinder) -> Cylinder {
        moved(part, &self.table)
    }

    /// Converts a part from the machine frame to the table frame.
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

/// Positions of all rotary axes except S: as configured, otherwise zero.
fn still(plan: &Plan, at: &Position) -> Result<Position, Refused> {
    let turns = |axis: Axis| !axis.is_linear() && axis != Axis::S;
    for (axis, value) in at.iter() {
        let spec = plan.machine.axes.get(&axis).filter(|_| turns(axis));
        let degrees = axis.to_edge(value);
        if !spec.is_some_and(|spec| (spec.min..=spec.max).contains(&degrees)) {
            return Err(Refused {
                why: format!("at names {axis} = {degrees}, which this machine's rotary axes cannot have"),
                instead: "name in at of [method.self-calibration] rotary axes of [axes], within their limits"
                    .to_owned(),
            });
        }
    }
    let axes = plan.machine.axes.keys().copied().filter(|axis| turns(*axis));
    Ok(axes.map(|axis| (axis, at.at(axis))).collect())
}

fn is_upright(line: &AxisLine) -> bool {
    line.direction.z.abs() >= UPRIGHT
}

fn none_upright(plan: &Plan, chain: &Chain, still: &Position) -> Refused {
    let carriers = chain.topology().workpiece();
    if carriers.iter().all(|axis| axis.is_linear()) {
        return Refused {
            why: "this method needs a rotary axis that carries the workpiece".to_owned(),
            instead: "state it on the workpiece side of the topology (w-C-…) and as [axes.C]"
                .to_owned(),
        };
    }
    let upright = |other: Axis, degrees: f64| {
        let at = still.clone().with(other, other.from_edge(degrees));
        let mut turned = carriers.iter().filter(|axis| **axis != other);
        let reached = plan.machine.axes.get(&other);
        reached.is_some_and(|spec| (spec.min..=spec.max).contains(&degrees))
            && turned.any(|axis| chain.axis_line(*axis, &at).as_ref().is_some_and(is_upright))
    };
    let places = still.iter().flat_map(|(other, _)| [90.0, -90.0].map(|degrees| (other, degrees)));
    let place = places.into_iter().find(|(other, degrees)| upright(*other, *degrees));
    let example = place.map_or(String::new(), |(other, degrees)| {
        format!(", for example at = {{ {other} = {degrees:.1} }}")
    });
    Refused {
        why: format!(
            "no rotary axis that carries the workpiece is along Z with {}",
            in_words(still, Axis::S)
        ),
        instead: format!(
            "state in [method.self-calibration] where the others are when one is{example}; or correct \
             direction in [axes]"
        ),
    }
}

/// Text such as `A at 90°, B at 0°`, without the axis `except`.
fn in_words(position: &Position, except: Axis) -> String {
    let others = position.iter().filter(|(axis, _)| *axis != except);
    let words = others.map(|(axis, value)| format!("{axis} at {}°", axis.to_edge(value)));
    words.collect::<Vec<_>>().join(", ")
}
