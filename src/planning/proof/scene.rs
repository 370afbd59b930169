//! All bodies of a plan, and the pairs that could collide.

use nalgebra::Vector3;

use super::MARGIN_MM;
use super::body::{Body, Role, Shape};
use super::gap::Across;
use super::pairs::{Pair, PairRole, pairs};
use super::refusal::Reason;
use super::sweep::{Demand, FOUND_WITHIN, Way, nearest_origin, sweep};
use machine::Axis;
use machine::artefact::{self, Part};
use machine::frame::Pose;
use machine::kinematics::{CarrierChain, Chain, Side};
use machine::record::artefact::Artefact;
use machine::record::machine::Carrier;
use machine::record::plan::Plan;
use machine::record::sensor::Mount;

/// Minimum clearance of a probing move from everything that it does not touch, mm. The probe does not detect the
/// nose on a clamp, its own body on a stem or the table on a column, so nothing would stop there; and the declared
/// bodies are not measured to the last tenth. The probe does detect contact of its stylus (ball and stem) with the
/// artefact, including stems: on guarded moves, the stylus keeps only the artefact's uncertainty.
const UNFELT_MM: f64 = 0.5;
/// Tolerance for rounding of the text and of the position that the control reports, mm.
const LEAVING_MM: f64 = 0.01;

pub struct Scene {
    bodies: Vec<Body>,
    pairs: Vec<Pair>,
    /// Maximum distance of the artefact from its assumed position, mm.
    pub uncertainty: f64,
    /// Bodies that are not declared, and unchecked neighbours.
    pub not_looked_at: Vec<String>,
}

/// Clearance, mm, and the names of the two bodies.
type Found = (f64, [String; 2]);

/// Clearance rule for a path.
#[derive(Debug, Clone, Copy)]
pub enum ClearanceRule {
    /// All pairs stay farther apart than this, mm, wherever the artefact is within its uncertainty.
    Apart(f64),
    /// Like `Apart`, but the stylus ball may be as near to a sensor on the table as the sensor's range allows.
    InNest(f64),
    /// A guarded move: no bodies collide, and pairs whose contact the probe does not detect stay [`UNFELT_MM`]
    /// apart.
    Guarded,
    /// Like `Guarded`, but a pair that is nearer at the start may keep that distance during the whole move: the
    /// first, guarded move of a machine that was stopped beside the artefact. The pair must not come nearer.
    Leaving,
    /// An unguarded move out of contact: a pair that is nearer than [`MARGIN_MM`] at the start must not come
    /// nearer, all others keep [`MARGIN_MM`]. A pair that intersects at the start is not checked: one such pair is
    /// in contact, and the true position of the machine is unknown.
    Retracting,
    /// A touch of this body of the artefact: all pairs that do not concern this body stay [`UNFELT_MM`] apart.
    Strangers(usize),
    /// A touch of this body, whose position may be off across the touch: parts that move with the stylus ball stay
    /// clear of this body and its stem.
    Riders(usize, Across),
}

impl Scene {
    /// Builds the scene with `artefact` at its assumed position.
    pub fn new(plan: &Plan, artefact: &Artefact) -> Result<Self, Reason> {
        let chain = Chain::new(&plan.machine)?;
        let mut builder = Builder { chain, bodies: Vec::new() };
        let uncertainty = artefact::uncertainty_mm(artefact);
        let mut not_looked_at = builder.artefact(artefact)?;
        not_looked_at.extend(builder.tool(plan)?);
        not_looked_at.extend(builder.bare(plan));
        for keepout in &plan.keepout {
            let [low, high] = [keepout.min_mm, keepout.max_mm].map(Vector3::from);
            builder.add(&keepout.name, Role::Other, Carrier::Bed, Shape::cuboid(low, high))?;
        }
        for solid in &plan.solids {
            builder.add(&solid.name, Role::Other, solid.on, Shape::solid(solid))?;
        }
        let (pairs, unchecked) = pairs(&builder.bodies, uncertainty);
        not_looked_at.extend(unchecked);
        Ok(Self { bodies: builder.bodies, pairs, uncertainty, not_looked_at })
    }

    /// Bodies that are touched, with their numbers.
    pub fn touched(&self) -> impl Iterator<Item = (usize, &Body)> {
        self.bodies.iter().filter_map(|body| match body.role {
            Role::Touched(number) => Some((number, body)),
            _ => None,
        })
    }

    pub fn ball(&self) -> Option<&Body> {
        self.bodies.iter().find(|body| body.role == Role::StylusBall)
    }

    /// Smallest clearance on the path, mm, and its two bodies, if it is below `most`. The pair of stylus ball and
    /// artefact counts on unguarded paths only, because otherwise it is meant to come near. Pairs on one side never
    /// count, because their distance is a matter of the machine's design.
    ///
    /// # Errors
    /// The first pair that comes too near, or cannot be proven clear.
    pub fn look(
        &self,
        way: &Way,
        care: &ClearanceRule,
        most: f64,
    ) -> Result<Option<Found>, Reason> {
        let mut found = None;
        let mut nearest = most;
        let centres = (!way.turns()).then(|| self.centres(way));
        for pair in &self.pairs {
            let (need, across) = match (care, pair.meets) {
                (ClearanceRule::Apart(need), _) => (*need, None),
                (ClearanceRule::InNest(need), _) => (pair.measured_gap.unwrap_or(*need), None),
                (ClearanceRule::Guarded, _) => (pair.guarded(), None),
                (ClearanceRule::Leaving, _) => {
                    (at_start(pair, way).unwrap_or(0.0).min(pair.guarded()), None)
                }
                (ClearanceRule::Retracting, _) => match at_start(pair, way) {
                    Some(apart) => (apart.min(MARGIN_MM), None),
                    None => continue,
                },
                (ClearanceRule::Strangers(meant), meets) if !meets.of(*meant) => (UNFELT_MM, None),
                (ClearanceRule::Riders(meant, across), PairRole::Beside(number))
                    if number == *meant =>
                {
                    (pair.guarded(), Some(*across))
                }
                _ => continue,
            };
            let counts =
                !pair.one_side() && (!matches!(pair.meets, PairRole::Touch(_)) || need > 0.0);
            let grown = if across.is_none() { pair.grown } else { 0.0 };
            let demand =
                Demand { need, grown, across, nearest: if counts { nearest } else { need } };
            if centres.as_ref().is_some_and(|centres| far_apart(pair, centres, &demand)) {
                continue;
            }
            let Pair { one, other, .. } = pair;
            let between = || [one.name.clone(), other.name.clone()];
            match sweep(way, one, other, &demand) {
                Ok(Some(clearance)) if counts => {
                    nearest = clearance;
                    found = Some((clearance, between()));
                }
                Ok(_) => {}
                Err(clearance) => {
                    let clearance = clearance.max(0.0);
                    return Err(Reason::Near { between: between(), clearance, need });
                }
            }
        }
        Ok(found)
    }

    /// Centre of each body at both ends of the path, machine frame.
    fn centres(&self, way: &Way) -> Vec<[Vector3<f64>; 2]> {
        let mut poses: Vec<(&CarrierChain, [Pose; 2])> = Vec::new();
        let of = |body: &Body, [from, to]: [Pose; 2]| {
            let (centre, _) = body.shape.bounds();
            [from.transform_point(&centre.into()).coords, to.transform_point(&centre.into()).coords]
        };
        let mut centres = Vec::with_capacity(self.bodies.len());
        for body in &self.bodies {
            let known = poses.iter().find(|(carried, _)| carried.moves_as(&body.carried));
            let pose = known.map_or_else(
                || [&way.from, &way.to].map(|commands| body.carried.pose(commands)),
                |(_, pose)| *pose,
            );
            if known.is_none() {
                poses.push((&body.carried, pose));
            }
            centres.push(of(body, pose));
        }
        centres
    }
}

/// On a path without turning: whether the bounding balls of the two bodies stay farther apart than required.
fn far_apart(pair: &Pair, centres: &[[Vector3<f64>; 2]], demand: &Demand) -> bool {
    let [Some(one), Some(other)] = pair.numbers.map(|number| centres.get(number)) else {
        return false;
    };
    let apart = nearest_origin(other[0] - one[0], other[1] - one[1]).norm();
    let reach = pair.one.shape.bounds().1 + pair.other.shape.bounds().1;
    let loose = demand.grown + demand.across.map_or(0.0, |across| across.by);
    apart - reach - loose > demand.need.max(demand.nearest - FOUND_WITHIN)
}

/// Required clearance of a pair that is leaving, mm: its clearance at the start of the path. `None` if the two
/// intersect at the assumed positions.
fn at_start(pair: &Pair, way: &Way) -> Option<f64> {
    let start = Way { from: way.from, to: way.from };
    let demand = Demand { need: 0.0, grown: 0.0, across: None, nearest: f64::INFINITY };
    match sweep(&start, &pair.one, &pair.other, &demand) {
        Ok(Some(apart)) => Some(apart - pair.grown - LEAVING_MM),
        _ => None,
    }
}

impl Pair {
    /// Required clearance of the pair on a guarded move, mm.
    fn guarded(&self) -> f64 {
        if self.felt { 0.0 } else { UNFELT_MM }
    }
}

impl PairRole {
    /// Whether the pair concerns this body of the artefact.
    fn of(self, meant: usize) -> bool {
        matches!(self, Self::Touch(number) | Self::Beside(number) if number == meant)
    }
}

struct Builder {
    chain: Chain,
    bodies: Vec<Body>,
}

impl Builder {
    fn add(&mut self, name: &str, role: Role, on: Carrier, shape: Shape) -> Result<(), Reason> {
        let missing = || Reason::Carrier { solid: name.to_owned() };
        let carried = self.chain.carried(on).ok_or_else(missing)?;
        let corners = shape.corners();
        self.bodies.push(Body { name: name.to_owned(), role, shape, carried, corners });
        Ok(())
    }

    /// Adds the artefact. A stem begins inside the ball that it carries. Returns the names of undeclared parts.
    fn artefact(&mut self, artefact: &Artefact) -> Result<Vec<String>, Reason> {
        let parts = artefact::parts(artefact);
        let frame = match artefact {
            Artefact::DatumCylinder(_) => Role::Datum,
            _ => Role::Frame,
        };
        let touched: Vec<&Part> = parts.iter().filter(|part| part.touched).collect();
        let mut bare: Vec<usize> = (0..touched.len()).collect();
        for part in &parts {
            let carries = |touched: &&Part| match part.shape {
                artefact::Shape::Cylinder { from, .. } => {
                    Shape::part(touched).distance(from) <= 0.0
                }
                artefact::Shape::Ball { .. } => false,
            };
            let own = |other: &&Part| std::ptr::eq(*other, part);
            let number = |which: &dyn Fn(&&Part) -> bool| touched.iter().position(which);
            let role = if let Some(number) = number(&own) {
                Role::Touched(number)
            } else {
                number(&carries).map_or(frame, Role::StemOf)
            };
            bare.retain(|number| role != Role::StemOf(*number));
            self.add(&part.name, role, Carrier::Table, Shape::part(part))?;
        }
        let stems = matches!(artefact, Artefact::Balls(_));
        let bare = bare.iter().filter(|_| stems).filter_map(|number| touched.get(*number));
        Ok(bare.map(|part| format!("stem of {}", part.name)).collect())
    }

    /// Adds the parts in the spindle that turn with it, and the sensors on every mount. Returns the names of
    /// undeclared parts.
    fn tool(&mut self, plan: &Plan) -> Result<Vec<String>, Reason> {
        let turns = self.chain.topology().contains(Axis::S);
        let spindle = if turns { Carrier::Axis(Axis::S) } else { Carrier::Spindle };
        let mut missing = Vec::new();
        // A sensor in the spindle replaces the probe.
        if !plan.sensors.iter().any(|sensor| sensor.mount.is_spindle()) {
            missing.extend(self.probe(plan, spindle)?);
        }
        for sensor in &plan.sensors {
            let on = match sensor.mount {
                Mount::Spindle => spindle,
                Mount::Table => Carrier::Table,
                Mount::Bed => Carrier::Bed,
            };
            let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
            let front = zero - along * sensor.stand_off_mm;
            let back = front - along * sensor.body_length_mm;
            if sensor.body_radius_mm > 0.0 && front != back {
                let body = Shape::cylinder(front, back, sensor.body_radius_mm);
                let role = match sensor.mount {
                    Mount::Table => {
                        let at_near_end = sensor.stand_off_mm + sensor.range_mm[0];
                        Role::TableSensor { least_gap: at_near_end.clamp(0.0, MARGIN_MM) }
                    }
                    Mount::Spindle | Mount::Bed => Role::Sensor,
                };
                self.add(&sensor.name, role, on, body)?;
            } else {
                missing.push(format!("body of {}", sensor.name));
            }
        }
        Ok(missing)
    }

    /// Adds ball, stem and body of the probe. Returns the names of undeclared parts.
    fn probe(&mut self, plan: &Plan, on: Carrier) -> Result<Vec<String>, Reason> {
        let probe = &plan.probe;
        let ball = Vector3::from(plan.machine.tool_mm);
        self.add("stylus ball", Role::StylusBall, on, Shape::ball(ball, probe.ball_radius_mm))?;
        let end = ball + Vector3::z() * probe.stem_length_mm;
        let top = end + Vector3::z() * probe.body_length_mm;
        let parts = [
            ("stylus stem", Role::StylusStem, ball, end, probe.stem_radius_mm),
            ("probe body", Role::Other, end, top, probe.body_radius_mm),
        ];
        let mut missing = Vec::new();
        for (name, role, from, to, radius) in parts {
            if radius > 0.0 && from != to {
                self.add(name, role, on, Shape::cylinder(from, to, radius))?;
            } else {
                missing.push(name.to_owned());
            }
        }
        Ok(missing)
    }

    /// Sides of the machine without a declared solid.
    fn bare(&self, plan: &Plan) -> Vec<String> {
        let solid_on = |side: Side| {
            let carried = |on| self.chain.carried(on).map(|carried| carried.side());
            plan.solids.iter().any(|solid| carried(solid.on) == Some(side))
        };
        let sides = [("spindle nose", Side::Tool), ("table", Side::Work)];
        let bare = sides.into_iter().filter(|(_, side)| !solid_on(*side));
        bare.map(|(name, _)| name.to_owned()).collect()
    }
}
