//! Compares the proof with sampled points for balls on stems, each at a random position within its uncertainty:
//! single moves, and touches.

use planning::gcode::Dialect;
use planning::proof::{MIN_UNGUARDED_CLEARANCE_MM, RefusalReason};
use rayon::prelude::*;

use testing::population::proof_population_size;

use super::sampled_bodies::{RandomMachine, SampledBodies, SampledBody, least_distance};
use super::{
    Axes, COARSE_POINT_SPACING_MM, FINE_POINT_SPACING_MM, GUARDED_CLEARANCE_MM, Point, ProofCounts, RandomNumbers,
    TestMachine, length, map_point_back, refusal_of_single_move, subtract,
};

/// Clearance of a move, without the artefact's uncertainty: balls and stems may be touched by the stylus in a
/// guarded move.
fn required_clearance_mm(is_guarded: bool, stylus_body: usize) -> f64 {
    match (is_guarded, stylus_body) {
        (false, _) => MIN_UNGUARDED_CLEARANCE_MM,
        (true, 2) => GUARDED_CLEARANCE_MM,
        (true, _) => 0.0,
    }
}

struct RandomMoveAmongBalls {
    machine: RandomMachine,
    from: Axes,
    to: Axes,
    is_guarded: bool,
}

impl RandomMoveAmongBalls {
    fn new(number: u64) -> Self {
        let mut dice = RandomNumbers(number.wrapping_mul(0x2545_F491_4F6C_DD1D).wrapping_add(77));
        let kind = if number.is_multiple_of(2) { TestMachine::Trunnion } else { TestMachine::SwivelHead };
        let bench = RandomMachine::new(&mut dice, kind);
        let [b, c] = [dice.uniform_rounded(-40.0, 40.0), dice.uniform_rounded(-180.0, 180.0)];
        let mut place = |low: f64, b: f64, c: f64| {
            let tip = [dice.uniform(-90.0, 90.0), dice.uniform(-90.0, 90.0), dice.uniform(low, 130.0)];
            bench.axes_for_tip_position(tip, b, c)
        };
        let from = place(20.0, b, c);
        let mut to = place(20.0, b, c);
        let standing = !number.is_multiple_of(3);
        if !standing {
            to[3] += (from[0] - to[0]).clamp(-20.0, 20.0).round();
            to[4] += (from[1] - to[1]).clamp(-60.0, 60.0).round();
        }
        Self { machine: bench, from, to, is_guarded: standing && number % 3 == 1 }
    }

    /// Smallest distance of all pairs minus their required clearance, the share of the path at which it occurs, and
    /// whether any two bodies touch.
    fn sample_min_slack(&self, spacing: f64, stride: f64, (low, high): (f64, f64)) -> (f64, f64, bool) {
        let Self { machine: bench, from, to, is_guarded: guarded } = self;
        let SampledBodies { stylus, balls } = bench.sample_bodies(spacing);
        let way = (0..3).map(|i| (to[i] - from[i]).powi(2)).sum::<f64>().sqrt();
        let turn = (to[3] - from[3]).abs() + (to[4] - from[4]).abs();
        let count = ((way + 3.0 * turn) * (high - low) / stride).ceil().max(1.0) as usize;
        let (mut least, mut met) = ((f64::INFINITY, 0.0), false);
        for step in 0..=count {
            let share = low + (high - low) * step as f64 / count as f64;
            let at = bench.poses_at(*from, *to, share);
            for (tool, body) in stylus.iter().enumerate() {
                let keep = required_clearance_mm(*guarded, tool) + bench.ball_uncertainty_mm;
                for work in balls.iter().flatten() {
                    let apart = least_distance(&at, [body, work], [0.0; 3], least.0 + keep);
                    met |= apart <= 0.0;
                    if apart - keep < least.0 {
                        least = (apart - keep, share);
                    }
                }
            }
        }
        (least.0, least.1, met)
    }

    fn compare_proof_with_sampling(number: u64, dialect: &Dialect) -> ProofCounts {
        let case = Self::new(number);
        let plan = case.machine.touch_plan([[900.0, 0.0, 0.0, 0.0, 0.0]; 2], [1.0, 0.0, 0.0]);
        let refused = match refusal_of_single_move(&plan, (case.from, case.to), case.is_guarded, dialect) {
            RefusalReason::ClearanceTooSmall { .. } => true,
            RefusalReason::StepIncomplete(_) => false,
            other => panic!("{other}"),
        };
        let (mut least, at, mut met) = case.sample_min_slack(COARSE_POINT_SPACING_MM, 2.0, (0.0, 1.0));
        if least > 0.0 && least < 2.0 * COARSE_POINT_SPACING_MM {
            let window = ((at - 0.03).max(0.0), (at + 0.03).min(1.0));
            let (closer, _, meets) = case.sample_min_slack(FINE_POINT_SPACING_MM / 2.0, 0.1, window);
            (least, met) = (least.min(closer), met || meets);
        }
        let missed = u32::from(least < -1e-3 && !refused);
        if missed > 0 {
            eprintln!("move {number}: {least:.4} mm too near, and the proof lets it pass");
        }
        ProofCounts {
            refused: u32::from(refused),
            collisions: u32::from(met),
            needless_refusals: u32::from(refused && least > 0.0),
            wrongly_accepted: missed,
        }
    }
}

#[test]
fn proof_misses_no_collision_of_random_moves_among_balls() {
    let moves = proof_population_size(3_000);
    let dialect = Dialect::from_name("grbl").unwrap();
    let all =
        (0..moves).into_par_iter().map(|number| RandomMoveAmongBalls::compare_proof_with_sampling(number, &dialect));
    let count = all.reduce(ProofCounts::default, ProofCounts::add);
    println!("{moves} moves among balls: {count:?}");
    assert_eq!(count.wrongly_accepted, 0);
    assert!(u64::from(count.needless_refusals) * 50 <= moves, "{count:?}");
    assert!(u64::from(count.collisions) * 10 > moves, "{count:?}");
    assert!(u64::from(count.refused) * 5 < 4 * moves, "{count:?}");
}

/// A touch of one ball, aimed slightly off its centre.
struct RandomTouch {
    machine: RandomMachine,
    target_ball_index: usize,
    from: Axes,
    to: Axes,
    outward_normal: Point,
    /// Common shifts of all balls, table frame.
    ball_shifts: Vec<Point>,
}

/// Distance of the trigger after contact, mm; braking from 30 mm/min takes less than a micrometre.
const PRE_TRAVEL_MM: f64 = 0.1;
const INTERVALS_PER_TOUCH: usize = 80;

impl RandomTouch {
    fn new(number: u64) -> Self {
        let mut dice = RandomNumbers(number.wrapping_mul(0xD134_2543_DE82_EF95).wrapping_add(5));
        let kind = if number.is_multiple_of(2) { TestMachine::Trunnion } else { TestMachine::SwivelHead };
        let bench = RandomMachine::new(&mut dice, kind);
        let meant = dice.uniform(0.0, bench.balls.len() as f64) as usize;
        let [b, c] = [dice.uniform_rounded(-60.0, 60.0), dice.uniform_rounded(-180.0, 180.0)];
        let here = [0.0, 0.0, 0.0, b, c];
        let table = bench.kind.table(here);
        let way = [dice.uniform(-1.0, 1.0), dice.uniform(-1.0, 1.0), dice.uniform(-0.3, 1.0)];
        let normal = way.map(|x| x / length(way));
        let ((centre, radius), (_, tip)) = (bench.balls[meant][0].bounding_sphere(), bench.stylus[0].bounding_sphere());
        let aside: Point = std::array::from_fn(|_| dice.uniform(-0.5, 0.5));
        // Directions of the machine frame, expressed in the table's.
        let turned = |p: Point| subtract(map_point_back(&table, p), map_point_back(&table, [0.0; 3]));
        let out = turned(normal);
        let mut place = |low: f64, high: f64| {
            let far = radius + tip + dice.uniform(low, high);
            bench.axes_for_tip_position(std::array::from_fn(|i| centre[i] + far * out[i] + aside[i]), b, c)
        };
        let (from, to) = (place(0.3, 1.6), place(-2.0, -0.2));
        let shifts = (0..24).map(|k| {
            let p: Point = std::array::from_fn(|_| dice.uniform(-1.0, 1.0));
            let full = if k % 4 == 0 { dice.uniform(0.0, 1.0) } else { 1.0 };
            p.map(|x| x * full * bench.ball_uncertainty_mm / length(p))
        });
        let shifts = shifts.collect();
        Self { machine: bench, target_ball_index: meant, from, to, outward_normal: normal, ball_shifts: shifts }
    }

    /// Whether the touch is safe if the ball has this shift.
    fn is_safe_with_shift(&self, SampledBodies { stylus, balls }: &SampledBodies, shift: Point) -> bool {
        let own = &balls[self.target_ball_index];
        let length_mm = length(std::array::from_fn(|i| self.to[i] - self.from[i]));
        let gap = |tool: usize, work: &SampledBody, share: f64| {
            least_distance(&self.machine.poses_at(self.from, self.to, share), [&stylus[tool], work], shift, 1.0)
        };
        let shares = (0..=INTERVALS_PER_TOUCH).map(|k| k as f64 / INTERVALS_PER_TOUCH as f64);
        let Some(contact) = shares.clone().find(|share| gap(0, &own[0], *share) <= 3e-3) else {
            return false;
        };
        let stop = contact + PRE_TRAVEL_MM / length_mm - 1.0 / INTERVALS_PER_TOUCH as f64;
        contact > 0.0
            && shares.filter(|share| *share <= stop).all(|share| {
                gap(0, &own[1], share) > 0.0
                    && gap(1, &own[0], share) > 0.0
                    && gap(1, &own[1], share) > 0.0
                    && own.iter().all(|work| gap(2, work, share) > GUARDED_CLEARANCE_MM)
            })
    }

    /// Whether all other balls and stems, at all positions within their uncertainty, stay clear during the whole
    /// touch.
    fn avoids_other_balls(&self, SampledBodies { stylus, balls }: &SampledBodies) -> bool {
        let Self { machine: bench, target_ball_index: meant, .. } = self;
        let others = balls.iter().enumerate().filter(|(k, _)| k != meant);
        let others: Vec<&SampledBody> = others.flat_map(|(_, ball)| ball).collect();
        let keep = GUARDED_CLEARANCE_MM + bench.ball_uncertainty_mm;
        (0..=INTERVALS_PER_TOUCH / 4).all(|k| {
            let at = bench.poses_at(self.from, self.to, 4.0 * k as f64 / INTERVALS_PER_TOUCH as f64);
            stylus.iter().all(|tool| {
                let far = keep + 1.0;
                others.iter().all(|work| least_distance(&at, [tool, work], [0.0; 3], far) > keep - 1e-3)
            })
        })
    }

    fn compare_proof_with_sampling(number: u64, dialect: &Dialect) -> ProofCounts {
        let case = Self::new(number);
        let plan = case.machine.touch_plan([case.from, case.to], case.outward_normal);
        let refused = match refusal_of_single_move(&plan, (case.from, case.to), true, dialect) {
            RefusalReason::StepIncomplete(_) => false,
            RefusalReason::ClearanceTooSmall { .. }
            | RefusalReason::TouchWithoutContact
            | RefusalReason::TouchCanMiss { .. }
            | RefusalReason::WrongContactSide { .. } => true,
            other => panic!("{other}"),
        };
        let seen = case.machine.sample_bodies(1.0);
        let is_well = |shift: &Point| case.is_safe_with_shift(&seen, *shift);
        let well = case.avoids_other_balls(&seen) && case.ball_shifts.iter().all(is_well);
        if !well && !refused {
            eprintln!("touch {number} is not well, and the proof lets it pass");
        }
        ProofCounts {
            refused: u32::from(refused),
            collisions: u32::from(!well),
            needless_refusals: u32::from(refused && well),
            wrongly_accepted: u32::from(!well && !refused),
        }
    }
}

#[test]
fn proof_misses_no_unsafe_random_touch_of_balls() {
    let touches = proof_population_size(1_000);
    let dialect = Dialect::from_name("grbl").unwrap();
    let all = (0..touches).into_par_iter().map(|number| RandomTouch::compare_proof_with_sampling(number, &dialect));
    let count = all.reduce(ProofCounts::default, ProofCounts::add);
    println!("{touches} touches: {count:?}");
    assert_eq!(count.wrongly_accepted, 0);
    // Twenty-four positions of a ball may miss its worst one.
    assert!(u64::from(count.needless_refusals) * 10 <= touches, "{count:?}");
    assert!(u64::from(count.collisions) * 10 > touches, "{count:?}");
    assert!(u64::from(count.refused) * 5 < 4 * touches, "{count:?}");
}
