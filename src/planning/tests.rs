//! Properties of the touch cycle, and machine times computed by hand.

mod balls;
mod nest;

use std::f64::consts::{FRAC_PI_2, PI};

use serde_json::json;

use super::*;
use machine::record::plan::{Sampling, Scan, Step, StepKind};

/// Stylus 120 mm long with a ball of 3 mm radius; a part 100 mm high, radius 45 mm, on the table.
fn cylinder_plan(steps: Vec<Step>) -> Plan {
    let linear = json!({"min": -250.0, "max": 250.0, "rapid_per_min": 6000.0, "acceleration_per_s2": 1000.0});
    let height = json!({"min": -50.0, "max": 450.0, "rapid_per_min": 6000.0, "acceleration_per_s2": 1000.0});
    let rotary = json!({"min": -360.0, "max": 360.0, "rapid_per_min": 1800.0, "acceleration_per_s2": 300.0});
    let mut plan: Plan = serde_json::from_value(json!({
        "trued_plan": 1, "method": "test", "settings": {},
        "machine": {"name": "test", "topology": "w-C-B-F-Y-X-Z-S-t", "tool_mm": [0.0, 0.0, -120.0],
            "axes": {"X": linear, "Y": linear, "Z": height, "B": rotary, "C": rotary, "S": rotary}},
        "probe": {"ball_radius_mm": 3.0, "overtravel_mm": 4.0, "search_feed_mm_min": 300.0},
        "artefact": {"kind": "cylinder", "centre_mm": [0.0, 0.0, 0.0], "axis": [0.0, 0.0, 1.0],
            "radius_mm": 45.0, "height_mm": 100.0, "uncertainty_mm": 2.0},
    }))
    .unwrap();
    plan.steps = steps;
    plan
}

fn position_from_mm_or_rad(axes: &[(Axis, f64)]) -> Position {
    axes.iter().copied().collect()
}

/// A radial touch at half the part's height: from 0.5 mm before contact to 1 mm beyond.
fn radial_touch_step(id: u32, phi: f64, b: f64, c: f64, s: f64) -> Step {
    let place = |r: f64| {
        position_from_mm_or_rad(&[(Axis::X, r * phi.cos()), (Axis::Y, r * phi.sin()), (Axis::Z, 170.0)])
            .updated_by(&position_from_mm_or_rad(&[(Axis::B, b), (Axis::C, c), (Axis::S, s)]))
    };
    Step {
        id,
        stage: 0,
        kind: StepKind::Touch,
        label: format!("touch {id}"),
        from: place(48.5),
        to: place(47.0),
        feed_mm_min: 30.0,
        sensors: vec!["probe".into()],
        normal: [phi.cos(), phi.sin(), 0.0],
        scan: None,
        text: None,
        mount: None,
        watch: Vec::new(),
    }
}

/// Safe height, mm: part 100 + ball 3 + uncertainty 2 + margin 10 + stylus 120.
const PART_CLEARANCE_Z_MM: f64 = 235.0;

fn are_positions_nearly_equal(a: &Position, b: &Position) -> bool {
    a.iter().count() == b.iter().count()
        && a.iter().all(|(axis, value)| b.get(axis).is_some_and(|v| (v - value).abs() < 1e-9))
}

#[test]
fn one_touch_has_the_expected_motions() {
    let plan = cylinder_plan(vec![radial_touch_step(3, 0.0, 0.0, 1.0, 0.5)]);
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    assert!((clearance.part_clearance_z.unwrap() - PART_CLEARANCE_Z_MM).abs() < 1e-9 && clearance.top_z == 450.0);
    let start = BlockStart { position: None, touched_directions: TouchedDirections::all() };
    let block = touch_block(&plan, &plan.steps[0], 2, start, &clearance).unwrap();
    assert_eq!((block.step, block.repeat), (3, 2));
    let z = |z| position_from_mm_or_rad(&[(Axis::Z, z)]);
    let x = |x| position_from_mm_or_rad(&[(Axis::X, x)]);
    let safe = clearance.part_clearance_z.unwrap();
    let expected = [
        Motion::Rapid { to: z(450.0) },
        Motion::Rapid { to: position_from_mm_or_rad(&[(Axis::B, 0.0), (Axis::C, 1.0)]) },
        Motion::OrientSpindle { s: 0.5 },
        Motion::Rapid { to: position_from_mm_or_rad(&[(Axis::X, 48.5), (Axis::Y, 0.0)]) },
        Motion::Rapid { to: z(safe) },
        Motion::Guarded { to: z(170.0), feed_mm_min: 1500.0 },
        Motion::Probe { to: x(47.0), feed_mm_min: 30.0 },
        Motion::BackOff { to: x(48.5), feed_mm_min: 300.0 },
        Motion::Guarded { to: z(safe), feed_mm_min: 1500.0 },
    ];
    assert_eq!(block.motions, expected);
    // A second touch of the same point needs neither a rise nor a turn.
    let position = position_after_motions(&block.motions, &Position::new());
    assert!(are_positions_nearly_equal(&position, &plan.steps[0].from.updated_by(&z(safe))));
    let again = touch_block(
        &plan,
        &plan.steps[0],
        3,
        BlockStart { position: Some(&position), touched_directions: TouchedDirections::all() },
        &clearance,
    )
    .unwrap();
    assert_eq!(again.motions, expected[5..]);
}

/// Until touches have verified the position of the machine, the path leads by way of the upper end of Z, one axis
/// group after the other, and near the part at the search feed.
#[test]
fn the_approach_to_an_unverified_position_has_no_rapid() {
    let plan = cylinder_plan(vec![radial_touch_step(3, 0.0, 0.0, 1.0, 0.5)]);
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    let [z, x] = [Axis::Z, Axis::X].map(|axis| move |to: f64| position_from_mm_or_rad(&[(axis, to)]));
    let guarded = |to: Position, feed_mm_min| Motion::Guarded { to, feed_mm_min };
    let of = |position, confirmed| {
        let start = BlockStart { position, touched_directions: confirmed };
        touch_block(&plan, &plan.steps[0], 0, start, &clearance).unwrap()
    };
    let touched = |feed| {
        [
            guarded(z(170.0), feed),
            Motion::Probe { to: x(47.0), feed_mm_min: 30.0 },
            Motion::BackOff { to: x(48.5), feed_mm_min: 300.0 },
            guarded(z(PART_CLEARANCE_Z_MM), feed),
        ]
    };
    // Low beside the part, only C turned, and 0.1 mm off in X: too short for a probing move.
    let position = plan.steps[0].from.clone().with(Axis::C, 0.0).with(Axis::X, 48.6);
    let block = of(Some(&position), TouchedDirections::default());
    let [Motion::Guarded { to: up, .. }, _, Motion::Feed { to: turn, .. }, rest @ ..] = block.motions.as_slice() else {
        panic!("{block:?}")
    };
    assert!(
        are_positions_nearly_equal(up, &z(PART_CLEARANCE_Z_MM))
            && are_positions_nearly_equal(turn, &position_from_mm_or_rad(&[(Axis::C, 1.0)])),
        "{block:?}"
    );
    assert_eq!(block.motions[1], guarded(z(450.0), 1500.0));
    assert_eq!(rest[0], Motion::Feed { to: x(48.5), feed_mm_min: 300.0 });
    assert_eq!(rest[1], guarded(z(PART_CLEARANCE_Z_MM), 1500.0));
    assert_eq!(rest[2..], touched(300.0));
    // From the end of that block, no sideways move is needed, and the probe is known to work.
    let position = position_after_motions(&block.motions, &position);
    let begun = TouchedDirections::default().after_step(&plan.steps[0]);
    assert_eq!(of(Some(&position), begun).motions, touched(1500.0));
    // Every axis whose position is unknown must move.
    let unknown = of(None, TouchedDirections::default());
    assert!(!unknown.motions.iter().any(|motion| matches!(motion, Motion::Rapid { .. })));
    assert_eq!(unknown.motions.len(), 4 + 2 + touched(300.0).len());
}

/// Checks that every motion of `block` obeys the rules of safe motion, whatever came before.
fn assert_touch_block_moves_safely(plan: &Plan, block: &MotionBlock, begins: &Position, safe_z: f64) {
    let mut position = begins.clone();
    let mut probe: Option<(Position, Position)> = None;
    for motion in &block.motions {
        let to = motion_target(motion).unwrap();
        let next = position.updated_by(&to);
        let high = |p: &Position| p.get(Axis::Z).is_some_and(|z| z >= safe_z - 1e-9);
        let turns = to.iter().any(|(axis, _)| !axis.is_linear());
        assert!(!turns || high(&position), "turns low: {motion:?}");
        match motion {
            // Unguarded: high at both ends, or straight up from an unknown position.
            Motion::Rapid { .. } if high(&position) => assert!(high(&next), "{motion:?}"),
            Motion::Rapid { .. } => {
                assert!(to.iter().all(|(axis, _)| axis == Axis::Z), "{motion:?}");
                assert!(position.get(Axis::Z).is_none(), "{motion:?}");
                assert!(high(&next));
            }
            Motion::Probe { .. } => {
                assert!(probe.is_none(), "the touch has a second probing move");
                probe = Some((position.clone(), next.clone()));
            }
            Motion::BackOff { .. } => {
                let (start, deepest) = probe.clone().expect("a back-off without a touch");
                assert!(
                    are_positions_nearly_equal(&next, &start),
                    "the back-off does not end at the start of the probing move"
                );
                let square = |axis| (next.get_or_zero(axis) - deepest.get_or_zero(axis)).powi(2);
                let length = Axis::LINEAR.into_iter().map(square).sum::<f64>().sqrt();
                assert!(length > 0.0 && length <= plan.probe.overtravel_mm);
            }
            Motion::Guarded { .. } | Motion::OrientSpindle { .. } => {}
            Motion::Dwell { .. } | Motion::Feed { .. } => unreachable!("a touch does neither"),
        }
        position = next;
    }
    assert!(probe.is_some(), "the touch has no probing move");
    assert!(position.get_or_zero(Axis::Z) >= safe_z - 1e-9, "the touch does not end above the safe height");
}

#[test]
fn every_touch_of_a_cycle_obeys_the_motion_rules() {
    let steps: Vec<Step> = (0..24)
        .map(|i| {
            let turn = f64::from(i) * PI / 4.0;
            let b = if i % 5 == 0 { 0.3 } else { 0.0 };
            radial_touch_step(i, turn, b, -(turn % 5.0), (turn * 3.0) % 6.0)
        })
        .collect();
    let plan = cylinder_plan(steps);
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    let parked = radial_touch_step(0, 1.0, 0.0, 0.0, 0.0).from;
    for begins in [
        None,
        // Low beside the part, at the safe height, and higher than the safe height.
        Some(parked.clone()),
        Some(parked.updated_by(&position_from_mm_or_rad(&[(Axis::Z, clearance.part_clearance_z.unwrap())]))),
        Some(parked.updated_by(&position_from_mm_or_rad(&[(Axis::Z, 440.0)]))),
    ] {
        let mut position = begins;
        for step in &plan.steps {
            let block = touch_block(
                &plan,
                step,
                0,
                BlockStart { position: position.as_ref(), touched_directions: TouchedDirections::all() },
                &clearance,
            )
            .unwrap();
            let from = position.unwrap_or_default();
            assert_touch_block_moves_safely(&plan, &block, &from, clearance.part_clearance_z.unwrap());
            position = Some(position_after_motions(&block.motions, &from));
        }
    }
    let (blocks, seconds) = plan_blocks_and_time_s(&plan, &clearance).unwrap();
    assert_eq!(blocks.len(), 24);
    assert!(seconds > 24.0 * 1.5);
}

/// A part 100 mm high and 45 mm in radius, tilted from 0° to 90°: its rim rises to √(100² + 45²) during the motion,
/// higher than at either end.
#[test]
fn safe_height_clears_the_rim_between_two_tilts() {
    let plan =
        cylinder_plan(vec![radial_touch_step(0, 0.0, 0.0, 0.0, 0.0), radial_touch_step(1, 0.0, FRAC_PI_2, 0.0, 0.0)]);
    let rim = 100.0_f64.hypot(45.0) + PART_CLEARANCE_Z_MM - 100.0;
    let safe = SafeHeights::above_plan_artefact(&plan).unwrap().part_clearance_z.unwrap();
    assert!(safe <= rim + 1e-9 && safe > rim - 0.2, "{safe} against {rim}");
}

#[test]
fn too_little_z_travel_and_inverted_z_are_refused() {
    let mut low = cylinder_plan(Vec::new());
    low.machine.axes.get_mut(&Axis::Z).unwrap().max = 200.0;
    match SafeHeights::above_plan_artefact(&low) {
        Err(PlanningError::InsufficientZTravel { needed, max }) => {
            assert!((needed - PART_CLEARANCE_Z_MM).abs() < 1e-9 && max == 200.0);
        }
        other => panic!("{other:?}"),
    }
    let mut down = cylinder_plan(Vec::new());
    down.machine.axes.get_mut(&Axis::Z).unwrap().positive = machine::record::machine::AxisSense::Reversed;
    assert!(matches!(SafeHeights::above_plan_artefact(&down), Err(PlanningError::InvertedZ)));
}

#[track_caller]
fn touch_refusal(change: impl FnOnce(&mut Plan, &mut Step)) -> PlanningError {
    let mut step = radial_touch_step(7, 0.0, 0.0, 0.0, 0.0);
    let mut plan = cylinder_plan(vec![step.clone()]);
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    change(&mut plan, &mut step);
    let error = touch_block(&plan, &step, 0, BlockStart::default(), &clearance).unwrap_err();
    assert!(!error.remedy().is_empty());
    error
}

#[test]
fn invalid_touches_are_refused_with_their_reason() {
    use PlanningError::*;
    let error = touch_refusal(|_, step| step.from.set(Axis::X, 251.0));
    assert!(matches!(error, TouchTooLong { step: 7, .. }), "{error}");
    let error = touch_refusal(|plan, _| plan.machine.axes.get_mut(&Axis::X).unwrap().max = 48.0);
    let (axis, value, min, max) = (Axis::X, 48.5, -250.0, 48.0);
    assert_eq!(error, OutOfTravel { step: 7, axis, value, min, max });
    let error = touch_refusal(|_, step| step.from.set(Axis::C, 361.0_f64.to_radians()));
    assert!(matches!(error, RotaryMotionInTouch { axis: Axis::C, .. }), "{error}");
    let error = touch_refusal(|_, step| {
        step.from.set(Axis::C, 361.0_f64.to_radians());
        step.to.set(Axis::C, 361.0_f64.to_radians());
    });
    assert!(matches!(error, OutOfTravel { axis: Axis::C, .. }), "{error}");
    let error = touch_refusal(|_, step| step.from.set(Axis::S, f64::NAN));
    assert!(matches!(error, OutOfTravel { axis: Axis::S, .. }), "{error}");
    let error = touch_refusal(|plan, _| plan.machine.axes.retain(|axis, _| *axis != Axis::S));
    assert_eq!(error, UnknownAxis { step: 7, axis: Axis::S });
    let error = touch_refusal(|_, step| step.to = step.from.clone());
    assert_eq!(error, ZeroLengthTouch { step: 7 });
    let error = touch_refusal(|_, step| step.kind = StepKind::Scan);
    assert_eq!(error, NotATouch { step: 7 });
    let error = touch_refusal(|_, step| step.from = step.from.filter_axes(|axis| axis != Axis::B));
    assert_eq!(error, MissingAxisPosition { step: 7, axis: Axis::B });
}

#[test]
fn rotary_target_exactly_at_its_limit_is_accepted() {
    let full = 2.0 * PI;
    let plan = cylinder_plan(vec![radial_touch_step(0, 0.0, 0.0, full, 0.0)]);
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    assert!(touch_block(&plan, &plan.steps[0], 0, BlockStart::default(), &clearance).is_ok());
}

/// X moves at 100 mm/s and 1000 mm/s², C at 30°/s and 300°/s².
#[test]
fn machine_time_is_that_of_hand_computed_trapezoids() {
    let machine = cylinder_plan(Vec::new()).machine;
    let begins = position_from_mm_or_rad(&[(Axis::X, 0.0), (Axis::Y, 0.0), (Axis::Z, 0.0), (Axis::C, 0.0)]);
    let seconds =
        |motions: Vec<Motion>| machine_time_s(&MotionBlock { step: 0, repeat: 0, motions }, &begins, &machine);
    let rapid = |axes: &[(Axis, f64)]| Motion::Rapid { to: position_from_mm_or_rad(axes) };
    let cases: [(Vec<Motion>, f64); 8] = [
        // 100 mm: 1 s and one ramp of 0.1 s.
        (vec![rapid(&[(Axis::X, 100.0)])], 1.1),
        // 2.5 mm never reaches full speed: 2·√(2.5/1000).
        (vec![rapid(&[(Axis::X, -2.5)])], 0.1),
        // 90° take 3 s and one ramp; X waits for C.
        (vec![rapid(&[(Axis::X, 10.0), (Axis::C, FRAC_PI_2)])], 3.1),
        // 50 mm of path at 10 mm/s; Y limits the path acceleration: 1000/0.8 mm/s².
        (
            vec![Motion::Guarded {
                to: position_from_mm_or_rad(&[(Axis::X, 30.0), (Axis::Y, 40.0)]),
                feed_mm_min: 600.0,
            }],
            5.0 + 10.0 / 1250.0,
        ),
        // Half of 2 mm at 0.5 mm/s towards contact, and back at 5 mm/s.
        (
            vec![
                Motion::Probe { to: position_from_mm_or_rad(&[(Axis::X, 2.0)]), feed_mm_min: 30.0 },
                Motion::BackOff { to: position_from_mm_or_rad(&[(Axis::X, 0.0)]), feed_mm_min: 300.0 },
            ],
            2.0 + 0.0005 + 0.2 + 0.005,
        ),
        (vec![Motion::Dwell { seconds: 2.5 }], 2.5),
        // S is unknown at first, then it turns 60°.
        (vec![Motion::OrientSpindle { s: 1.0 }, Motion::OrientSpindle { s: 1.0 + PI / 3.0 }], 2.1),
        (vec![rapid(&[(Axis::X, 0.0)])], 0.0),
    ];
    for (motions, expected) in cases {
        let actual = seconds(motions.clone());
        assert!((actual - expected).abs() < 1e-9, "{actual} s, not {expected} s: {motions:?}");
    }
}

#[test]
fn guarded_feed_too_fast_for_the_overtravel_is_refused() {
    // 100 mm/s against 1000 mm/s² is 5 mm, the overtravel 4 mm.
    let mut plan = cylinder_plan(vec![radial_touch_step(3, 0.0, 0.0, 0.0, 0.0)]);
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    plan.probe.guarded_feed_mm_min = 6000.0;
    let refused = touch_block(&plan, &plan.steps[0], 0, BlockStart::default(), &clearance).unwrap_err();
    assert!(
        matches!(refused, PlanningError::GuardedFeedTooFast { distance_mm, .. } if (distance_mm - 5.0).abs() < 1e-9)
    );
    plan.probe.guarded_feed_mm_min = 5000.0;
    touch_block(&plan, &plan.steps[0], 0, BlockStart::default(), &clearance).unwrap();
}

#[test]
fn scan_has_one_block_per_point_and_rises_to_top_only_when_necessary() {
    let sensor = serde_json::from_value(serde_json::json!({"name": "laser",
        "zero_mm": [0.0, 0.0, -150.0], "direction": [0.0, 0.0, -1.0], "range_mm": [-10.0, 10.0]}));
    let point = |x: f64, c: f64| {
        position_from_mm_or_rad(&[(Axis::X, x), (Axis::Y, 1.0), (Axis::Z, 260.0), (Axis::B, 0.0), (Axis::C, c)])
    };
    let scan = |id: u32, c: f64| Step {
        kind: StepKind::Scan,
        from: point(-1.0, c),
        to: point(1.0, c),
        feed_mm_min: 60.0,
        sensors: vec!["laser".into()],
        scan: Some(Scan {
            path: vec![point(-1.0, c), point(0.0, c), point(1.0, c)],
            sampling: Sampling::Dwell { dwell_s: 0.5, samples: 3 },
        }),
        ..radial_touch_step(id, 0.0, 0.0, 0.0, 0.0)
    };
    let mut plan = cylinder_plan(vec![scan(0, 0.0), scan(1, 0.0), scan(2, 1.0)]);
    plan.sensors = vec![sensor.unwrap()];
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    let (blocks, _) = plan_blocks_and_time_s(&plan, &clearance).unwrap();
    assert_eq!(blocks.iter().map(|block| block.step).collect::<Vec<_>>(), [0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2]);
    let scan = plan.steps[0].scan.as_ref().unwrap();
    assert_eq!([5, 3].map(|count| out_of_range_block_count(scan, count)), [2, 0]);
    let highest = |block: &MotionBlock| {
        let heights = block.motions.iter().filter_map(|motion| motion_target(motion)?.get(Axis::Z));
        heights.fold(f64::NEG_INFINITY, f64::max)
    };
    // The path leads to the upper end from an unknown position, and to turn C; otherwise 10 mm above the scan path.
    assert_eq!([0, 5, 8].map(|i| highest(&blocks[i])), [450.0, 270.0, 450.0]);
    let to_middle = [Motion::Feed { to: position_from_mm_or_rad(&[(Axis::X, 0.0)]), feed_mm_min: 60.0 }];
    let rest = [Motion::Dwell { seconds: 0.5 }];
    assert_eq!(blocks[3].motions, [&to_middle[..], &rest].concat());
    let mut broken = plan.clone();
    broken.steps[0].scan.as_mut().unwrap().path[1] = position_from_mm_or_rad(&[(Axis::X, 0.0)]);
    let refused = super::plan_blocks_and_time_s(&broken, &clearance).unwrap_err();
    assert!(matches!(refused, PlanningError::MissingAxisPosition { step: 0, .. }), "{refused}");
    let mut several = plan.clone();
    several.steps[0].sensors.push("probe".into());
    let refused = super::plan_blocks_and_time_s(&several, &clearance).unwrap_err();
    assert!(refused.to_string().contains("a name that no sensor"), "{refused}");
    plan.sensors.clear();
    let refused = super::plan_blocks_and_time_s(&plan, &clearance).unwrap_err();
    assert!(refused.to_string().contains("a name that no sensor"), "{refused}");
}

#[test]
fn an_axis_with_a_clamp_turns_at_feed_until_the_position_is_verified() {
    let mut plan = cylinder_plan(vec![radial_touch_step(0, 0.0, 0.0, 1.0, 0.0)]);
    let clamp = json!({"close": "M65 P3", "open": "M64 P3"});
    plan.machine.axes.get_mut(&Axis::C).unwrap().clamp = serde_json::from_value(clamp).unwrap();
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    let block = touch_block(&plan, &plan.steps[0], 0, BlockStart::default(), &clearance).unwrap();
    let turns = |motion: &&Motion| motion_target(motion).is_some_and(|to| to.get(Axis::C).is_some());
    let turn = block.motions.iter().find(turns);
    assert!(matches!(turn, Some(Motion::Feed { .. })), "{turn:?}");
    assert!(!block.motions.iter().any(|motion| matches!(motion, Motion::Rapid { .. })));
}

/// The part is 100 mm high. With Z at 283, the far end of the range, 180 mm below the spindle datum, is 3 mm above
/// the part, whose position is uncertain by `uncertainty_mm`.
#[test]
fn until_a_scan_verifies_the_descent_ends_where_nothing_is_within_range() {
    let of = |range_mm: [f64; 2]| {
        let step: Step = serde_json::from_value(serde_json::json!({
            "id": 0, "stage": 0, "kind": "scan", "label": "s", "feed_mm_min": 60.0, "sensor": "laser",
            "normal": [0.0, 0.0, 1.0],
            "from": {"X": 10.0, "Y": 1.0, "Z": 255.0, "B": 0.0, "C": 0.0},
            "to": {"X": 10.0, "Y": 1.0, "Z": 255.0, "B": 0.0, "C": 0.0},
            "path": [{"X": 10.0, "Y": 1.0, "Z": 255.0, "B": 0.0, "C": 0.0}],
            "dwell_s": 0.5, "samples": 3,
        }))
        .unwrap();
        let mut plan = cylinder_plan(vec![step]);
        plan.sensors = vec![
            serde_json::from_value(serde_json::json!({"name": "laser", "range_mm": range_mm,
                "zero_mm": [0.0, 0.0, -150.0], "direction": [0.0, 0.0, -1.0]}))
            .unwrap(),
        ];
        let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
        let uncertainty_mm = machine::artefact::max_misplacement_mm(&plan.artefact);
        (plan_blocks_and_time_s(&plan, &clearance).map(|(blocks, _)| blocks), uncertainty_mm)
    };
    let (blocks, uncertainty_mm) = of([-10.0, 30.0]);
    let blocks = blocks.unwrap();
    assert_eq!(blocks.len(), 3);
    let targets = |block: &MotionBlock| block.motions.iter().filter_map(motion_target).collect();
    let [up, down, first]: [Vec<Position>; 3] = [0, 1, 2].map(|number| targets(&blocks[number]));
    assert_eq!(up, [position_from_mm_or_rad(&[(Axis::Z, 450.0)])]);
    let low_z = down.last().unwrap().get_or_zero(Axis::Z);
    assert!((low_z - 283.0 - uncertainty_mm).abs() < 0.2, "{low_z}");
    assert_eq!(first, [position_from_mm_or_rad(&[(Axis::Z, 255.0)])]);
    // At this height, a hold after the first distance must stop the machine within the range of 0.4 mm.
    let feed = |blocks: &[MotionBlock]| match blocks[1].motions.last() {
        Some(Motion::Feed { feed_mm_min, .. }) => *feed_mm_min,
        other => panic!("{other:?}"),
    };
    let narrow = feed(&of([-0.2, 0.2]).0.unwrap());
    assert!(feed(&blocks) > 10.0 * narrow && narrow / 60.0 * 0.3 < 0.4, "{narrow}");
    // With the spindle at 450 mm, a range that ends 230 mm below the zero point, which is 150 mm below the datum,
    // reaches down to 70 mm.
    let refused = of([-10.0, 230.0]).0.unwrap_err();
    assert!(matches!(refused, PlanningError::BodyInSensorRangeAtTopOfZ { step: 0, .. }), "{refused}");
}

#[test]
fn continuous_scan_is_one_block_of_feeds_without_a_dwell() {
    let sensor = serde_json::json!({"name": "laser",
        "zero_mm": [0.0, 0.0, -150.0], "direction": [0.0, 0.0, -1.0], "range_mm": [-10.0, 10.0]});
    let point = |x: f64| {
        position_from_mm_or_rad(&[(Axis::X, x), (Axis::Y, 1.0), (Axis::Z, 260.0), (Axis::B, 0.0), (Axis::C, 0.0)])
    };
    let scan = |path: Vec<Position>, rate_hz| Step {
        kind: StepKind::Scan,
        from: path[0].clone(),
        to: path[path.len() - 1].clone(),
        feed_mm_min: 60.0,
        sensors: vec!["laser".into()],
        scan: Some(Scan { path, sampling: Sampling::Continuous { rate_hz, per_revolution: None } }),
        ..radial_touch_step(0, 0.0, 0.0, 0.0, 0.0)
    };
    let of = |path: &[f64], rate_hz| {
        let mut plan = cylinder_plan(vec![scan(path.iter().map(|x| point(*x)).collect(), rate_hz)]);
        plan.sensors = vec![serde_json::from_value(sensor.clone()).unwrap()];
        let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
        plan_blocks_and_time_s(&plan, &clearance).map(|(blocks, _)| blocks)
    };
    // The path passes its first point again, and stops there once.
    let found = of(&[-1.0, 1.0, -1.0, -1.0, -2.0], 1000.0).unwrap();
    assert_eq!(found.len(), 4, "motions: up, across and down, to the first point, scan");
    let way = |x: f64| Motion::Feed { to: position_from_mm_or_rad(&[(Axis::X, x)]), feed_mm_min: 60.0 };
    assert_eq!(found[3].motions, [way(1.0), way(-1.0), way(-2.0)]);
    let reason = |path: &[f64], rate| of(path, rate).unwrap_err().to_string();
    for path in [&[1.0][..], &[1.0, 1.0]] {
        assert!(reason(path, 1000.0).contains("a length above 0"), "{}", reason(path, 1000.0));
    }
    assert!(reason(&[1.0, 2.0], 0.0).contains("not a positive number"), "{}", reason(&[1.0, 2.0], 0.0));
    assert!(reason(&[1.0, 2.0], f64::NAN).contains("not a positive number"));
}

#[test]
fn prompts_after_motions_or_without_text_are_refused() {
    let prompt = |id: u32, text: Option<&str>| Step {
        kind: StepKind::Prompt,
        from: Position::new(),
        to: Position::new(),
        text: text.map(str::to_owned),
        ..radial_touch_step(id, 0.0, 0.0, 0.0, 0.0)
    };
    let moving = Step { from: position_from_mm_or_rad(&[(Axis::X, 1.0)]), ..prompt(4, Some("go")) };
    let plan = cylinder_plan(vec![
        prompt(0, Some("clean it")),
        radial_touch_step(1, 0.0, 0.0, 0.0, 0.0),
        prompt(2, Some(" ")),
        prompt(3, None),
        moving,
    ]);
    let (asked, moves) = split_prompts(&plan, &[0, 1]).unwrap();
    assert_eq!((asked[0].0.id, asked[0].1, moves), (0, "clean it", &[1][..]));
    let refused = |steps: &[u32]| split_prompts(&plan, steps).unwrap_err();
    assert_eq!(refused(&[1, 0]), PlanningError::PromptAfterMotion { step: 0 });
    for step in 2..5 {
        assert!(matches!(refused(&[step]), PlanningError::InvalidPrompt { step: bad, .. } if bad == step));
    }
    // A prompt contains no axes: the path to the first touch begins at an unknown position.
    let stage = Stage { id: 0, name: String::new(), repeat: 0, steps: vec![0, 1], found: None };
    let (blocks, _) = plan_blocks_and_time_s_by_stage(&plan, &[stage]).unwrap();
    assert_eq!(blocks.iter().map(|block| block.step).collect::<Vec<_>>(), [1]);
}

/// Sensors about a part that turns: X, Y and Z do not move, unless another axis has to turn.
#[test]
fn rotary_scan_begins_in_place_and_other_axes_turn_at_the_top_of_z() {
    let point = |c: f64| {
        position_from_mm_or_rad(&[(Axis::X, 0.0), (Axis::Y, 0.0), (Axis::Z, 260.0), (Axis::B, 0.0), (Axis::C, c)])
    };
    let step = Step {
        kind: StepKind::Scan,
        from: point(0.0),
        to: point(1.0),
        feed_mm_min: 60.0,
        sensors: vec!["x1".into()],
        scan: Some(Scan {
            path: vec![point(0.0), point(1.0)],
            sampling: Sampling::Continuous { rate_hz: 100.0, per_revolution: None },
        }),
        ..radial_touch_step(0, 0.0, 0.0, 0.0, 0.0)
    };
    let mut plan = cylinder_plan(vec![step]);
    let sensor = serde_json::json!({"name": "x1", "mount": "bed", "zero_mm": [50.0, 0.0, 60.0],
        "direction": [-1.0, 0.0, 0.0], "range_mm": [-0.3, 0.3]});
    plan.sensors = vec![serde_json::from_value(sensor).unwrap()];
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    let from = |position: Position| {
        let start = BlockStart { position: Some(&position), touched_directions: TouchedDirections::default() };
        let blocks = step_blocks(&plan, &plan.steps[0], 0, start, &clearance).unwrap();
        blocks.into_iter().flat_map(|block| block.motions).collect::<Vec<_>>()
    };
    let turn = Motion::Feed { to: position_from_mm_or_rad(&[(Axis::C, 1.0)]), feed_mm_min: 60.0 };
    assert_eq!(from(point(0.0)), std::slice::from_ref(&turn));
    let elsewhere = from(point(0.5));
    assert!(
        matches!(&elsewhere[..], [Motion::Feed { to, .. }, last] if *to == position_from_mm_or_rad(&[(Axis::C, 0.0)]) && *last == turn)
    );
    let tilted = from(point(0.0).with(Axis::B, 0.3));
    let ways: Vec<Position> = tilted.iter().filter_map(motion_target).collect();
    let tilts = ways.iter().position(|to| to.get(Axis::B).is_some()).unwrap();
    assert_eq!(ways[tilts - 1], position_from_mm_or_rad(&[(Axis::Z, 450.0)]), "{ways:?}");
}
