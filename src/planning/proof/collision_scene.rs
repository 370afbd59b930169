//! All bodies of a plan, and the pairs that could collide.

use nalgebra::Vector3;

use super::MIN_UNGUARDED_CLEARANCE_MM;
use super::body::{BodyRole, CollisionBody, CollisionShape};
use super::body_gap::LateralMisplacement;
use super::collision_pairs::{BodyPair, PairRole, collision_pairs_and_unchecked};
use super::refusal::RefusalReason;
use super::sweep::{
    ClearanceDemand, JointPath, REPORTED_CLEARANCE_ACCURACY_MM, check_min_clearance_on_path,
    segment_point_nearest_to_origin,
};
use machine::Axis;
use machine::artefact::{self, ArtefactBody};
use machine::frame::Pose;
use machine::kinematics::{CarrierChain, KinematicChain, MachineSide};
use machine::record::artefact::Artefact;
use machine::record::machine::Carrier;
use machine::record::plan::Plan;
use machine::record::sensor::SensorMount;

/// Minimum clearance of a probing move from everything that it does not touch, mm. The probe does not detect contact of
/// the spindle nose with a clamp, of the probe body with a stem, or of the table with a column, so such a contact does
/// not stop the machine; and declared sizes are not accurate to 0.1 mm. The probe does detect contact of its stylus
/// (ball and stem) with the artefact and its stems: on guarded moves, the stylus keeps only the artefact's uncertainty.
const MIN_UNDETECTED_CONTACT_CLEARANCE_MM: f64 = 0.5;
/// Tolerance for rounding of the text and of the position that the control reports, mm.
const START_CLEARANCE_TOLERANCE_MM: f64 = 0.01;

/// All bodies, with the artefact at one assumed position, and the pairs of bodies that could collide.
pub struct CollisionScene {
    bodies: Vec<CollisionBody>,
    pairs: Vec<BodyPair>,
    /// Maximum distance of the artefact from its assumed position, mm.
    pub max_artefact_misplacement_mm: f64,
    /// Bodies that are not declared, unchecked neighbours, and sensors against their datum cylinder, as text.
    pub unchecked_items: Vec<String>,
}

/// Clearance, mm, and the names of the two bodies.
type ClearanceAndBodyNames = (f64, [String; 2]);

/// Clearance rule for a path.
#[derive(Debug, Clone, Copy)]
pub enum ClearanceRule {
    /// All pairs stay [`MIN_UNGUARDED_CLEARANCE_MM`] apart, wherever the artefact is within its uncertainty.
    UnguardedMove,
    /// Like `UnguardedMove`, but the stylus ball may be as near to a sensor on the table as the sensor's range allows.
    UnguardedInNest,
    /// A guarded move: no bodies collide, and pairs whose contact the probe does not detect stay
    /// [`MIN_UNDETECTED_CONTACT_CLEARANCE_MM`] apart.
    GuardedMove,
    /// Like `GuardedMove`, but a pair that is nearer at the start may keep that distance during the whole move: the
    /// first, guarded move of a machine that was stopped beside the artefact. The pair must not come nearer.
    GuardedFirstMove,
    /// An unguarded move out of contact: a pair that is nearer than [`MIN_UNGUARDED_CLEARANCE_MM`] at the start must
    /// not come nearer, all others keep [`MIN_UNGUARDED_CLEARANCE_MM`]. A pair that intersects at the start is not
    /// checked: one such pair is in contact, and the true position of the machine is unknown.
    Retract,
    /// A touch of this body of the artefact: all pairs that do not concern this body stay
    /// [`MIN_UNDETECTED_CONTACT_CLEARANCE_MM`] apart.
    TouchOtherBodies(usize),
    /// A touch of this body, which may be misplaced perpendicular to the touch: parts that move with the stylus ball
    /// stay clear of this body and its stem.
    TouchMovingParts(usize, LateralMisplacement),
}

impl CollisionScene {
    /// Builds the scene with `artefact` at its assumed position.
    pub fn new(plan: &Plan, artefact: &Artefact) -> Result<Self, RefusalReason> {
        let chain = KinematicChain::new(&plan.machine)?;
        let mut builder = CollisionSceneBuilder { chain, bodies: Vec::new() };
        let uncertainty = artefact::max_misplacement_mm(artefact);
        let mut unchecked_items = builder.add_artefact(artefact)?;
        unchecked_items.extend(builder.add_spindle_parts_and_sensors(plan)?);
        unchecked_items.extend(builder.sides_without_solid(plan));
        for keepout in &plan.keepout {
            let [low, high] = [keepout.min_mm, keepout.max_mm].map(Vector3::from);
            builder.add_body(&keepout.name, BodyRole::OtherBody, Carrier::Bed, CollisionShape::cuboid(low, high))?;
        }
        for solid in &plan.solids {
            builder.add_body(&solid.name, BodyRole::OtherBody, solid.on, CollisionShape::from_solid(solid))?;
        }
        let (pairs, unchecked) = collision_pairs_and_unchecked(&builder.bodies, uncertainty);
        unchecked_items.extend(unchecked);
        Ok(Self { bodies: builder.bodies, pairs, max_artefact_misplacement_mm: uncertainty, unchecked_items })
    }

    /// Bodies that a touch may meet, with their numbers.
    pub fn touchable_bodies(&self) -> impl Iterator<Item = (usize, &CollisionBody)> {
        self.bodies.iter().filter_map(|body| match body.role {
            BodyRole::Touchable(number) => Some((number, body)),
            _ => None,
        })
    }

    /// The stylus ball; `None` if a sensor in the spindle replaces the probe.
    pub fn stylus_ball(&self) -> Option<&CollisionBody> {
        self.bodies.iter().find(|body| body.role == BodyRole::StylusBall)
    }

    /// Smallest clearance on the path, mm, and its two bodies, if it is below `max_clearance_mm`. A pair of stylus
    /// ball and touchable body counts only if the rule requires a clearance above 0 of it, because otherwise it is
    /// meant to come near. Pairs on one side never count, because their distance is a matter of the machine's design.
    ///
    /// # Errors
    /// The first pair that comes too near, or cannot be proven clear.
    pub fn check_path_and_find_nearest_pair(
        &self,
        joint_path: &JointPath,
        rule: &ClearanceRule,
        max_clearance_mm: f64,
    ) -> Result<Option<ClearanceAndBodyNames>, RefusalReason> {
        let mut nearest_pair = None;
        let mut nearest = max_clearance_mm;
        let centres = (!joint_path.moves_rotary_axis()).then(|| self.body_centres_at_path_ends(joint_path));
        for pair in &self.pairs {
            let Some((required_clearance_mm, lateral_misplacement)) =
                required_clearance_and_touched_body_misplacement(rule, pair, joint_path)
            else {
                continue;
            };
            let counts = !pair.is_on_same_machine_side()
                && (!matches!(pair.role, PairRole::StylusBallAndTouchable(_)) || required_clearance_mm > 0.0);
            let max_misplacement_mm = if lateral_misplacement.is_none() { pair.max_misplacement_mm } else { 0.0 };
            let ignored_above_mm = if counts { nearest } else { required_clearance_mm };
            let demand =
                ClearanceDemand { required_clearance_mm, max_misplacement_mm, lateral_misplacement, ignored_above_mm };
            if centres.as_ref().is_some_and(|centres| are_far_apart(pair, centres, &demand)) {
                continue;
            }
            let BodyPair { one, other, .. } = pair;
            let between = || [one.name.clone(), other.name.clone()];
            match check_min_clearance_on_path(joint_path, one, other, &demand) {
                Ok(Some(clearance)) if counts => {
                    nearest = clearance;
                    nearest_pair = Some((clearance, between()));
                }
                Ok(_) => {}
                Err(clearance) => {
                    let (clearance, min_clearance_mm) = (clearance.max(0.0), required_clearance_mm);
                    return Err(RefusalReason::ClearanceTooSmall { between: between(), clearance, min_clearance_mm });
                }
            }
        }
        Ok(nearest_pair)
    }

    /// Centre of each body at both ends of the path, machine frame.
    fn body_centres_at_path_ends(&self, joint_path: &JointPath) -> Vec<[Vector3<f64>; 2]> {
        let mut poses: Vec<(&CarrierChain, [Pose; 2])> = Vec::new();
        let mut centres = Vec::with_capacity(self.bodies.len());
        for body in &self.bodies {
            let same_axes = poses.iter().find(|(carried, _)| carried.has_same_axes_as(&body.carrier_chain));
            let known = same_axes.map(|(_, poses_at_ends)| *poses_at_ends);
            let poses_at_ends = known.unwrap_or_else(|| {
                let computed = [&joint_path.from, &joint_path.to].map(|commands| body.carrier_chain.pose(commands));
                poses.push((&body.carrier_chain, computed));
                computed
            });
            let (centre, _) = body.shape.bounding_ball();
            centres.push(poses_at_ends.map(|pose| pose.transform_point(&centre.into()).coords));
        }
        centres
    }
}

/// On a path without turning: whether the bounding balls of the two bodies stay farther apart than required.
fn are_far_apart(pair: &BodyPair, centres: &[[Vector3<f64>; 2]], demand: &ClearanceDemand) -> bool {
    let [Some(one), Some(other)] = pair.body_indices.map(|number| centres.get(number)) else {
        return false;
    };
    let apart = segment_point_nearest_to_origin(other[0] - one[0], other[1] - one[1]).norm();
    let reach = pair.one.shape.bounding_ball().1 + pair.other.shape.bounding_ball().1;
    let uncertainty_mm =
        demand.max_misplacement_mm + demand.lateral_misplacement.map_or(0.0, |lateral| lateral.max_misplacement_mm);
    apart - reach - uncertainty_mm
        > demand.required_clearance_mm.max(demand.ignored_above_mm - REPORTED_CLEARANCE_ACCURACY_MM)
}

/// Minimum clearance that `rule` requires of a pair, mm, and the lateral uncertainty of a touched part. `None`: the
/// pair is not checked.
fn required_clearance_and_touched_body_misplacement(
    rule: &ClearanceRule,
    pair: &BodyPair,
    joint_path: &JointPath,
) -> Option<(f64, Option<LateralMisplacement>)> {
    Some(match (rule, pair.role) {
        (ClearanceRule::UnguardedMove, _) => (MIN_UNGUARDED_CLEARANCE_MM, None),
        (ClearanceRule::UnguardedInNest, _) => {
            (pair.min_gap_in_sensor_range_mm.unwrap_or(MIN_UNGUARDED_CLEARANCE_MM), None)
        }
        (ClearanceRule::GuardedMove, _) => (pair.required_guarded_clearance_mm(), None),
        (ClearanceRule::GuardedFirstMove, _) => {
            let leaving_mm = required_clearance_of_leaving_pair_mm(pair, joint_path).unwrap_or(0.0);
            (leaving_mm.min(pair.required_guarded_clearance_mm()), None)
        }
        (ClearanceRule::Retract, _) => {
            let leaving_mm = required_clearance_of_leaving_pair_mm(pair, joint_path)?;
            (leaving_mm.min(MIN_UNGUARDED_CLEARANCE_MM), None)
        }
        (ClearanceRule::TouchOtherBodies(touched_body), role) if !role.concerns_body(*touched_body) => {
            (MIN_UNDETECTED_CONTACT_CLEARANCE_MM, None)
        }
        (ClearanceRule::TouchMovingParts(touched_body, lateral), PairRole::MovingPartAndTouchable(number))
            if number == *touched_body =>
        {
            (pair.required_guarded_clearance_mm(), Some(*lateral))
        }
        _ => return None,
    })
}

/// Required clearance of a pair that is leaving, mm: its clearance at the start of the path, less the possible
/// misplacement and a tolerance. `None` if the two intersect at the assumed positions.
fn required_clearance_of_leaving_pair_mm(pair: &BodyPair, joint_path: &JointPath) -> Option<f64> {
    let start = JointPath { from: joint_path.from, to: joint_path.from };
    let demand = ClearanceDemand::without_upper_bound(0.0, 0.0);
    let apart_mm = check_min_clearance_on_path(&start, &pair.one, &pair.other, &demand).ok().flatten()?;
    Some(apart_mm - pair.max_misplacement_mm - START_CLEARANCE_TOLERANCE_MM)
}

impl BodyPair {
    /// Required clearance of the pair on a guarded move, mm.
    fn required_guarded_clearance_mm(&self) -> f64 {
        if self.is_contact_detected { 0.0 } else { MIN_UNDETECTED_CONTACT_CLEARANCE_MM }
    }
}

impl PairRole {
    /// Whether the pair concerns this body of the artefact.
    fn concerns_body(self, touched_body: usize) -> bool {
        matches!(self, Self::StylusBallAndTouchable(number) | Self::MovingPartAndTouchable(number) if number == touched_body)
    }
}

struct CollisionSceneBuilder {
    chain: KinematicChain,
    bodies: Vec<CollisionBody>,
}

impl CollisionSceneBuilder {
    /// Adds a body. `Err`: the machine does not have the axis that carries the body.
    fn add_body(
        &mut self,
        name: &str,
        role: BodyRole,
        on: Carrier,
        shape: CollisionShape,
    ) -> Result<(), RefusalReason> {
        let missing = || RefusalReason::UnknownCarrier { solid: name.to_owned() };
        let carrier_chain = self.chain.carrier_chain(on).ok_or_else(missing)?;
        let hull_points_and_radius = shape.hull_points_and_radius();
        let name = name.to_owned();
        self.bodies.push(CollisionBody { name, role, shape, carrier_chain, hull_points_and_radius });
        Ok(())
    }

    /// Adds the artefact. A cylinder that begins inside a ball is its stem. Returns the names of undeclared parts.
    fn add_artefact(&mut self, artefact: &Artefact) -> Result<Vec<String>, RefusalReason> {
        let parts = artefact::artefact_bodies(artefact);
        let frame = match artefact {
            Artefact::DatumCylinder(_) => BodyRole::DatumCylinder,
            _ => BodyRole::OtherArtefactPart,
        };
        let touched: Vec<&ArtefactBody> = parts.iter().filter(|part| part.is_touchable).collect();
        let mut balls_without_stem: Vec<usize> = (0..touched.len()).collect();
        for part in &parts {
            let carries = |touched: &&ArtefactBody| match part.shape {
                artefact::BodyShape::Cylinder { from, .. } => {
                    CollisionShape::from_artefact_body(touched).distance_to_point(from) <= 0.0
                }
                artefact::BodyShape::Ball { .. } => false,
            };
            let own = |other: &&ArtefactBody| std::ptr::eq(*other, part);
            let number = |condition: &dyn Fn(&&ArtefactBody) -> bool| touched.iter().position(condition);
            let role = if let Some(number) = number(&own) {
                BodyRole::Touchable(number)
            } else {
                number(&carries).map_or(frame, BodyRole::StemOfTouchable)
            };
            balls_without_stem.retain(|number| role != BodyRole::StemOfTouchable(*number));
            self.add_body(&part.name, role, Carrier::Table, CollisionShape::from_artefact_body(part))?;
        }
        let stems = matches!(artefact, Artefact::Balls(_));
        let balls_without_stem = balls_without_stem.iter().filter(|_| stems).filter_map(|number| touched.get(*number));
        Ok(balls_without_stem.map(|part| format!("stem of {}", part.name)).collect())
    }

    /// Adds the parts in the spindle that turn with it, and the sensors on every mount. Returns the names of
    /// undeclared parts.
    fn add_spindle_parts_and_sensors(&mut self, plan: &Plan) -> Result<Vec<String>, RefusalReason> {
        let turns = self.chain.topology().contains(Axis::S);
        let spindle = if turns { Carrier::Axis(Axis::S) } else { Carrier::Spindle };
        let mut missing = Vec::new();
        // A sensor in the spindle replaces the probe.
        if !plan.sensors.iter().any(|sensor| sensor.mount.is_spindle()) {
            missing.extend(self.add_probe(plan, spindle)?);
        }
        for sensor in &plan.sensors {
            let gap_at_near_end_mm = sensor.stand_off_mm + sensor.range_mm[0];
            let min_gap_mm = gap_at_near_end_mm.clamp(0.0, MIN_UNGUARDED_CLEARANCE_MM);
            let (on, role) = match sensor.mount {
                SensorMount::Spindle => (spindle, BodyRole::SpindleOrBedSensor),
                SensorMount::Table => (Carrier::Table, BodyRole::TableSensor { min_gap_mm }),
                SensorMount::Bed => (Carrier::Bed, BodyRole::SpindleOrBedSensor),
            };
            let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
            let front = zero - along * sensor.stand_off_mm;
            let back = front - along * sensor.body_length_mm;
            if sensor.body_radius_mm > 0.0 && front != back {
                let body = CollisionShape::cylinder(front, back, sensor.body_radius_mm);
                self.add_body(&sensor.name, role, on, body)?;
            } else {
                missing.push(format!("body of {}", sensor.name));
            }
        }
        Ok(missing)
    }

    /// Adds ball, stem and body of the probe. Returns the names of undeclared parts.
    fn add_probe(&mut self, plan: &Plan, on: Carrier) -> Result<Vec<String>, RefusalReason> {
        let probe = &plan.probe;
        let ball = Vector3::from(plan.machine.tool_mm);
        self.add_body("stylus ball", BodyRole::StylusBall, on, CollisionShape::ball(ball, probe.ball_radius_mm))?;
        let end = ball + Vector3::z() * probe.stem_length_mm;
        let top = end + Vector3::z() * probe.body_length_mm;
        let parts = [
            ("stylus stem", BodyRole::StylusStem, ball, end, probe.stem_radius_mm),
            ("probe body", BodyRole::OtherBody, end, top, probe.body_radius_mm),
        ];
        let mut missing = Vec::new();
        for (name, role, from, to, radius) in parts {
            if radius > 0.0 && from != to {
                self.add_body(name, role, on, CollisionShape::cylinder(from, to, radius))?;
            } else {
                missing.push(name.to_owned());
            }
        }
        Ok(missing)
    }

    /// Sides of the machine without a declared solid: `spindle nose`, `table`.
    fn sides_without_solid(&self, plan: &Plan) -> Vec<String> {
        let has_solid_on = |side: MachineSide| {
            let carried = |on| self.chain.carrier_chain(on).map(|carried| carried.side);
            plan.solids.iter().any(|solid| carried(solid.on) == Some(side))
        };
        let sides = [("spindle nose", MachineSide::Tool), ("table", MachineSide::Workpiece)];
        let undeclared_sides = sides.into_iter().filter(|(_, side)| !has_solid_on(*side));
        undeclared_sides.map(|(name, _)| name.to_owned()).collect()
    }
}
