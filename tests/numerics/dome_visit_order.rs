//! Compares the planned order of the dome's balls and of their touches with a long search: simulated annealing
//! within each indexation, with the durations of the planned paths, including all their heights.

use machine::Position;
use machine::record::motion::{Motion, MotionBlock};
use machine::record::plan::{Plan, Stage, Step};
use planning::{BlockStart, MachineTime, SafeHeights, TouchedDirections, position_after_motions, step_blocks};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use trued::setup::{self, MachineFile};

use estimation::random::seeded_stream;

/// Seconds from the end of each touch of a stage to each other touch, in the planned order; the first row starts at
/// the position before the stage.
type TravelTimeMatrix = Vec<Vec<f64>>;

/// Indices of touches, ball after ball.
type TouchOrderByBall = Vec<Vec<usize>>;

/// Duration of the path to a touch, and the machine position after the touch.
fn travel_time_and_end_position(
    plan: &Plan,
    from: &Position,
    step: &Step,
    safe_heights: &SafeHeights,
) -> (f64, Position) {
    let start = BlockStart { position: Some(from), touched_directions: TouchedDirections::all() };
    let blocks = step_blocks(plan, step, 0, start, safe_heights).unwrap();
    let ends = position_after_motions(blocks.iter().flat_map(|block| &block.motions), from);
    // The move to the start position takes no time.
    let here = MotionBlock { step: 0, repeat: 0, motions: vec![Motion::Rapid { to: from.clone() }] };
    let all: Vec<MotionBlock> = std::iter::once(here).chain(blocks).collect();
    (MachineTime::from_blocks(&all, &plan.machine).linear_move_s, ends)
}

/// Durations of a stage in the planned order, with its tour. `stands`: machine position before the stage, then
/// after it.
fn stage_travel_times(
    plan: &Plan,
    stage: &Stage,
    stands: &mut Option<Position>,
) -> (TravelTimeMatrix, TouchOrderByBall) {
    let safe_heights = SafeHeights::above_found_or_plan_artefact(plan, stage.found.as_ref()).unwrap();
    let steps = stage.steps.iter().map(|id| plan.steps.iter().find(|step| step.id == *id).unwrap());
    let steps: Vec<&Step> = steps.collect();
    let end = |step: &&&Step| travel_time_and_end_position(plan, &step.from, step, &safe_heights).1;
    let ends: Vec<Position> = steps.par_iter().map(|step| end(&step)).collect();
    let row = |from: &Position| -> Vec<f64> {
        steps.iter().map(|step| travel_time_and_end_position(plan, from, step, &safe_heights).0).collect()
    };
    let first = stands.as_ref().map_or(vec![0.0; steps.len()], row);
    *stands = ends.last().cloned();
    let ways = std::iter::once(first).chain(ends.par_iter().map(row).collect::<Vec<_>>());
    let ball = |number: &usize| steps[*number].label.split('/').nth(2).unwrap();
    let numbers: Vec<usize> = (0..steps.len()).collect();
    let tour = numbers.chunk_by(|a, b| ball(a) == ball(b)).map(<[usize]>::to_vec);
    (ways.collect(), tour.collect())
}

/// Time of the tour, from the first row on.
fn order_time_s(tour: &TouchOrderByBall, ways: &TravelTimeMatrix) -> f64 {
    let touches: Vec<usize> = tour.iter().flatten().copied().collect();
    let pairs = touches.windows(2).map(|pair| ways[pair[0] + 1][pair[1]]);
    ways[0][touches[0]] + pairs.sum::<f64>()
}

/// Reverses one segment or moves it elsewhere.
fn reverse_or_move_segment<T>(order: &mut Vec<T>, random: &mut impl Rng) {
    let mut ends = [0; 2].map(|_| random.random_range(0..order.len()));
    ends.sort_unstable();
    if random.random::<bool>() {
        order[ends[0]..=ends[1]].reverse();
    } else {
        let piece: Vec<T> = order.drain(ends[0]..=ends[1]).collect();
        let at = random.random_range(0..=order.len());
        order.splice(at..at, piece);
    }
}

/// Shortest time found by changing the order of the balls, and of the touches of a ball, from the planned order on.
fn annealed_time_s((ways, planned): &(TravelTimeMatrix, TouchOrderByBall), random: &mut impl Rng, tries: u64) -> f64 {
    let mut tour = planned.clone();
    let (mut time, mut best) = (order_time_s(&tour, ways), order_time_s(&tour, ways));
    for number in 0..tries {
        let heat_s = 0.3 * (1.0 - number as f64 / tries as f64).powi(3);
        let mut other = tour.clone();
        if random.random::<bool>() {
            reverse_or_move_segment(&mut other, random);
        } else {
            let ball = random.random_range(0..other.len());
            reverse_or_move_segment(&mut other[ball], random);
        }
        let change = order_time_s(&other, ways) - time;
        if change < 0.0 || random.random::<f64>() < (-change / heat_s).exp() {
            (tour, time) = (other, time + change);
            best = best.min(time);
        }
    }
    best
}

#[test]
#[ignore = "minutes of CPU, for the quality of an order and not for its safety"]
fn annealing_finds_no_order_shorter_by_5_percent() {
    let file = MachineFile::built_in_for_method("ball-dome").unwrap();
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, "ball-dome", None).unwrap();
    let (plan, stages) = methods::plan_nominal_stages(method.as_ref(), header).unwrap();
    let slow = stages.iter().filter(|stage| stage.name.starts_with("measure"));
    assert_eq!(slow.clone().count(), 24);
    let tries = 1_000_000;
    let mut stands = None;
    let all: Vec<_> = slow.map(|stage| stage_travel_times(&plan, stage, &mut stands)).collect();
    let of_stage = |(number, stage): (usize, &(TravelTimeMatrix, TouchOrderByBall))| {
        let random = &mut seeded_stream(1, &[0x746f_7572, number as u64]);
        [order_time_s(&stage.1, &stage.0), annealed_time_s(stage, random, tries)]
    };
    let times: Vec<[f64; 2]> = all.par_iter().enumerate().map(of_stage).collect();
    let [planned, best] = [0, 1].map(|k| times.iter().map(|times| times[k]).sum::<f64>());
    println!("planned {planned:.1} s, found in {tries} tries an indexation {best:.1} s");
    assert!(planned < 1.05 * best, "{planned} {best}");
}
