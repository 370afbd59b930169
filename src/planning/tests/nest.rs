//! Path of the ball into a nest of sensors on the table.

use super::*;
use crate::gcode::{Dialect, TransmissionForm};
use crate::proof::{ProofRequest, StageSteps, prove_blocks};
use machine::record::motion::Motion;

/// Ball of 11 mm radius, 120 mm below the spindle datum; three sensors at 120°, 35.26° below the centre of the
/// nest, which is at Z = 60 with all axes at zero.
fn nest_plan(steps: Vec<Step>) -> Plan {
    let mut plan = cylinder_plan(steps);
    plan.artefact = serde_json::from_value(json!({"kind": "none"})).unwrap();
    plan.probe.ball_radius_mm = 11.0;
    let elevation = (1.0 / 3.0_f64.sqrt()).asin();
    let sensor = |number: u32| {
        let angle = f64::from(number) * 2.0 * PI / 3.0;
        let [cos, sin] = [elevation.cos(), elevation.sin()];
        let along = [-cos * angle.cos(), -cos * angle.sin(), sin];
        let zero = [-11.0 * along[0], -11.0 * along[1], 60.0 - 11.0 * along[2]];
        serde_json::from_value(json!({"name": format!("n{number}"), "mount": "table",
            "zero_mm": zero, "direction": along, "range_mm": [-1.0, 1.0], "stand_off_mm": 1.5,
            "body_radius_mm": 4.0, "body_length_mm": 30.0}))
        .unwrap()
    };
    plan.sensors = (0..3).map(sensor).collect();
    plan
}

fn nest_position(x: f64, z: f64, c: f64) -> Position {
    position_from_mm_or_rad(&[(Axis::X, x), (Axis::Y, 0.0), (Axis::Z, 180.0 + z), (Axis::B, 0.0), (Axis::C, c)])
}

fn nest_scan_step(id: u32, path: Vec<Position>) -> Step {
    Step {
        kind: StepKind::Scan,
        from: path[0].clone(),
        to: path[path.len() - 1].clone(),
        feed_mm_min: 60.0,
        sensors: vec!["n0".into(), "n1".into(), "n2".into()],
        scan: Some(Scan { path, sampling: Sampling::Dwell { dwell_s: 0.5, samples: 3 } }),
        ..radial_touch_step(id, 0.0, 0.0, 0.0, 0.0)
    }
}

/// Checks that all steps of `plan` can be proven from an unverified position.
#[track_caller]
fn assert_blocks_are_proven(plan: &Plan, blocks: &[MotionBlock], position: &Position) {
    let steps: Vec<u32> = plan.steps.iter().map(|step| step.id).collect();
    let request = ProofRequest {
        plan,
        stages: &[StageSteps { step_ids: &steps, found_artefact: None }],
        start_position: Some(position),
        touched_directions: TouchedDirections::default(),
        dialect: &Dialect::from_name("grbl-m19").unwrap(),
    };
    let (proof, _) =
        prove_blocks(&request, &TransmissionForm::TableRows, blocks).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(proof.steps.len(), steps.len());
}

#[test]
fn the_ball_comes_from_straight_above_and_stays_in_the_nest() {
    let learn = vec![nest_position(0.0, 0.0, 0.0), nest_position(0.1, 0.0, 0.0), nest_position(0.0, 0.1, 0.0)];
    let ring = vec![nest_position(0.0, 0.0, 0.0), nest_position(0.0, 0.0, 1.0), nest_position(0.0, 0.0, 2.0)];
    let turned = vec![nest_position(0.1, 0.0, 1.0), nest_position(0.0, 0.0, 1.0)];
    let steps = vec![
        nest_scan_step(0, learn),
        nest_scan_step(1, ring),
        nest_scan_step(2, turned),
        nest_scan_step(3, vec![nest_position(0.0, 0.0, 0.0)]),
    ];
    let plan = nest_plan(steps);
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    let mut position = nest_position(50.0, 120.0, 0.5);
    let mut confirmed = TouchedDirections::default();
    let mut planned = Vec::new();
    for step in &plan.steps {
        let start = BlockStart { position: Some(&position), touched_directions: confirmed };
        let blocks = step_blocks(&plan, step, 0, start, &clearance).unwrap();
        for block in &blocks {
            position = position_after_motions(&block.motions, &position);
        }
        confirmed = confirmed.after_step(step);
        planned.push(blocks);
    }
    assert_blocks_are_proven(&plan, &planned.concat(), &nest_position(50.0, 120.0, 0.5));
    let count = |number: usize| {
        let scan = plan.steps[number].scan.as_ref().unwrap();
        out_of_range_block_count(scan, planned[number].len())
    };
    assert_eq!([0, 1, 2, 3].map(count), [2, 0, 0, 0]);
    let motions = || planned.iter().flatten().flat_map(|block| &block.motions);
    assert!(!motions().any(|motion| matches!(motion, Motion::Rapid { .. } | Motion::Guarded { .. })));
    let [up, down, first] = [0, 1, 2].map(|block| &planned[0][block].motions);
    assert_eq!(up.iter().filter_map(motion_target).collect::<Vec<_>>(), [position_from_mm_or_rad(&[(Axis::Z, 450.0)])]);
    // The near ends of the measuring lines are 10 mm · sin 35.26° below the centre: the lowest point of the ball is
    // 3 mm above them at 8.2 mm. The last 10 mm are slow in any case.
    assert_eq!(motion_target(down.last().unwrap()), Some(position_from_mm_or_rad(&[(Axis::Z, 190.0)])));
    let Motion::Feed { to, feed_mm_min } = &first[0] else { panic!("{first:?}") };
    assert_eq!(*to, position_from_mm_or_rad(&[(Axis::Z, 180.0)]));
    // The gap at the near end of the range is 0.5 mm: a hold after 0.3 s, and braking at 1000 mm/s².
    let speed = feed_mm_min / 60.0;
    assert!((speed * 0.3 + speed * speed / 2000.0 - 0.5).abs() < 1e-9, "{speed}");
    // From scan to scan, only the axes that must move do so.
    let ways = |number: usize| -> Vec<Position> {
        planned[number].iter().flat_map(|block| &block.motions).filter_map(motion_target).collect()
    };
    let turn = |c: f64| position_from_mm_or_rad(&[(Axis::C, c)]);
    let back = position_from_mm_or_rad(&[(Axis::Z, 180.0)]);
    assert_eq!(ways(1), [back, turn(1.0), turn(2.0)]);
    assert_eq!(
        ways(2),
        [turn(1.0), position_from_mm_or_rad(&[(Axis::X, 0.1)]), position_from_mm_or_rad(&[(Axis::X, 0.0)])]
    );
    assert_eq!(ways(3), [turn(0.0)]);
}

/// A resumed run: the ball is in the nest, and the position of the machine is not verified.
#[test]
fn a_turn_begins_in_an_unverified_nest_but_other_moves_begin_above_it() {
    let plan = nest_plan(vec![
        nest_scan_step(0, vec![nest_position(0.0, 0.0, 0.0), nest_position(0.0, 0.0, 1.0)]),
        nest_scan_step(1, vec![nest_position(0.1, 0.0, 1.0), nest_position(0.0, 0.0, 1.0)]),
    ]);
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    let position = nest_position(0.0, 0.0, 0.0);
    let start = BlockStart { position: Some(&position), touched_directions: TouchedDirections::default() };
    let turn = step_blocks(&plan, &plan.steps[0], 0, start, &clearance).unwrap();
    let only = |number: usize| Plan { steps: vec![plan.steps[number].clone()], ..plan.clone() };
    assert_blocks_are_proven(&only(0), &turn, &position);
    let way = step_blocks(&plan, &plan.steps[1], 0, start, &clearance).unwrap();
    assert_blocks_are_proven(&only(1), &way, &position);
    let count = |number: usize| {
        let start = BlockStart { position: Some(&position), touched_directions: TouchedDirections::default() };
        let blocks = step_blocks(&plan, &plan.steps[number], 0, start, &clearance).unwrap();
        out_of_range_block_count(plan.steps[number].scan.as_ref().unwrap(), blocks.len())
    };
    assert_eq!([count(0), count(1)], [0, 2]);
}
