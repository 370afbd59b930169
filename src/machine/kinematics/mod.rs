//! Kinematic chain for every machine: topology, error parameters, exact pose, its Jacobian and its inverse. No
//! input or output.
//!
//! Each joint and each error parameter is a one-parameter motion exp(value·φ(q)·e_k). Location errors and error
//! motions come before the motion of their joint in the order X, Y, Z, A, B, C; gains of linear axes come after it,
//! with the joint's sign. "Relative to the previous axis": errors are inserted locally, in axes parallel to the
//! machine's when all axes are at zero; angular errors rotate about the point of the axis (the machine's origin for
//! linear axes).

mod axis_line;
mod carrier;
mod error_parameter;
mod jacobian;
mod joint;
mod kinematic_chain;
mod topology;
mod z_parallel_table_axis;

pub use axis_line::AxisLine;
pub use carrier::{AxisCommands, CarrierChain, CarrierMotion, MachineSide};
pub use error_parameter::{ErrorParameter, ErrorShape, ErrorTerm, InvalidErrorParameter};
pub use kinematic_chain::KinematicChain;
pub use topology::{Topology, TopologyError};
pub use z_parallel_table_axis::ZParallelTableAxis;

use crate::Axis;

/// Error: the kinematics cannot be built or solved, or the machine does not have a stated parameter or axis. The
/// message contains what to change.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum KinematicsError {
    #[error(transparent)]
    Topology(#[from] TopologyError),
    #[error(
        "axis {axis} is in the topology `{topology}`, but [axes.{axis}] is missing; add [axes.{axis}] or remove the axis from the topology"
    )]
    NotInAxes { axis: Axis, topology: String },
    #[error(
        "[axes.{axis}] is described, but the topology `{topology}` does not contain axis {axis}; add the axis to the topology or remove the section"
    )]
    NotInTopology { axis: Axis, topology: String },
    #[error("[axes.{axis}]: direction and point_mm must be finite numbers; [0,0,0] selects the nominal direction")]
    InvalidDirectionOrPoint { axis: Axis },
    #[error("{parameter} is an error of axis {axis}, which the machine {topology} does not have; remove the parameter")]
    NoSuchAxis { parameter: ErrorParameter, axis: Axis, topology: String },
    #[error(transparent)]
    InvalidParameter(#[from] InvalidErrorParameter),
    #[error("`{name}` is listed twice")]
    DuplicateParameter { name: String },
    #[error("the table does not turn on {axis}; check the topology")]
    NoTableAxis { axis: Axis },
    #[error("X, Y and Z do not span space; check the directions in [axes.X], [axes.Y], [axes.Z]")]
    DependentLinearAxes,
}

#[cfg(test)]
mod tests;
