//! Analytic Jacobian of the tip on the table with respect to the error parameters.

use glam::{DAffine3, DVec3};

use super::chain::Chain;
use super::joint::{COMPONENTS, Joint, unit};
use super::parameter::{ErrorParameter, ErrorTerm, Shape};
use crate::base::{Point, Position, Spindle};

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
    ) -> Vec<DVec3> {
        let tip = self.machine_from_spindle(position, errors).transform_point3(tip.mm);
        let into_table = self.machine_from_table(position, errors).matrix3.transpose();
        let mut columns = vec![DVec3::ZERO; parameters.len()];
        for (branch, side) in [(&self.workpiece, -1.0), (&self.tool, 1.0)] {
            let mut prefix = DAffine3::IDENTITY;
            for joint in branch {
                for (column, parameter) in columns.iter_mut().zip(parameters) {
                    if parameter.axis() == joint.axis() {
                        let velocity = velocity(prefix, joint, *parameter, position, errors, tip);
                        *column = into_table * velocity * side;
                    }
                }
                prefix *= joint.motion(position, errors);
            }
        }
        columns
    }
}

/// Velocity of the point `tip` (machine frame) per unit of `parameter` of `joint`.
fn velocity(
    prefix: DAffine3,
    joint: &Joint,
    parameter: ErrorParameter,
    position: &Position,
    errors: &[ErrorTerm],
    tip: DVec3,
) -> DVec3 {
    let factor = parameter.factor(position.at(joint.axis()));
    let generator = unit(parameter.component());
    if parameter.shape() == Shape::Gain {
        let at = prefix * joint.before(position, errors);
        return at.transform_vector3(generator) * joint.sign() * factor;
    }
    let at = COMPONENTS
        .into_iter()
        .take_while(|component| *component != parameter.component())
        .fold(prefix, |outer, component| outer * joint.error_motion(component, position, errors));
    let direction = at.transform_vector3(generator);
    if parameter.component().is_linear() {
        direction * factor
    } else {
        direction.cross(tip - at.transform_point3(joint.point())) * factor
    }
}
