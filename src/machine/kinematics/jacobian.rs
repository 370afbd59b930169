//! Analytic Jacobian of the tip on the table with respect to the error parameters.

use nalgebra::Vector3;

use super::chain::Chain;
use super::joint::{COMPONENTS, Joint};
use super::parameter::{ErrorParameter, ErrorTerm, Shape};
use crate::Position;
use crate::frame::{Point, Pose, Spindle};

impl Chain {
    /// ∂p_w/∂θ for each of `parameters`, in their order, exact at `errors`: mm per mm, per rad or
    /// per mm/mm, in the table frame. Zero for an axis that the machine does not have.
    ///
    /// ∂p_w/∂θ_k = ±φ·R_wᵀ·(Ad_prefix e_k)(p_F): + in the tool branch, − in the workpiece branch;
    /// p_F is the tip in the machine frame, R_w the table's rotation.
    pub fn jacobian(
        &self,
        position: &Position,
        tip: Point<Spindle>,
        errors: &[ErrorTerm],
        parameters: &[ErrorParameter],
    ) -> Vec<Vector3<f64>> {
        let workpiece = placed(&self.workpiece, position, errors);
        let tool = placed(&self.tool, position, errors);
        let tip = tool.1.transform_point(&tip.mm.into()).coords;
        let into_table = workpiece.1.rotation.inverse();
        let mut columns = vec![Vector3::zeros(); parameters.len()];
        for (branch, side) in [(&workpiece.0, -1.0), (&tool.0, 1.0)] {
            for placed in branch {
                for (column, parameter) in columns.iter_mut().zip(parameters) {
                    if parameter.axis() == placed.joint.axis() {
                        let velocity = velocity(placed, *parameter, position, errors, tip);
                        *column = into_table * velocity * side;
                    }
                }
            }
        }
        columns
    }
}

/// A joint at its position: the pose of its carrier, and the same pose with the location errors of the joint.
struct Placed<'a> {
    joint: &'a Joint,
    prefix: Pose,
    before: Pose,
}

/// All joints of a branch, and the pose of its end.
fn placed<'a>(
    branch: &'a [Joint],
    position: &Position,
    errors: &[ErrorTerm],
) -> (Vec<Placed<'a>>, Pose) {
    let mut prefix = Pose::identity();
    let place = |joint: &'a Joint| {
        let before = prefix * joint.before(position, errors);
        let placed = Placed { joint, prefix, before };
        prefix = before * joint.after(position, errors);
        placed
    };
    (branch.iter().map(place).collect(), prefix)
}

/// Velocity of the point `tip` (machine frame) per unit of `parameter` of `joint`.
fn velocity(
    Placed { joint, prefix, before }: &Placed<'_>,
    parameter: ErrorParameter,
    position: &Position,
    errors: &[ErrorTerm],
    tip: Vector3<f64>,
) -> Vector3<f64> {
    let factor = parameter.factor(position.at(joint.axis()));
    let generator = parameter.component().direction();
    if parameter.shape() == Shape::Gain {
        return before.transform_vector(&generator) * joint.sign() * factor;
    }
    let at = COMPONENTS
        .into_iter()
        .take_while(|component| *component != parameter.component())
        .fold(*prefix, |outer, component| outer * joint.error_motion(component, position, errors));
    let direction = at.transform_vector(&generator);
    if parameter.component().is_linear() {
        direction * factor
    } else {
        direction.cross(&(tip - at.transform_point(&joint.point().into()).coords)) * factor
    }
}
