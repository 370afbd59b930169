//! Pairs of bodies that could collide: all that move relative to each other.

use super::MARGIN_MM;
use super::body::{Body, Role};
use super::sweep::{Demand, Way, sweep};
use machine::Axis;
use machine::kinematics::{CarrierChain, Side};

/// Two bodies that could collide, relative to the last carrier that they share.
pub struct Pair {
    pub one: Body,
    pub other: Body,
    /// Indices of the two bodies in the list of all bodies.
    pub numbers: [usize; 2],
    pub meets: PairRole,
    /// Whether the pair is stylus and artefact, whose contact the probe detects.
    pub felt: bool,
    /// Maximum reduction of the distance of the two by the uncertainty of the artefact, mm.
    pub grown: f64,
    /// For the stylus ball and a sensor on the table that measures it: the smallest gap within the sensor's range,
    /// mm.
    pub measured_gap: Option<f64>,
}

/// Role of a pair in the touch of one body of the artefact, which has the contained number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PairRole {
    /// The stylus ball and that body, which are meant to meet.
    Touch(usize),
    /// A part that moves with the stylus ball, and that body or its stem; or the stylus ball and that stem.
    Beside(usize),
    /// All other pairs.
    Never,
}

impl Pair {
    /// Whether both are on the same side of the machine.
    pub fn one_side(&self) -> bool {
        self.one.carried.side() == self.other.carried.side()
    }

    /// Whether the pair is a displacement sensor and the cylinder that it measures.
    fn is_measured(&self) -> bool {
        let roles = [self.one.role, self.other.role];
        roles.contains(&Role::Sensor) && roles.contains(&Role::Datum)
    }

    /// Whether the two are nearer than the margin with all axes at zero: joined, or built close.
    fn neighbours(&self) -> bool {
        let zero = [0.0; Axis::ALL.len()];
        let way = Way { from: zero, to: zero };
        let (need, nearest) = (MARGIN_MM, f64::INFINITY);
        let demand = Demand { need, grown: self.grown, across: None, nearest };
        sweep(&way, &self.one, &self.other, &demand).is_err()
    }

    /// Whether only the rotation of the spindle moves them relative to each other: the nose, and the parts that it
    /// holds.
    fn held(&self) -> bool {
        self.one.carried.axes().chain(self.other.carried.axes()).all(|axis| axis == Axis::S)
    }
}

/// All pairs that some axis moves relative to each other, and as text those that are not checked: neighbours on one
/// side, unless one holds the other, and a sensor with a datum cylinder. The gap of these two is the sensor's
/// range, and the run monitors the samples while an axis moves.
pub fn pairs(bodies: &[Body], uncertainty: f64) -> (Vec<Pair>, Vec<String>) {
    let (mut pairs, mut unchecked) = (Vec::new(), Vec::new());
    let all = (0..bodies.len()).flat_map(|one| (0..bodies.len()).map(move |other| (one, other)));
    for (one, other) in all {
        let Some(pair) = pair(bodies, one, other, uncertainty) else { continue };
        if pair.is_measured() {
            let (one, other) = (&pair.one.name, &pair.other.name);
            unchecked.push(format!("{one} against {other}: the gap that the sensor measures"));
        } else if !(pair.one_side() && pair.neighbours()) {
            pairs.push(pair);
        } else if !pair.held() {
            let (one, other) = (&pair.one.name, &pair.other.name);
            let why = format!("they stand nearer than {MARGIN_MM} mm with all axes at zero");
            unchecked.push(format!("{one} against {other}: {why}"));
        }
    }
    (pairs, unchecked)
}

/// Each pair once: for bodies of two sides, the tool's body first, the bed's last.
fn pair(bodies: &[Body], one: usize, other: usize, uncertainty: f64) -> Option<Pair> {
    let (a, b) = (bodies.get(one)?, bodies.get(other)?);
    let comes_first = match (a.carried.side(), b.carried.side()) {
        (Side::Tool, Side::Work | Side::Bed) | (Side::Work, Side::Bed) => true,
        (first, second) => first == second && one < other,
    };
    if !comes_first || a.carried.moves_as(&b.carried) {
        return None;
    }
    let meets = meets(a, b, bodies);
    let of_artefact = |body: &Body| {
        matches!(body.role, Role::Touched(_) | Role::StemOf(_) | Role::Frame | Role::Datum)
    };
    let measured_gap = match (a.role, b.role) {
        (Role::StylusBall, Role::TableSensor { least_gap }) => Some(least_gap),
        _ => None,
    };
    let felt = matches!(a.role, Role::StylusBall | Role::StylusStem) && of_artefact(b);
    let grown = if of_artefact(a) || of_artefact(b) { uncertainty } else { 0.0 };
    let [of_one, of_other] = CarrierChain::between(&a.carried, &b.carried);
    let numbers = [one, other];
    let (one, other) =
        (Body { carried: of_one, ..a.clone() }, Body { carried: of_other, ..b.clone() });
    Some(Pair { one, other, numbers, meets, felt, grown, measured_gap })
}

fn meets(one: &Body, other: &Body, bodies: &[Body]) -> PairRole {
    match (one.role, other.role) {
        (Role::StylusBall, Role::Touched(number)) => PairRole::Touch(number),
        (_, Role::Touched(number) | Role::StemOf(number)) if rides(one, bodies) => {
            PairRole::Beside(number)
        }
        _ => PairRole::Never,
    }
}

/// Whether the same linear and rotary axes move the body as the stylus ball, the rotation of the spindle apart.
fn rides(body: &Body, bodies: &[Body]) -> bool {
    let axes = |body: &Body| -> Vec<Axis> {
        body.carried.axes().filter(|axis| *axis != Axis::S).collect()
    };
    let ball = bodies.iter().find(|other| other.role == Role::StylusBall);
    ball.is_some_and(|ball| axes(ball) == axes(body))
}
