//! Compares the proof with a simple program: points on the surfaces of the solids, stepped along the motion and
//! tested against the other solid. It has its own forward kinematics from homogeneous matrices and shares nothing
//! with `kinematics/` or the collision library. It detects only a part of all collisions (only its points, only its
//! steps); the proof must refuse each one that it detects.

mod moves_among_balls;
mod sampled_bodies;
mod wrong_starts;

use machine::record::plan::Plan;
use machine::{Axis, Position};
use planning::gcode::Dialect;
use planning::proof::{MIN_UNGUARDED_CLEARANCE_MM, ProofRequest, RefusalReason, StageSteps, prove_programs};
use rayon::prelude::*;
use serde_json::json;

use testing::population::proof_population_size;

pub type Matrix = [[f64; 4]; 4];
pub type Point = [f64; 3];

pub fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

pub fn translation([x, y, z]: Point) -> Matrix {
    [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]]
}

/// Rotation about the line through `at` parallel to X, Y or Z (0, 1, 2), degrees, right-handed.
pub fn rotation(axis: usize, at: Point, degrees: f64) -> Matrix {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut turn = translation([0.0; 3]);
    (turn[i][i], turn[i][j], turn[j][i], turn[j][j]) = (cos, -sin, sin, cos);
    multiply(&translation(at), &multiply(&turn, &translation(at.map(|x| -x))))
}

fn map_point(m: &Matrix, p: Point) -> Point {
    std::array::from_fn(|i| m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3])
}

/// Applies the inverse of a rigid matrix to `p`.
pub fn map_point_back(m: &Matrix, p: Point) -> Point {
    let off: Point = std::array::from_fn(|i| p[i] - m[i][3]);
    std::array::from_fn(|i| m[0][i] * off[0] + m[1][i] * off[1] + m[2][i] * off[2])
}

/// Transformation from one frame into another: maps points of `from` to coordinates of `into`, both rigid.
fn relative_pose(from: &Matrix, into: &Matrix) -> Matrix {
    let origin = map_point_back(into, [0.0; 3]);
    let mut back = translation(origin);
    (0..3).for_each(|i| (0..3).for_each(|j| back[i][j] = into[j][i]));
    multiply(&back, from)
}

pub fn length(p: Point) -> f64 {
    (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt()
}

pub fn subtract(a: Point, b: Point) -> Point {
    std::array::from_fn(|i| a[i] - b[i])
}

/// A cylinder from centre to centre of its ends, or, without a radius, a box from corner to corner.
#[derive(Clone)]
pub struct Solid {
    pub from: Point,
    pub to: Point,
    pub cylinder_radius: Option<f64>,
}

impl Solid {
    pub fn middle(&self) -> Point {
        std::array::from_fn(|i| (self.from[i] + self.to[i]) / 2.0)
    }

    pub fn bounding_radius(&self) -> f64 {
        (length(subtract(self.to, self.from)) / 2.0).hypot(self.cylinder_radius.unwrap_or(0.0))
    }

    /// Distance of a point from the solid, 0 inside.
    pub fn distance(&self, p: Point) -> f64 {
        let Some(radius) = self.cylinder_radius else {
            let beyond = |i: usize| {
                let (low, high) = (self.from[i].min(self.to[i]), self.from[i].max(self.to[i]));
                (low - p[i]).max(p[i] - high).max(0.0)
            };
            return length([beyond(0), beyond(1), beyond(2)]);
        };
        let axis = subtract(self.to, self.from);
        let height = length(axis);
        let off = subtract(p, self.from);
        let along = (0..3).map(|i| off[i] * axis[i]).sum::<f64>() / height;
        let out = (length(off).powi(2) - along * along).max(0.0).sqrt();
        (-along).max(along - height).max(0.0).hypot((out - radius).max(0.0))
    }

    /// Points of the surface, such that every surface point is within `spacing` of one of them.
    fn surface_points(&self, spacing: f64) -> Vec<Point> {
        match self.cylinder_radius {
            None => self.box_points(spacing),
            Some(radius) => self.cylinder_points(radius, spacing),
        }
    }

    fn box_points(&self, spacing: f64) -> Vec<Point> {
        let mut points = Vec::new();
        for face in 0..3 {
            let (i, j) = ((face + 1) % 3, (face + 2) % 3);
            let size = subtract(self.to, self.from);
            let counts = [i, j].map(|k| (size[k].abs() / spacing).ceil().max(1.0) as usize);
            for (a, b) in (0..=counts[0]).flat_map(|a| (0..=counts[1]).map(move |b| (a, b))) {
                for side in [self.from[face], self.to[face]] {
                    let mut p = self.from;
                    p[face] = side;
                    p[i] += size[i] * a as f64 / counts[0] as f64;
                    p[j] += size[j] * b as f64 / counts[1] as f64;
                    points.push(p);
                }
            }
        }
        points
    }

    fn cylinder_points(&self, radius: f64, spacing: f64) -> Vec<Point> {
        let axis = subtract(self.to, self.from);
        let height = length(axis);
        let unit: Point = axis.map(|x| x / height);
        let other = if unit[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let cross =
            |a: Point, b: Point| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let u = cross(unit, other);
        let u = u.map(|x| x / length(u));
        let v = cross(unit, u);
        let mut points = Vec::new();
        let rows = (height / spacing).ceil().max(1.0) as usize;
        let rings = (radius / spacing).ceil().max(1.0) as usize;
        let mut ring = |r: f64, h: f64| {
            let count = (std::f64::consts::TAU * r / spacing).ceil().max(1.0) as usize;
            for k in 0..count {
                let (sin, cos) = (std::f64::consts::TAU * k as f64 / count as f64).sin_cos();
                points.push(std::array::from_fn(|i| self.from[i] + unit[i] * h + r * (cos * u[i] + sin * v[i])));
            }
        };
        for row in 0..=rows {
            ring(radius, height * row as f64 / rows as f64);
        }
        for k in 0..rings {
            ring(radius * k as f64 / rings as f64, 0.0);
            ring(radius * k as f64 / rings as f64, height);
        }
        points
    }

    fn as_json(&self, name: &str, on: &str) -> serde_json::Value {
        let mut value = json!({"name": name, "on": on, "from_mm": self.from, "to_mm": self.to});
        if let Some(radius) = self.cylinder_radius {
            value["radius_mm"] = radius.into();
        }
        value
    }
}

/// Positions of X, Y, Z in mm and B, C in degrees.
type Axes = [f64; 5];

/// Two machines, written out by hand. ISO 841: an axis that carries the workpiece moves by minus the command;
/// `reversed` inverts that.
#[derive(Clone, Copy, Debug, PartialEq)]
enum TestMachine {
    /// `w-C-B-F-Y-X-Z-t`: trunnion, C reversed; B turns about (5, 0, −20), C about (0, 3, 0).
    Trunnion,
    /// `w-C-Y-F-X-Z-B-t`: the table moves with Y, the head turns about (0, 0, 150), B reversed.
    SwivelHead,
}

impl TestMachine {
    fn topology(self) -> &'static str {
        match self {
            TestMachine::Trunnion => "w-C-B-F-Y-X-Z-t",
            TestMachine::SwivelHead => "w-C-Y-F-X-Z-B-t",
        }
    }

    fn table(self, [_, y, _, b, c]: Axes) -> Matrix {
        match self {
            TestMachine::Trunnion => multiply(&rotation(1, [5.0, 0.0, -20.0], -b), &rotation(2, [0.0, 3.0, 0.0], c)),
            TestMachine::SwivelHead => multiply(&translation([0.0, -y, 0.0]), &rotation(2, [0.0; 3], -c)),
        }
    }

    fn spindle(self, [x, y, z, b, _]: Axes) -> Matrix {
        match self {
            TestMachine::Trunnion => translation([x, y, z]),
            TestMachine::SwivelHead => multiply(&translation([x, 0.0, z]), &rotation(1, [0.0, 0.0, 150.0], -b)),
        }
    }

    /// Axes of the plan's machine.
    fn axes_json(self) -> serde_json::Value {
        let linear = json!({"min": -1000.0, "max": 1000.0});
        let turn = |positive: &str, point: Point| json!({"min": -720.0, "max": 720.0, "positive": positive, "point_mm": point});
        let (b, c) = match self {
            TestMachine::Trunnion => (turn("iso", [5.0, 0.0, -20.0]), turn("reversed", [0.0, 3.0, 0.0])),
            TestMachine::SwivelHead => (turn("reversed", [0.0, 0.0, 150.0]), turn("iso", [0.0; 3])),
        };
        json!({"X": linear, "Y": linear, "Z": linear, "B": b, "C": c})
    }

    fn plan_with_solids(self, solids: &[Solid; 3]) -> Plan {
        let at = json!({"X": 0.0, "Y": 0.0, "Z": 0.0, "B": 0.0, "C": 0.0});
        // Ball and artefact are far from all bodies.
        serde_json::from_value(json!({
            "trued_plan": 1, "method": "test", "settings": {},
            "machine": {"name": "m", "topology": self.topology(), "tool_mm": [0.0, 0.0, 9000.0],
                "axes": self.axes_json()},
            "probe": {"ball_radius_mm": 0.1},
            "artefact": {"kind": "cylinder", "centre_mm": [0.0, 0.0, -9000.0], "axis": [0.0, 0.0, 1.0],
                "radius_mm": 1.0, "height_mm": 1.0},
            "solids": [solids[0].as_json("tool", "spindle"), solids[1].as_json("work", "table"),
                solids[2].as_json("post", "bed")],
            "steps": [{"id": 0, "stage": 0, "kind": "touch", "label": "t", "from": at, "to": at,
                "feed_mm_min": 30.0, "sensor": "probe", "normal": [1.0, 0.0, 0.0]}],
        }))
        .unwrap()
    }
}

/// Generator of pseudo-random numbers, splitmix64.
struct RandomNumbers(u64);

impl RandomNumbers {
    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A uniform number, rounded to 1e-4, the resolution of the program text.
    fn uniform_rounded(&mut self, low: f64, high: f64) -> f64 {
        (self.uniform(low, high) * 1e4).round() / 1e4
    }

    fn random_solid(&mut self, centre: [(f64, f64); 3]) -> Solid {
        let middle = centre.map(|(low, high)| self.uniform_rounded(low, high));
        let mut half: Point = std::array::from_fn(|_| self.uniform_rounded(4.0, 35.0));
        let radius = (self.uniform(0.0, 1.0) < 0.5).then(|| self.uniform_rounded(3.0, 30.0));
        if radius.is_some() && self.uniform(0.0, 1.0) < 0.3 {
            // Thin along Z, as stems and tables are.
            (half[0], half[1]) = (0.0, 0.0);
        }
        let from = std::array::from_fn(|i| middle[i] - half[i]);
        Solid { from, to: std::array::from_fn(|i| middle[i] + half[i]), cylinder_radius: radius }
    }
}

struct RandomMove {
    kind: TestMachine,
    tool_work_and_post: [Solid; 3],
    from: Axes,
    to: Axes,
    /// Guarded moves need less clearance; only linear axes can make them.
    is_guarded: bool,
}

impl RandomMove {
    fn new(number: u64) -> Self {
        let mut dice = RandomNumbers(number.wrapping_mul(0x5851_F42D_4C95_7F2D));
        let kind = if number.is_multiple_of(2) { TestMachine::Trunnion } else { TestMachine::SwivelHead };
        let tool = dice.random_solid([(-20.0, 20.0), (-20.0, 20.0), (-60.0, 60.0)]);
        let work = dice.random_solid([(-70.0, 70.0), (-70.0, 70.0), (-40.0, 60.0)]);
        let post = dice.random_solid([(-150.0, 150.0), (-150.0, 150.0), (-100.0, 150.0)]);
        let mut place = || -> Axes {
            [
                dice.uniform_rounded(-110.0, 110.0),
                dice.uniform_rounded(-110.0, 110.0),
                dice.uniform_rounded(0.0, 180.0),
                dice.uniform_rounded(-60.0, 60.0),
                dice.uniform_rounded(-180.0, 180.0),
            ]
        };
        let (from, mut to) = (place(), place());
        // In one move of three the rotary axes do not move.
        if number.is_multiple_of(3) {
            (to[3], to[4]) = (from[3], from[4]);
        }
        Self { kind, tool_work_and_post: [tool, work, post], from, to, is_guarded: number % 6 == 3 }
    }

    fn poses_at(&self, share: f64) -> [Matrix; 3] {
        let axes = std::array::from_fn(|i| self.from[i] + share * (self.to[i] - self.from[i]));
        [self.kind.spindle(axes), self.kind.table(axes), translation([0.0; 3])]
    }

    /// Required clearance of the move, mm.
    fn required_clearance_mm(&self) -> f64 {
        if self.is_guarded { GUARDED_CLEARANCE_MM } else { MIN_UNGUARDED_CLEARANCE_MM }
    }

    /// Whether the proof refuses the move.
    fn proof_refuses(&self, dialect: &Dialect) -> bool {
        let plan = self.kind.plan_with_solids(&self.tool_work_and_post);
        match refusal_of_single_move(&plan, (self.from, self.to), self.is_guarded, dialect) {
            RefusalReason::ClearanceTooSmall { .. } => true,
            // The move itself was accepted.
            RefusalReason::StepIncomplete(_) => false,
            other => panic!("{other}"),
        }
    }

    /// Smallest distance of a sampled surface point from the other solid, over all pairs and steps, and the share of
    /// the path at which it occurs; distances above `far` may be left out.
    fn sampled_min_distance(&self, spacing: f64, stride: f64, far: f64, window: (f64, f64)) -> (f64, f64) {
        let surfaces = self.tool_work_and_post.each_ref().map(|solid| solid.surface_points(spacing));
        let way = (0..3).map(|i| (self.to[i] - self.from[i]).powi(2)).sum::<f64>().sqrt();
        // A rotation of one degree moves a point at 230 mm by about 4 mm.
        let turn = (self.to[3] - self.from[3]).abs() + (self.to[4] - self.from[4]).abs();
        let count = ((way + 4.0 * turn) * (window.1 - window.0) / stride).ceil().max(1.0) as usize;
        let mut best = (f64::INFINITY, 0.0);
        for step in 0..=count {
            let share = window.0 + (window.1 - window.0) * step as f64 / count as f64;
            let at = self.poses_at(share);
            for (a, b) in [(0, 1), (0, 2), (1, 2)] {
                let distance = self.least_distance(&at, &surfaces, a, b, far);
                if distance < best.0 {
                    best = (distance, share);
                }
                if distance <= 0.0 {
                    return best;
                }
            }
        }
        best
    }

    fn least_distance(&self, at: &[Matrix; 3], surfaces: &[Vec<Point>; 3], a: usize, b: usize, far: f64) -> f64 {
        let centre = |i: usize| map_point(&at[i], self.tool_work_and_post[i].middle());
        let reach = self.tool_work_and_post[a].bounding_radius() + self.tool_work_and_post[b].bounding_radius();
        if length(subtract(centre(a), centre(b))) - reach > far {
            return f64::INFINITY;
        }
        let one_way = |from: usize, into: usize| {
            let to_other = relative_pose(&at[from], &at[into]);
            let seen = |p: &Point| self.tool_work_and_post[into].distance(map_point(&to_other, *p));
            let distances = surfaces[from].iter().map(seen);
            distances.fold(f64::INFINITY, f64::min)
        };
        one_way(a, b).min(one_way(b, a))
    }
}

const AXES: [Axis; 5] = [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C];

fn position_from_axes(axes: Axes) -> Position {
    AXES.iter().zip(axes).map(|(axis, value)| (*axis, axis.to_mm_or_rad(value))).collect()
}

/// Reason for which a program of one move is refused; the program is never complete.
fn refusal_of_single_move(plan: &Plan, (from, to): (Axes, Axes), is_probing: bool, dialect: &Dialect) -> RefusalReason {
    let words: Vec<String> = AXES.iter().zip(to).map(|(a, v)| format!("{a}{v:.4}")).collect();
    // The first guarded move may start at the current position: it follows a dwell.
    let go = if is_probing { "G4 P0.1\nN0 G38.3 F30" } else { "G53 G0" };
    let head = "G21 G90 G94 G61 G49 G92.1\nG10 L2 P6 X0 Y0 Z0 B0 C0\nG59";
    let text = format!("{head}\nN0 {go} {}\n", words.join(" "));
    let (stages, stands) = ([StageSteps { step_ids: &[0], found_artefact: None }], position_from_axes(from));
    let (stages, stands) = (&stages, Some(&stands));
    let request = ProofRequest {
        plan,
        stages,
        start_position: stands,
        touched_directions: planning::TouchedDirections::all(),
        dialect,
    };
    prove_programs(&request, &[text]).unwrap_err().reason
}

#[derive(Default, Clone, Copy, Debug)]
struct ProofCounts {
    refused: u32,
    collisions: u32,
    needless_refusals: u32,
    wrongly_accepted: u32,
}

const COARSE_POINT_SPACING_MM: f64 = 6.0;
const FINE_POINT_SPACING_MM: f64 = 0.8;
/// Clearance of guarded moves from all bodies except the artefact, mm.
const GUARDED_CLEARANCE_MM: f64 = 0.5;

impl ProofCounts {
    fn add(self, other: Self) -> Self {
        Self {
            refused: self.refused + other.refused,
            collisions: self.collisions + other.collisions,
            needless_refusals: self.needless_refusals + other.needless_refusals,
            wrongly_accepted: self.wrongly_accepted + other.wrongly_accepted,
        }
    }
}

fn compare_proof_with_sampling(number: u64, dialect: &Dialect) -> ProofCounts {
    let case = RandomMove::new(number);
    let refused = case.proof_refuses(dialect);
    let need = case.required_clearance_mm();
    let far = need + 2.0 * COARSE_POINT_SPACING_MM;
    let (mut least, at) = case.sampled_min_distance(COARSE_POINT_SPACING_MM, 3.0, far, (0.0, 1.0));
    if least > need && least < far {
        // Between the coarse points: a fine check at the smallest distance.
        let window = ((at - 0.03).max(0.0), (at + 0.03).min(1.0));
        least = least.min(case.sampled_min_distance(FINE_POINT_SPACING_MM, 0.3, far, window).0);
    }
    let seen = least < need - 1e-3;
    let missed = u32::from(seen && !refused);
    if missed > 0 {
        eprintln!("move {number}: a point comes within {least:.4} mm, and the proof lets it pass");
    }
    ProofCounts {
        refused: u32::from(refused),
        collisions: u32::from(least <= 0.0),
        needless_refusals: u32::from(refused && least > need),
        wrongly_accepted: missed,
    }
}

#[test]
fn proof_misses_no_collision_of_random_moves() {
    let moves = proof_population_size(10_000);
    let dialect = Dialect::from_name("grbl").unwrap();
    let count = (0..moves)
        .into_par_iter()
        .map(|number| compare_proof_with_sampling(number, &dialect))
        .reduce(ProofCounts::default, ProofCounts::add);
    println!("{moves} moves: {count:?}");
    assert_eq!(count.wrongly_accepted, 0);
    assert!(u64::from(count.needless_refusals) * 50 <= moves, "{count:?}");
    // The moves are a useful sample: many collide, many pass.
    assert!(u64::from(count.collisions) * 5 > moves, "{count:?}");
    assert!(u64::from(count.refused) * 5 < 4 * moves, "{count:?}");
}
