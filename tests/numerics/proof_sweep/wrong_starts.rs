//! Starts of a run whose control has wrong positions of X, Y and Z, by up to 300 mm: homed wrongly, or with lost
//! steps. The path that `planning` plans is followed through an independent world: matrices and points on surfaces,
//! as in the other trials here.

use machine::record::motion::{Motion, MotionBlock};
use machine::record::plan::Plan;
use machine::{Axis, Position};
use methods::{NextStage, ObjectPositionSource};
use planning::gcode::{Dialect, HeadAndFootValues};
use planning::proof::{ProofRequest, StageSteps, prove_programs};
use planning::{BlockStart, SafeHeights, TouchedDirections, position_after_motions, touch_block};

use super::{Matrix, Point, Solid, map_point, multiply, relative_pose, rotation, translation};

const START_COUNT: u64 = 500;
/// Distance between two points on one body, mm.
const POINT_SPACING_MM: f64 = 5.0;
/// Smallest step between two checks along a path, mm.
const MIN_PATH_STEP_MM: f64 = 0.25;
/// Travel of X, Y, Z, mm; at its ends a limit switch stops the machine, and with it the run.
const TRAVEL_MM: [[f64; 2]; 3] = [[-250.0, 250.0], [-250.0, 250.0], [-50.0, 450.0]];

/// Acceleration of X, Y and Z, mm/s².
const ACCELERATION_MM_S2: f64 = 2000.0;

/// X, Y, Z in mm, B and C in degrees.
type Axes = [f64; 5];

/// A body of the tool: points, and a radius about each.
struct ToolBody {
    triggers_probe: bool,
    points: Vec<Point>,
    radius_about_points: f64,
}

/// `config/simulated.toml`, written out by hand.
struct TrueMachine {
    tool_bodies: Vec<ToolBody>,
    part: Solid,
    table: Solid,
    cradle: Solid,
}

impl TrueMachine {
    fn new() -> Self {
        let upright = |from: f64, to: f64, radius| Solid {
            from: [0.0, 0.0, from],
            to: [0.0, 0.0, to],
            cylinder_radius: Some(radius),
        };
        let stem = (0..=95).map(|z| [0.0, 0.0, f64::from(z) - 120.0]).collect();
        let solid = |solid: Solid| {
            let (points, radius) = (solid.surface_points(POINT_SPACING_MM), 0.0);
            ToolBody { triggers_probe: false, points, radius_about_points: radius }
        };
        Self {
            tool_bodies: vec![
                ToolBody { triggers_probe: true, points: vec![[0.0, 0.0, -120.0]], radius_about_points: 3.0 },
                ToolBody { triggers_probe: true, points: stem, radius_about_points: 1.5 },
                solid(upright(-25.0, 0.0, 20.0)),
                solid(upright(0.0, 150.0, 50.0)),
            ],
            part: upright(0.0, 100.0, 45.0),
            table: upright(-40.0, 0.0, 130.0),
            cradle: Solid { from: [-170.0, -130.0, -110.0], to: [170.0, 130.0, -45.0], cylinder_radius: None },
        }
    }

    /// Distance of the stylus, and of the other tool bodies, to the nearest body.
    fn stylus_and_body_distances_mm(&self, [x, y, z, b, c]: Axes) -> [f64; 2] {
        let spindle = translation([x, y, z]);
        let swung: Matrix = rotation(1, [0.0; 3], -b);
        let table = multiply(&swung, &rotation(2, [0.0; 3], -c));
        let obstacles = [(&self.part, table), (&self.table, table), (&self.cradle, swung)];
        let mut gaps = [f64::INFINITY; 2];
        for (obstacle, frame) in obstacles {
            let seen = relative_pose(&spindle, &frame);
            for part in &self.tool_bodies {
                let gap = &mut gaps[usize::from(!part.triggers_probe)];
                for point in &part.points {
                    *gap = gap.min(obstacle.distance(map_point(&seen, *point)) - part.radius_about_points);
                }
            }
        }
        gaps
    }
}

/// Result of a start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum StartOutcome {
    ConfirmedDirections,
    /// The stylus touched a body on a guarded move.
    GuardedContact,
    NoContact,
    AtLimitSwitch,
    /// The proof finds a body in the path from the assumed machine position.
    RefusedByProof,
}

fn axes_of(position: &Position) -> Axes {
    [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C].map(|axis| axis.to_mm_or_deg(position.get_or_zero(axis)))
}

/// First share of a straight path at which `clearance_mm` is not positive. The steps are no longer than the clearance.
fn first_contact_share(path: [Axes; 2], clearance_mm: impl Fn(Axes) -> f64) -> Option<f64> {
    let at = |share: f64| std::array::from_fn(|i| path[0][i] + share * (path[1][i] - path[0][i]));
    let linear: Point = std::array::from_fn(|i| path[1][i] - path[0][i]);
    // A turn by θ moves a point of the table by at most 300 mm · θ.
    let turned = (path[1][3] - path[0][3]).abs() + (path[1][4] - path[0][4]).abs();
    let length = super::length(linear) + 300.0 * turned.to_radians();
    let mut share = 0.0;
    loop {
        let gap = clearance_mm(at(share));
        if gap <= 0.0 {
            return Some(share);
        }
        if share >= 1.0 || length == 0.0 {
            return None;
        }
        share = (share + gap.max(MIN_PATH_STEP_MM) / length).min(1.0);
    }
}

/// A run on the true machine, whose control has wrong positions of X, Y and Z.
struct SimulatedRun<'a> {
    world: &'a TrueMachine,
    position_error_mm: Point,
    violations: Vec<String>,
}

impl SimulatedRun<'_> {
    fn true_axes(&self, believed: &Position) -> Axes {
        let mut axes = axes_of(believed);
        (0..3).for_each(|i| axes[i] += self.position_error_mm[i]);
        axes
    }

    /// Position of the machine after braking from a contact at this share of the path.
    fn axes_after_braking(&self, path: [Axes; 2], share: f64, feed_mm_min: f64) -> Axes {
        let linear: Point = std::array::from_fn(|i| path[1][i] - path[0][i]);
        let brakes = (feed_mm_min / 60.0).powi(2) / 2.0 / ACCELERATION_MM_S2;
        let end = (share + brakes / super::length(linear)).min(1.0);
        std::array::from_fn(|i| path[0][i] + end * (path[1][i] - path[0][i]))
    }

    /// Executes the motion from the true position; returns the outcome if the run ends with this motion.
    fn execute_motion(&mut self, from: &Position, motion: &Motion) -> Option<StartOutcome> {
        let to = position_after_motions([motion], from);
        let mut way = [self.true_axes(from), self.true_axes(&to)];
        let mut beyond = false;
        for (to, [low, high]) in way[1].iter_mut().zip(TRAVEL_MM) {
            beyond |= !(low - 0.01..=high + 0.01).contains(to);
            *to = to.clamp(low, high);
        }
        let said = |what: &str| format!("{what} on {motion:?} from {way:?}");
        let (unguarded, other) = (said("the stylus met something"), said("another body met something"));
        let met = first_contact_share(way, |at| self.world.stylus_and_body_distances_mm(at)[0]);
        match (motion, met) {
            (Motion::Guarded { feed_mm_min, .. } | Motion::Probe { feed_mm_min, .. }, Some(share)) => {
                way[1] = self.axes_after_braking(way, share, *feed_mm_min);
            }
            (Motion::BackOff { .. }, _) | (_, None) => {}
            (_, Some(_)) => self.violations.push(unguarded),
        }
        if first_contact_share(way, |at| self.world.stylus_and_body_distances_mm(at)[1]).is_some() {
            self.violations.push(other);
        }
        let met = met.is_some() && !matches!(motion, Motion::BackOff { .. });
        match (motion, met, beyond) {
            (Motion::Probe { .. }, true, _) => None,
            (_, true, _) => Some(StartOutcome::GuardedContact),
            (_, false, true) => Some(StartOutcome::AtLimitSwitch),
            (Motion::Probe { .. }, false, _) => Some(StartOutcome::NoContact),
            _ => None,
        }
    }
}

/// A pseudo-random number from 0 to 1.
fn uniform_draw(seed: u64, number: u64) -> f64 {
    let mut z = (seed * 64 + number).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Position that the control reports, and the true offset of X, Y and Z from it. Every fifth offset is at most 3
/// mm. The true position is free of collisions.
fn random_wrong_start(world: &TrueMachine, seed: u64) -> (Position, Point) {
    (0..)
        .find_map(|attempt| {
            let draw = |number| uniform_draw(seed, 8 * (attempt % 7) + number) + 0.137 * (attempt / 7) as f64;
            let draw = |number| draw(number).fract();
            let most = if seed.is_multiple_of(5) { 3.0 } else { 300.0 };
            let off: Point = std::array::from_fn(|i| most * (2.0 * draw(i as u64) - 1.0));
            let within = |i: usize| TRAVEL_MM[i][0] + draw(3 + i as u64) * (TRAVEL_MM[i][1] - TRAVEL_MM[i][0]);
            let believed: Point = std::array::from_fn(within);
            let c = 360.0 * uniform_draw(seed, 63) - 180.0;
            let truly: Point = std::array::from_fn(|i| believed[i] + off[i]);
            let inside = (0..3).all(|i| (TRAVEL_MM[i][0]..=TRAVEL_MM[i][1]).contains(&truly[i]));
            let free = inside
                && world
                    .stylus_and_body_distances_mm([truly[0], truly[1], truly[2], 0.0, c])
                    .iter()
                    .all(|gap| *gap > 0.5);
            let position = [Axis::X, Axis::Y, Axis::Z].into_iter().zip(believed).collect::<Position>();
            let position = position.with(Axis::B, 0.0).with(Axis::C, c.to_radians());
            free.then_some((position.with(Axis::S, 0.0), off))
        })
        .unwrap()
}

/// The steps that locate the part.
fn locating_plan() -> Plan {
    let text = include_str!("../../../config/simulated.toml").to_owned();
    let file = trued::setup::MachineFile::parse("simulated.toml", text).unwrap();
    let (method, mut plan) =
        trued::setup::configure_method_and_plan_without_steps(&file, "self-calibration", None).unwrap();
    let NextStage::Stage { new_steps, .. } = method.next_stage(&plan, &[], ObjectPositionSource::Nominal).unwrap()
    else {
        panic!("no stage")
    };
    plan.steps = new_steps;
    plan
}

/// The stage as a run plans it from the position that the control reports; `None` if the proof refuses it.
fn prove_locating_blocks(plan: &Plan, believed: &Position) -> Option<Vec<MotionBlock>> {
    let clearance = SafeHeights::above_plan_artefact(plan).unwrap();
    let (mut stands, mut confirmed) = (believed.clone(), TouchedDirections::default());
    let mut blocks = Vec::new();
    for step in &plan.steps {
        let start = BlockStart { position: Some(&stands), touched_directions: confirmed };
        let block = touch_block(plan, step, 0, start, &clearance).unwrap();
        stands = position_after_motions(&block.motions, &stands);
        confirmed = confirmed.after_step(step);
        blocks.push(block);
    }
    let dialect = Dialect::from_name("linuxcnc").unwrap();
    let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
    let program = HeadAndFootValues { title: "t", axes: &axes, result_log_path: None };
    let text = dialect.render_program(&program, &blocks).unwrap();
    let ids: Vec<u32> = plan.steps.iter().map(|step| step.id).collect();
    let request = ProofRequest {
        plan,
        stages: &[StageSteps { step_ids: &ids, found_artefact: None }],
        start_position: Some(believed),
        touched_directions: TouchedDirections::default(),
        dialect: &dialect,
    };
    prove_programs(&request, &[text]).is_ok().then_some(blocks)
}

/// The outcome of the start, the offset of the true position from the assumed one, and the violations.
fn simulate_start(world: &TrueMachine, plan: &Plan, seed: u64) -> (StartOutcome, Point, Vec<String>) {
    let (believed, off) = random_wrong_start(world, seed);
    let Some(blocks) = prove_locating_blocks(plan, &believed) else {
        return (StartOutcome::RefusedByProof, off, Vec::new());
    };
    let mut walk = SimulatedRun { world, position_error_mm: off, violations: Vec::new() };
    let (mut stands, mut confirmed) = (believed, TouchedDirections::default());
    let mut end = None;
    'run: for (block, step) in blocks.iter().zip(&plan.steps) {
        for motion in &block.motions {
            if let Some(ended) = walk.execute_motion(&stands, motion) {
                end = Some(ended);
                break 'run;
            }
            stands = position_after_motions([motion], &stands);
        }
        confirmed = confirmed.after_step(step);
        if confirmed.has_three_independent_directions() {
            end = Some(StartOutcome::ConfirmedDirections);
            break;
        }
    }
    (end.unwrap(), off, walk.violations)
}

#[test]
fn from_500_wrong_starts_only_the_stylus_makes_contact_in_a_guarded_move() {
    use rayon::prelude::*;
    let (world, plan) = (TrueMachine::new(), locating_plan());
    let ends: Vec<_> = (0..START_COUNT).into_par_iter().map(|seed| simulate_start(&world, &plan, seed)).collect();
    let count = |end: StartOutcome| ends.iter().filter(|(is, ..)| *is == end).count();
    for end in [
        StartOutcome::ConfirmedDirections,
        StartOutcome::GuardedContact,
        StartOutcome::NoContact,
        StartOutcome::AtLimitSwitch,
        StartOutcome::RefusedByProof,
    ] {
        println!("{end:?}: {}", count(end));
    }
    let bad: Vec<_> = ends.iter().flat_map(|(.., bad)| bad).collect();
    assert!(bad.is_empty(), "{}: {bad:#?}", bad.len());
    for (end, off, _) in &ends {
        let most = off.iter().fold(0.0_f64, |most, off| most.max(off.abs()));
        // A touch begins 2.5 mm before the stated position of the part, and ends as far beyond it.
        assert!(*end != StartOutcome::ConfirmedDirections || most < 2.6, "confirmed, but off by {off:?}");
        assert!(*end != StartOutcome::NoContact || most > 1.9, "not found, but off by {off:?} only");
    }
    assert!(count(StartOutcome::ConfirmedDirections) > 20 && count(StartOutcome::GuardedContact) > 50);
    // Starts at which the assumed position is beside a body.
    assert!(
        count(StartOutcome::RefusedByProof) < ends.len() / 5,
        "{} of {} refused",
        count(StartOutcome::RefusedByProof),
        ends.len()
    );
}
