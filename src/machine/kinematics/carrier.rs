//! Carriers: parts of the machine that carry a body. Computes the pose of a carrier, and a bound on the
//! displacement of the body while the axes move. Nominal: without error parameters.

use nalgebra::Vector3;

use super::joint::Joint;
use super::kinematic_chain::KinematicChain;
use crate::Axis;
use crate::frame::Pose;
use crate::record::machine::Carrier;

/// Positions of all axes in the order of [`Axis::ALL`], mm and rad.
pub type AxisCommands = [f64; Axis::ALL.len()];

/// Side of the machine, seen from the bed, on which a carrier is. Two carriers of one side share a part of their
/// motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MachineSide {
    Bed,
    Workpiece,
    Tool,
}

/// The joints between the bed and a carrier, beginning at the bed.
#[derive(Debug, Clone)]
pub struct CarrierChain {
    pub side: MachineSide,
    joints: Vec<Joint>,
}

/// A carrier during a motion. The proof evaluates a motion at many points, and most joints do not move in most
/// motions: the pose of a joint that does not move is computed only once, with its sine and cosine.
#[derive(Debug)]
pub struct CarrierMotion<'a>(Vec<(&'a Joint, Option<Pose>)>);

impl KinematicChain {
    /// Joints of `carrier`; `None` if the machine does not have its axis.
    pub fn carrier_chain(&self, carrier: Carrier) -> Option<CarrierChain> {
        let up_to = |branch: &[Joint], axis: Axis| {
            let last = branch.iter().position(|joint| joint.axis == axis)?;
            Some(branch.iter().take(last + 1).cloned().collect())
        };
        let (side, joints) = match carrier {
            Carrier::Bed => (MachineSide::Bed, Vec::new()),
            Carrier::Table => (MachineSide::Workpiece, self.workpiece_joints.clone()),
            Carrier::Spindle => {
                let is_not_s = |joint: &&Joint| joint.axis != Axis::S;
                (MachineSide::Tool, self.tool_joints.iter().filter(is_not_s).cloned().collect())
            }
            Carrier::Axis(axis) => match up_to(&self.workpiece_joints, axis) {
                Some(joints) => (MachineSide::Workpiece, joints),
                None => (MachineSide::Tool, up_to(&self.tool_joints, axis)?),
            },
        };
        Some(CarrierChain { side, joints })
    }
}

impl CarrierChain {
    /// Pose of the carrier in the machine frame.
    pub fn pose(&self, commands: &AxisCommands) -> Pose {
        self.joints
            .iter()
            .rev()
            .fold(Pose::identity(), |pose, joint| joint.nominal_pose(commands[joint.axis as usize]) * pose)
    }

    /// The axes that move the carrier.
    pub fn axes(&self) -> impl Iterator<Item = Axis> + '_ {
        self.joints.iter().map(|joint| joint.axis)
    }

    /// Whether the same axes, in the same order, move both carriers.
    pub fn has_same_axes_as(&self, other: &Self) -> bool {
        self.axes().eq(other.axes())
    }

    /// Both carriers relative to the last carrier that they share, without the joints that move both.
    pub fn without_shared_joints(first: &Self, second: &Self) -> [Self; 2] {
        let shared = first.axes().zip(second.axes()).take_while(|(a, b)| a == b).count();
        [first, second].map(|chain| {
            let joints = chain.joints.iter().skip(shared).cloned().collect();
            Self { side: chain.side, joints }
        })
    }

    /// The carrier during the motion from `from` to `to`.
    pub fn motion_between(&self, from: &AxisCommands, to: &AxisCommands) -> CarrierMotion<'_> {
        let joints = self.joints.iter().map(|joint| {
            let [from, to] = [from, to].map(|commands| commands[joint.axis as usize]);
            (joint, (from == to).then(|| joint.nominal_pose(from)))
        });
        CarrierMotion(joints.collect())
    }
}

impl CarrierMotion<'_> {
    /// Pose of the carrier in the machine frame at `middle`, and a bound, mm, on the displacement of any point of a
    /// body from its position at `middle`. The bound holds while every axis stays within `half_travel` of
    /// `middle`, on any path of the axes. The body lies in the convex hull of balls of `corner_radius` about `corners`
    /// (carrier frame).
    ///
    /// The position of a point is M₁…Mₙ·p. Changing one joint after the other, the outermost first, each joint
    /// moves the point by |Δq| (linear) or by the chord 2·sin(|Δθ|/2) times the distance of the point *at `middle`*
    /// from that axis; the outer joints do not change that length. The sum bounds the total displacement.
    pub fn pose_and_displacement_bound(
        &self,
        middle: &AxisCommands,
        half_travel: &AxisCommands,
        corners: &[Vector3<f64>],
        corner_radius: f64,
    ) -> (Pose, f64) {
        let (mut pose, mut displacement_bound) = (Pose::identity(), 0.0);
        for (joint, fixed_pose) in self.0.iter().rev() {
            let (command, half_travel) = (middle[joint.axis as usize], half_travel[joint.axis as usize]);
            if half_travel > 0.0 {
                let distances =
                    corners.iter().map(|p| joint.distance_from_axis(pose.transform_point(&(*p).into()).coords));
                displacement_bound +=
                    joint.max_displacement(half_travel, distances.fold(0.0, f64::max) + corner_radius);
            }
            pose = fixed_pose.unwrap_or_else(|| joint.nominal_pose(command)) * pose;
        }
        (pose, displacement_bound)
    }
}
