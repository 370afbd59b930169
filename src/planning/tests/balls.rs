//! Balls: accessible touches, their positions, the evaluation of readings, and the order of balls.

use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};

use super::position_from_mm_or_rad;
use crate::*;
use machine::kinematics::KinematicChain;
use machine::record::artefact::{Artefact, Ball};
use machine::record::plan::{Plan, Step, StepKind};
use machine::{Axis, Position, frame::Point};

const MEASURE_MODE: BallTouchMode = BallTouchMode::Measure { standoff_mm: 0.5, search_mm: 1.0 };

fn ball_json(id: &str, centre: [f64; 3], stem: [f64; 3]) -> Value {
    json!({"id": id, "centre_mm": centre, "radius_mm": 10.0, "stem": stem,
        "stem_radius_mm": 3.0, "stem_length_mm": 60.0})
}

/// Stylus 150 mm long, 1.5 mm in radius, with a ball of 3 mm radius; above it a probe body of 20 mm radius.
fn balls_plan(topology: &str, balls: &[Value]) -> Plan {
    let linear = json!({"min": -300.0, "max": 300.0, "rapid_per_min": 6000.0});
    let height = json!({"min": -100.0, "max": 500.0, "rapid_per_min": 6000.0});
    let rotary = json!({"min": -360.0, "max": 360.0, "rapid_per_min": 3600.0});
    let mut axes = json!({"X": linear, "Y": linear, "Z": height});
    for axis in ["A", "B", "C", "S"].into_iter().filter(|axis| topology.contains(axis)) {
        axes[axis] = rotary.clone();
    }
    serde_json::from_value(json!({
        "trued_plan": 1, "method": "test", "settings": {},
        "machine": {"name": "test", "topology": topology, "tool_mm": [1.0, -2.0, -220.0], "axes": axes},
        "probe": {"ball_radius_mm": 3.0, "stem_radius_mm": 1.5, "stem_length_mm": 150.0,
            "body_radius_mm": 20.0, "body_length_mm": 70.0},
        "artefact": {"kind": "balls", "balls": balls, "uncertainty_mm": 0.5},
    }))
    .unwrap()
}

const ROTARY_TABLE_TOPOLOGY: &str = "w-C-B-X-F-Z-Y-S-t";

fn position_from_mm_or_deg(axes: &[(Axis, f64)]) -> Position {
    axes.iter().map(|(axis, degrees)| (*axis, axis.to_mm_or_rad(*degrees))).collect()
}

fn rotary_position_from_deg(b: f64, c: f64) -> Position {
    position_from_mm_or_deg(&[(Axis::B, b), (Axis::C, c), (Axis::S, 90.0)])
}

fn first_ball(plan: &Plan) -> Ball {
    match &plan.artefact {
        Artefact::Balls(balls) => balls.balls[0].clone(),
        _ => unreachable!(),
    }
}

fn accessible_touches_of_first_ball(
    plan: &Plan,
    rotary: &Position,
    count: usize,
) -> Result<Vec<TouchDirection>, BallAccessError> {
    let access = TouchAccess::new(plan, &plan.artefact).unwrap();
    let request =
        BallMeasurementRequest { ball: &first_ball(plan), rotary, touch_mode: MEASURE_MODE, touch_count: count };
    access.accessible_touches(&request)
}

fn touch_steps_of_first_ball(
    plan: &Plan,
    rotary: &Position,
    mode: BallTouchMode,
) -> Result<Vec<Step>, BallAccessError> {
    let access = TouchAccess::new(plan, &plan.artefact).unwrap();
    let request = BallMeasurementRequest { ball: &first_ball(plan), rotary, touch_mode: mode, touch_count: 5 };
    access.touch_steps(&request, &plan.probe, StepKind::Touch, |touch| format!("slow/{touch}"))
}

/// Paper 4, section 3: +45, −135, −45, +135 degrees, then the pole; here in the order of neighbours.
#[test]
fn paper_five_touches_around_the_ball_and_at_its_pole() {
    let plan = balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("1", [80.0, -50.0, 90.0], [0.0, 0.0, -1.0])]);
    for (b, c) in [(0.0, 0.0), (30.0, 90.0), (-60.0, 270.0)] {
        let rotary = rotary_position_from_deg(b, c);
        let steps = touch_steps_of_first_ball(&plan, &rotary, MEASURE_MODE).unwrap();
        let names: Vec<&str> = steps.iter().map(|step| step.label.as_str()).collect();
        assert_eq!(names, ["slow/+45", "slow/+135", "slow/-135", "slow/-45", "slow/pole"]);
        assert_eq!(steps.iter().map(|step| step.id).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
        let h = 0.5_f64.sqrt();
        let meant = [[h, h, 0.0], [-h, h, 0.0], [-h, -h, 0.0], [h, -h, 0.0], [0.0, 0.0, 1.0]];
        // Position of the stylus ball by the chain: 13 mm plus 0.5 or minus 1 mm from the centre.
        let chain = KinematicChain::new(&plan.machine).unwrap();
        let tip = Point::new(1.0, -2.0, -220.0);
        for (step, normal) in steps.iter().zip(meant) {
            assert!((Vector3::from(step.normal) - Vector3::from(normal)).norm() < 1e-12);
            for (place, far) in [(&step.from, 13.5), (&step.to, 12.0)] {
                let off = chain.tip_in_table(place, tip, &[]).mm - Vector3::new(80.0, -50.0, 90.0);
                let table = chain.machine_from_table(place, &[]).rotation;
                let off = table * off - Vector3::from(normal) * far;
                assert!(off.norm() < 1e-6, "{}: {off}", step.label);
            }
        }
    }
}

#[test]
fn touch_blocked_by_the_stem_is_moved_or_refused() {
    let centre = [0.0, 0.0, 100.0];
    let with_stem = |stem: [f64; 3]| balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("1", centre, stem)]);
    // The stem is horizontal and below the stylus at +45°: only that touch is moved.
    let found =
        accessible_touches_of_first_ball(&with_stem([1.0, 1.0, 0.0]), &rotary_position_from_deg(0.0, 0.0), 5).unwrap();
    let h = 0.5_f64.sqrt();
    for (contact, normal) in found.iter().zip([[h, h, 0.0], [-h, h, 0.0], [-h, -h, 0.0], [h, -h, 0.0]]) {
        let moved = (contact.normal - Vector3::from(normal)).norm() > 1e-9;
        assert_eq!(moved, contact.name == "+45", "{contact:?}");
    }
    assert_eq!(found.len(), 5);
    // The stem is above the ball: the pole is not accessible.
    let above = accessible_touches_of_first_ball(&with_stem([0.0, 0.0, 1.0]), &rotary_position_from_deg(0.0, 0.0), 5)
        .unwrap_err();
    let (touch, obstacle) = ("pole".to_owned(), "stem of ball 1".to_owned());
    assert_eq!(above, BallAccessError::ObstacleTooNear { touch, tool: "stylus ball".to_owned(), obstacle });
    // The same stem, turned below the ball.
    assert_eq!(
        accessible_touches_of_first_ball(&with_stem([0.0, 0.0, 1.0]), &rotary_position_from_deg(180.0, 0.0), 5)
            .unwrap()
            .len(),
        5
    );
}

#[test]
fn ball_at_the_probe_body_or_above_the_target_blocks_the_touch() {
    let down = [0.0, 0.0, -1.0];
    let pair = |x: f64, z: f64| {
        balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("1", [0.0, 0.0, 50.0], down), ball_json("2", [x, 0.0, z], down)])
    };
    let refused = |plan: &Plan, b: f64| {
        accessible_touches_of_first_ball(plan, &rotary_position_from_deg(b, 0.0), 5).unwrap_err().to_string()
    };
    // The probe body begins 150 mm above the stylus ball and is 20 mm in radius.
    assert!(accessible_touches_of_first_ball(&pair(30.0, 180.0), &rotary_position_from_deg(0.0, 0.0), 5).is_ok());
    let body = refused(&pair(30.0, 210.0), 0.0);
    assert!(body.contains("probe body") && body.contains("ball 2"), "{body}");
    assert!(accessible_touches_of_first_ball(&pair(60.0, 210.0), &rotary_position_from_deg(0.0, 0.0), 5).is_ok());
    // Tilted by 90° in one of the two senses, the other ball is above the ball.
    let above = [-90.0, 90.0]
        .map(|b| accessible_touches_of_first_ball(&pair(60.0, 50.0), &rotary_position_from_deg(b, 0.0), 5).is_err());
    assert!(above[0] != above[1], "{above:?}");
}

#[test]
fn unreachable_balls_are_refused_with_their_reason() {
    let stem = [0.0, 0.0, -1.0];
    let far = balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("1", [300.0, 0.0, 50.0], stem)]);
    let error = accessible_touches_of_first_ball(&far, &rotary_position_from_deg(0.0, 0.0), 5).unwrap_err();
    assert!(matches!(error, BallAccessError::TooFewTouches { free: 3, .. }), "{error}");
    let low = balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("1", [0.0, 0.0, -335.0], stem)]);
    let error = accessible_touches_of_first_ball(&low, &rotary_position_from_deg(0.0, 0.0), 5).unwrap_err();
    assert!(matches!(error, BallAccessError::OutOfTravel { axis: Axis::Z, .. }), "{error}");
    let near = balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("1", [0.0, 0.0, 50.0], stem)]);
    let error = accessible_touches_of_first_ball(&near, &rotary_position_from_deg(400.0, 0.0), 5).unwrap_err();
    assert!(matches!(error, BallAccessError::OutOfTravel { axis: Axis::B, .. }), "{error}");
    let error = accessible_touches_of_first_ball(&near, &position_from_mm_or_deg(&[(Axis::B, 0.0)]), 5).unwrap_err();
    assert_eq!(error, BallAccessError::MissingAxisPosition { axis: Axis::C });
    let wide = BallTouchMode::Search { uncertainty_mm: 2.0, standoff_mm: 0.5 };
    let error = touch_steps_of_first_ball(&near, &rotary_position_from_deg(0.0, 0.0), wide).unwrap_err();
    assert!(matches!(error, BallAccessError::SearchTooLong { overtravel: 4.0, .. }), "{error}");
    // The artefact may be 0.5 mm off its position.
    let short = BallTouchMode::Measure { standoff_mm: 0.5, search_mm: 0.4 };
    let error = touch_steps_of_first_ball(&near, &rotary_position_from_deg(0.0, 0.0), short).unwrap_err();
    assert_eq!(error, BallAccessError::SearchTooShort { beyond_mm: 0.4, uncertainty_mm: 0.5 });
}

/// B in the head: balls are touched only with an upright spindle.
#[test]
fn a_tilted_spindle_is_refused() {
    let head = balls_plan("w-A-F-X-Y-Z-B-t", &[ball_json("1", [0.0, 0.0, 50.0], [0.0, 0.0, -1.0])]);
    let indexed = |a, b| position_from_mm_or_deg(&[(Axis::A, a), (Axis::B, b)]);
    assert_eq!(accessible_touches_of_first_ball(&head, &indexed(30.0, 0.0), 5).unwrap().len(), 5);
    assert_eq!(
        accessible_touches_of_first_ball(&head, &indexed(0.0, 30.0), 5).unwrap_err(),
        BallAccessError::SpindleTilted
    );
    let mut tilted = touch_steps_of_first_ball(&head, &indexed(0.0, 0.0), MEASURE_MODE).unwrap().remove(0);
    for place in [&mut tilted.from, &mut tilted.to] {
        place.set(Axis::B, 0.5);
    }
    let clearance = SafeHeights::above_plan_artefact(&head).unwrap();
    let refused = touch_block(&head, &tilted, 0, BlockStart::default(), &clearance).unwrap_err();
    assert_eq!(refused, PlanningError::SpindleTilted { step: 0 });
}

#[test]
fn fifteen_touches_are_spread_over_the_accessible_surface() {
    let plan = balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("1", [0.0, 0.0, 100.0], [1.0, 1.0, 0.0])]);
    let found = accessible_touches_of_first_ball(&plan, &rotary_position_from_deg(0.0, 0.0), 15).unwrap();
    assert_eq!(found.len(), 15);
    let stem = Vector3::new(0.5_f64.sqrt(), 0.5_f64.sqrt(), 0.0);
    for (i, one) in found.iter().enumerate() {
        assert!(one.normal.angle(&stem) > 0.4, "{one:?} in the stem");
        for other in &found[..i] {
            let apart = one.normal.angle(&other.normal).to_degrees();
            assert!(apart > 20.0 && one.name != other.name, "{one:?} {other:?}");
        }
    }
}

/// Axis positions with the stylus ball in contact with the ball, by the nominal machine; the first is displaced by
/// `off`.
fn contact_positions(plan: &Plan, rotary: &Position, off: f64) -> Vec<Position> {
    let chain = KinematicChain::new(&plan.machine).unwrap();
    let found = accessible_touches_of_first_ball(plan, rotary, 5).unwrap();
    let centre = Vector3::from(first_ball(plan).centre_mm);
    let place = |(i, contact): (usize, &TouchDirection)| {
        let far = 13.0 + if i == 0 { off } else { 0.0 };
        let table = chain.machine_from_table(rotary, &[]).rotation.inverse();
        let target = Point::from_vec(centre + table * contact.normal * far);
        let tip = Point::new(1.0, -2.0, -220.0);
        rotary.updated_by(&chain.solve_linear_axes(target, tip, rotary, &[]).unwrap())
    };
    found.iter().enumerate().map(place).collect()
}

#[test]
fn exact_touches_give_the_centre_its_covariance_and_the_diameter() {
    let plan = balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("3", [80.0, -50.0, 90.0], [0.0, 0.0, -1.0])]);
    let rotary = rotary_position_from_deg(-30.0, 90.0);
    let measured = evaluate_ball("3", &contact_positions(&plan, &rotary, 0.0), &plan.machine, &plan.probe).unwrap();
    let access = TouchAccess::new(&plan, &plan.artefact).unwrap();
    let centre = access.axis_positions_at_ball_centre(&first_ball(&plan), &rotary).unwrap();
    for axis in Axis::LINEAR {
        assert!((measured.axis_positions_at_centre.get_or_zero(axis) - centre.get_or_zero(axis)).abs() < 1e-9);
    }
    assert!((measured.diameter_mm - 20.0).abs() < 1e-9 && measured.form_mm < 1e-9);
    // Four touches on the equator, 45° from X and Y, give 1/2 in X and Y and 1/4 for the radius; the pole adds 1 in
    // Z.
    let off = measured.axis_position_cofactor - Matrix3::from_diagonal(&Vector3::new(0.5, 0.5, 1.25));
    assert!(off.abs().max() < 1e-6, "{}", measured.axis_position_cofactor);
    measured
        .check_form_and_diameter("3", 20.0, &BallLimits { max_form_mm: 1e-6, max_diameter_deviation_mm: 1e-6 })
        .unwrap();
}

#[test]
fn errors_of_form_and_diameter_name_their_causes() {
    let plan = balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("3", [80.0, -50.0, 90.0], [0.0, 0.0, -1.0])]);
    let rotary = rotary_position_from_deg(-30.0, 90.0);
    let dirty = evaluate_ball("3", &contact_positions(&plan, &rotary, 0.1), &plan.machine, &plan.probe).unwrap();
    let limits = BallLimits { max_form_mm: 0.015, max_diameter_deviation_mm: 0.2 };
    let words = dirty.check_form_and_diameter("3", 20.0, &limits).unwrap_err().to_string();
    assert!(words.starts_with("ball 3 at B −30°, C 90°, S 90°: the form deviation 0.0"), "{words}");
    assert!(words.ends_with("a loose ball or a wrong stylus"), "{words}");
    let limits = BallLimits { max_form_mm: 0.2, max_diameter_deviation_mm: 0.01 };
    let words = dirty.check_form_and_diameter("3", 20.5, &limits).unwrap_err().to_string();
    assert!(words.contains("the expected 20.500 mm by more than 0.010 mm"), "{words}");
    let few = contact_positions(&plan, &rotary, 0.0)[..3].to_vec();
    let refused = evaluate_ball("3", &few, &plan.machine, &plan.probe).unwrap_err().to_string();
    assert!(refused.contains("ball 3 at B −30°") && refused.contains("four points"), "{refused}");
}

/// Compares with all orders of seven places.
#[test]
fn the_order_of_seven_balls_is_the_best_of_all_5040() {
    let machine = balls_plan(ROTARY_TABLE_TOPOLOGY, &[]).machine;
    let xy = [[0.0, 0.0], [90.0, 10.0], [20.0, 80.0], [-70.0, 40.0], [60.0, -90.0], [-40.0, -60.0], [5.0, 55.0]];
    let places: Vec<Position> =
        xy.iter().map(|[x, y]| position_from_mm_or_rad(&[(Axis::X, *x), (Axis::Y, *y)])).collect();
    let found = TravelTimes::from_xy_positions(&places, None, &machine).visiting_order(1);
    let seconds = |order: &[usize]| -> f64 {
        let pairs = order.windows(2);
        pairs.map(|pair| machine_time::motion_time_s(&places[pair[0]], &places[pair[1]], None, &machine)).sum()
    };
    let mut best = f64::INFINITY;
    for_each_permutation(&mut (0..7).collect(), 0, &mut |order| best = best.min(seconds(order)));
    assert!((seconds(&found) - best).abs() < 1e-9, "{found:?}");
    // The same from a given start position, which is not one of the places.
    let position = position_from_mm_or_rad(&[(Axis::X, -90.0), (Axis::Y, 90.0)]);
    let found = TravelTimes::from_xy_positions(&places, Some(&position), &machine).visiting_order(1);
    let begin = |order: &[usize]| machine_time::motion_time_s(&position, &places[order[0]], None, &machine);
    let mut best = f64::INFINITY;
    for_each_permutation(&mut (0..7).collect(), 0, &mut |order| best = best.min(begin(order) + seconds(order)));
    assert!((begin(&found) + seconds(&found) - best).abs() < 1e-9, "{found:?}");
}

fn for_each_permutation(order: &mut Vec<usize>, from: usize, see: &mut impl FnMut(&[usize])) {
    if from == order.len() {
        return see(order);
    }
    for k in from..order.len() {
        order.swap(from, k);
        for_each_permutation(order, from + 1, see);
        order.swap(from, k);
    }
}

/// Motions of the five touches of one ball in sequence: the stylus ball's centre at both ends of each motion,
/// relative to the ball's centre in machine directions.
fn motions_relative_to_first_ball(plan: &Plan, rotary: &Position) -> Vec<(bool, [Vector3<f64>; 2])> {
    let mut plan = plan.clone();
    if let Artefact::Balls(balls) = &mut plan.artefact {
        balls.uncertainty_mm = 0.25;
    }
    plan.steps = touch_steps_of_first_ball(&plan, rotary, MEASURE_MODE).unwrap();
    let clearance = SafeHeights::above_plan_artefact(&plan).unwrap();
    let chain = KinematicChain::new(&plan.machine).unwrap();
    let centre = Vector3::from(first_ball(&plan).centre_mm);
    let off = |at: &Position| {
        let tip = chain.tip_in_table(at, Point::new(1.0, -2.0, -220.0), &[]).mm;
        chain.machine_from_table(at, &[]).rotation * (tip - centre)
    };
    let mut blocks: Vec<MotionBlock> = Vec::new();
    for step in &plan.steps {
        let motions = blocks.iter().flat_map(|block| &block.motions);
        let position = Some(position_after_motions(motions, &Position::new())).filter(|_| !blocks.is_empty());
        let start = BlockStart { position: position.as_ref(), touched_directions: TouchedDirections::all() };
        blocks.push(touch_block(&plan, step, 0, start, &clearance).unwrap());
    }
    let mut position = position_after_motions(&blocks[0].motions, &Position::new());
    let mut ways = Vec::new();
    for motion in blocks[1..].iter().flat_map(|block| &block.motions) {
        let next = position.updated_by(&motion_target(motion).unwrap());
        let guarded = matches!(motion, Motion::Guarded { .. });
        assert!(guarded || matches!(motion, Motion::Probe { .. } | Motion::BackOff { .. }));
        ways.push((guarded, [off(&position), off(&next)]));
        position = next;
    }
    ways
}

#[test]
fn path_between_touches_leads_around_the_ball_or_over_a_blocking_stem() {
    let centre = [80.0, -50.0, 90.0];
    let free = balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("1", centre, [0.0, 0.0, -1.0])]);
    // The distance between the centres is 13 mm in contact, plus 0.5 mm standoff; the ball may be 0.25 mm off.
    for (b, c) in [(0.0, 0.0), (20.0, 90.0), (-20.0, 180.0)] {
        let ways = motions_relative_to_first_ball(&free, &rotary_position_from_deg(b, c));
        let highest = ways.iter().flat_map(|(_, way)| way).map(|off| off.z).fold(0.0, f64::max);
        assert!(highest < 13.0 + 0.25 + 3.1, "{highest}");
        for (_, way) in ways.iter().filter(|(guarded, _)| *guarded) {
            for k in 0..=100 {
                let off = way[0].lerp(&way[1], f64::from(k) / 100.0);
                assert!(off.norm() > 13.5 - 1e-3, "{off} on {way:?}");
            }
        }
        // Between the four touches at one height: two moves to each, and one away from the ball.
        let level = |way: &[Vector3<f64>; 2]| way.iter().all(|off| off.z.abs() < 1e-6);
        let legs = ways.iter().filter(|(guarded, way)| *guarded && level(way)).count();
        assert_eq!(legs, 3 * 3, "{ways:?}");
    }
    // The stem is between the second touch and the third.
    let blocked = balls_plan(ROTARY_TABLE_TOPOLOGY, &[ball_json("1", centre, [-1.0, 0.0, 0.0])]);
    let over = motions_relative_to_first_ball(&blocked, &rotary_position_from_deg(0.0, 0.0));
    let behind = over.iter().filter(|(_, way)| way.iter().all(|off| off.x < -1.0));
    let highest = behind.map(|(_, way)| way[0].z.max(way[1].z)).fold(0.0, f64::max);
    assert!(highest > 3.0 + 3.0, "{highest}");
}
