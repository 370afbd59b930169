//! Pairs of bodies that could collide: all that move relative to each other.

use super::MIN_UNGUARDED_CLEARANCE_MM;
use super::body::{BodyRole, CollisionBody};
use super::sweep::{ClearanceDemand, JointPath, check_min_clearance_on_path};
use machine::Axis;
use machine::kinematics::{CarrierChain, MachineSide};

/// Two bodies that could collide, relative to the last carrier that they share.
pub struct BodyPair {
    pub one: CollisionBody,
    pub other: CollisionBody,
    /// Indices of `one` and `other` in the list of all bodies.
    pub body_indices: [usize; 2],
    pub role: PairRole,
    /// Whether the pair is stylus and artefact, whose contact the probe detects.
    pub is_contact_detected: bool,
    /// Maximum reduction of the distance of the two by the uncertainty of the artefact, mm.
    pub max_misplacement_mm: f64,
    /// For the stylus ball and a sensor on the table that measures it: the smallest gap within the sensor's range,
    /// mm.
    pub min_gap_in_sensor_range_mm: Option<f64>,
}

/// Role of a pair in the touch of one body of the artefact, which has the contained number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PairRole {
    /// The stylus ball and that body, which are meant to meet.
    StylusBallAndTouchable(usize),
    /// A part that moves with the stylus ball, and that body or its stem; or the stylus ball and that stem.
    MovingPartAndTouchable(usize),
    /// All other pairs.
    OtherPair,
}

impl BodyPair {
    /// Whether both are on the same side of the machine.
    pub fn is_on_same_machine_side(&self) -> bool {
        self.one.carrier_chain.side == self.other.carrier_chain.side
    }

    /// Whether the pair is a displacement sensor and the cylinder that it measures.
    fn is_sensor_with_its_cylinder(&self) -> bool {
        let roles = [self.one.role, self.other.role];
        roles.contains(&BodyRole::SpindleOrBedSensor) && roles.contains(&BodyRole::DatumCylinder)
    }

    /// Whether the two are, or by the misplacement of the artefact could be, within [`MIN_UNGUARDED_CLEARANCE_MM`]
    /// with all axes at zero: joined, or built close.
    fn are_close_at_zero(&self) -> bool {
        let zero = [0.0; Axis::ALL.len()];
        let joint_path = JointPath { from: zero, to: zero };
        let demand = ClearanceDemand::without_upper_bound(MIN_UNGUARDED_CLEARANCE_MM, self.max_misplacement_mm);
        check_min_clearance_on_path(&joint_path, &self.one, &self.other, &demand).is_err()
    }

    /// Whether only the rotation of the spindle moves the two relative to each other, as the spindle nose and the parts
    /// that it holds.
    fn is_moved_by_spindle_rotation_only(&self) -> bool {
        self.one.carrier_chain.axes().chain(self.other.carrier_chain.axes()).all(|axis| axis == Axis::S)
    }
}

/// Pairs of bodies that an axis moves relative to each other; and, as text, the pairs that are not checked: neighbours
/// on one side, except parts that the spindle nose holds, and a sensor with its datum cylinder. The sensor measures the
/// gap to its cylinder, and the run monitors the samples while an axis moves.
pub fn collision_pairs_and_unchecked(bodies: &[CollisionBody], uncertainty: f64) -> (Vec<BodyPair>, Vec<String>) {
    let (mut pairs, mut unchecked) = (Vec::new(), Vec::new());
    let all = (0..bodies.len()).flat_map(|one| (0..bodies.len()).map(move |other| (one, other)));
    for (one, other) in all {
        let Some(pair) = make_relatively_moving_pair(bodies, one, other, uncertainty) else { continue };
        if pair.is_sensor_with_its_cylinder() {
            let (one, other) = (&pair.one.name, &pair.other.name);
            unchecked.push(format!("{one} against {other}: the gap that the sensor measures"));
        } else if !(pair.is_on_same_machine_side() && pair.are_close_at_zero()) {
            pairs.push(pair);
        } else if !pair.is_moved_by_spindle_rotation_only() {
            let (one, other) = (&pair.one.name, &pair.other.name);
            let reason = format!("nearer than {MIN_UNGUARDED_CLEARANCE_MM} mm with all axes at zero");
            unchecked.push(format!("{one} against {other}: {reason}"));
        }
    }
    (pairs, unchecked)
}

/// Makes the pair `one`, `other` if an axis moves them relative to each other. Each pair is made in one order only: the
/// tool's body before the workpiece's, the bed's body last; `None` for the other order.
fn make_relatively_moving_pair(
    bodies: &[CollisionBody],
    one: usize,
    other: usize,
    uncertainty: f64,
) -> Option<BodyPair> {
    let (a, b) = (bodies.get(one)?, bodies.get(other)?);
    let comes_first = match (a.carrier_chain.side, b.carrier_chain.side) {
        (MachineSide::Tool, MachineSide::Workpiece | MachineSide::Bed) | (MachineSide::Workpiece, MachineSide::Bed) => {
            true
        }
        (first, second) => first == second && one < other,
    };
    if !comes_first || a.carrier_chain.has_same_axes_as(&b.carrier_chain) {
        return None;
    }
    let of_artefact = |body: &CollisionBody| {
        matches!(
            body.role,
            BodyRole::Touchable(_)
                | BodyRole::StemOfTouchable(_)
                | BodyRole::OtherArtefactPart
                | BodyRole::DatumCylinder
        )
    };
    let min_gap_in_sensor_range_mm = match (a.role, b.role) {
        (BodyRole::StylusBall, BodyRole::TableSensor { min_gap_mm }) => Some(min_gap_mm),
        _ => None,
    };
    let is_contact_detected = matches!(a.role, BodyRole::StylusBall | BodyRole::StylusStem) && of_artefact(b);
    let max_misplacement_mm = if of_artefact(a) || of_artefact(b) { uncertainty } else { 0.0 };
    let [of_one, of_other] = CarrierChain::without_shared_joints(&a.carrier_chain, &b.carrier_chain);
    Some(BodyPair {
        one: CollisionBody { carrier_chain: of_one, ..a.clone() },
        other: CollisionBody { carrier_chain: of_other, ..b.clone() },
        body_indices: [one, other],
        role: pair_role(a, b, bodies),
        is_contact_detected,
        max_misplacement_mm,
        min_gap_in_sensor_range_mm,
    })
}

fn pair_role(one: &CollisionBody, other: &CollisionBody, bodies: &[CollisionBody]) -> PairRole {
    match (one.role, other.role) {
        (BodyRole::StylusBall, BodyRole::Touchable(number)) => PairRole::StylusBallAndTouchable(number),
        (_, BodyRole::Touchable(number) | BodyRole::StemOfTouchable(number)) if moves_with_stylus(one, bodies) => {
            PairRole::MovingPartAndTouchable(number)
        }
        _ => PairRole::OtherPair,
    }
}

/// Whether the same axes move the body and the stylus ball, apart from the rotation of the spindle.
fn moves_with_stylus(body: &CollisionBody, bodies: &[CollisionBody]) -> bool {
    let axes =
        |body: &CollisionBody| -> Vec<Axis> { body.carrier_chain.axes().filter(|axis| *axis != Axis::S).collect() };
    let ball = bodies.iter().find(|other| other.role == BodyRole::StylusBall);
    ball.is_some_and(|ball| axes(ball) == axes(body))
}
