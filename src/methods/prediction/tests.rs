//! Against the machine of paper 4 as plain matrix products.

use nalgebra::Vector3;

use super::{Predictor, WorkpieceFrame};
use crate::samba::tests::htm::{Triple, Truth};
use crate::samba::tests::{built_in, exact_estimate, paper_errors};
use machine::record::estimate::Estimate;
use machine::record::machine::Machine;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use machine::{Axis, Position};

const POSES: [([f64; 3], Triple); 4] = [
    ([120.0, -80.0, 400.0], [0.0, 0.0, 0.0]),
    ([-200.0, 150.0, 500.0], [0.7, 2.0, 0.0]),
    ([50.0, 60.0, 330.0], [-1.2, -3.0, 1.5]),
    ([0.0, 0.0, 326.7], [1.5, 0.5, 0.0]),
];

fn machine() -> Machine {
    built_in::plan().machine
}

fn position(xyz: [f64; 3], [b, c, s]: Triple) -> Position {
    Position::from_xyz(Vector3::from(xyz)).with(Axis::B, b).with(Axis::C, c).with(Axis::S, s)
}

fn measured() -> Estimate {
    let mut estimate = exact_estimate();
    estimate.measured = [(Axis::B, [-90.0, 90.0]), (Axis::X, [-300.0, 300.0])].into();
    estimate
}

#[test]
fn errors_are_those_of_the_matrix_products() {
    let (machine, estimate) = (machine(), measured());
    let tool = Vector3::from(machine.tool_mm);
    let truth = Truth { errors: paper_errors().into_iter().collect(), tool };
    let nominal = Truth { errors: Default::default(), tool };
    let off = |xyz: [f64; 3], triple| {
        truth.tip(Vector3::from(xyz), triple) - nominal.tip(Vector3::from(xyz), triple)
    };
    let along = Vector3::z() * 100.0;
    let direction = |xyz: [f64; 3], triple| {
        let of = |of: &Truth| {
            let above = Truth { errors: of.errors.clone(), tool: tool + along };
            let xyz = Vector3::from(xyz);
            (above.tip(xyz, triple) - of.tip(xyz, triple)) / along.norm()
        };
        of(&truth) - of(&nominal)
    };
    // The tip on the origin of the table.
    let zero = ([0.0, 0.0, -machine.tool_mm[2]], [0.0; 3]);
    let predictor = Predictor::new(&machine, &estimate, None).unwrap();
    for (xyz, triple) in POSES {
        let predicted = predictor.at(&position(xyz, triple));
        let expected = off(xyz, triple) - off(zero.0, zero.1);
        assert!((predicted.tip_mm - expected).norm() < 1e-9, "{predicted:?} {expected}");
        assert!((predicted.direction - direction(xyz, triple)).norm() < 1e-9);
    }
    let elsewhere = position(POSES[1].0, POSES[1].1);
    let predictor = Predictor::new(&machine, &estimate, Some(&elsewhere)).unwrap();
    assert!(predictor.at(&elsewhere).tip_mm.norm() < 1e-12);
}

/// An offset of C along X: zeroed at C = 0, it is twice itself at C = 180°, and as much along X as along Y at 90°.
#[test]
fn uncertainty_is_zeroed_too() {
    let mut estimate = measured();
    let of =
        |symbol: &str| estimate.covariance.symbols.iter().position(|own| own == symbol).unwrap();
    let (offset, angle) = (of("EX0C"), of("EA0Y"));
    estimate.covariance.rows[offset][offset] = 4.0;
    let mut predictor = Predictor::new(&machine(), &estimate, None).unwrap();
    let u = |c: f64, predictor: &Predictor<'_>| {
        predictor.at(&position([30.0, 20.0, 400.0], [0.0, c, 0.0])).u_tip_mm * 1e3
    };
    let near = |u: Vector3<f64>, expected: [f64; 3]| {
        assert!((u - Vector3::from(expected)).norm() < 0.01, "{u} {expected:?}");
    };
    near(u(0.0, &predictor), [0.0, 0.0, 0.0]);
    near(u(std::f64::consts::PI, &predictor), [4.0, 0.0, 0.0]);
    near(u(std::f64::consts::FRAC_PI_2, &predictor), [2.0, 2.0, 0.0]);
    // 3 µrad about X: of the direction it is all along Y.
    estimate.covariance.rows[offset][offset] = 0.0;
    estimate.covariance.rows[angle][angle] = 9.0;
    predictor = Predictor::new(&machine(), &estimate, None).unwrap();
    let pose = predictor.at(&position([0.0, 0.0, 400.0], [0.0; 3]));
    near(pose.u_direction * 1e6, [0.0, 3.0, 0.0]);
}

#[test]
fn what_was_not_measured_is_refused() {
    let (machine, mut estimate) = (machine(), measured());
    let predictor = Predictor::new(&machine, &estimate, None).unwrap();
    assert!(predictor.check(&position([250.0, 0.0, 0.0], [1.0, 0.0, 0.0])).is_ok());
    let why = predictor.check(&position([350.0, 0.0, 0.0], [0.0; 3])).unwrap_err().why;
    assert!(why.contains("X 350.000 is outside -300.000 to 300.000"), "{why}");
    // An axis that the pose does not name stands at 0.
    estimate.measured.insert(Axis::Z, [300.0, 500.0]);
    let predictor = Predictor::new(&machine, &estimate, None).unwrap();
    let why = predictor.check(&Position::new().with(Axis::X, 1.0)).unwrap_err().why;
    assert!(why.contains("Z 0.000 is outside 300.000 to 500.000"), "{why}");
    estimate.measured.clear();
    let predictor = Predictor::new(&machine, &estimate, None).unwrap();
    assert!(predictor.check(&Position::new()).unwrap_err().why.contains("does not say"));
    estimate.parameters.clear();
    assert!(Predictor::new(&machine, &estimate, None).is_err());
}

/// A touch where the machine of the paper reads with its stylus at a known place of the table.
#[test]
fn touches_are_points_of_the_workpiece() {
    let (plan, mut estimate) = (built_in::plan(), measured());
    let tool = Vector3::from(plan.machine.tool_mm);
    let truth = Truth { errors: paper_errors().into_iter().collect(), tool };
    let place = Vector3::new(110.0, -70.0, 90.0);
    let (_, triple) = POSES[1];
    let reading = Reading {
        step: 1,
        repeat: 0,
        position: position(truth.axes_at(place, triple).into(), triple),
        value_mm: None,
        sensor: "probe".to_owned(),
        t_s: 0.0,
        flag: Default::default(),
        temperatures_c: Default::default(),
    };
    let point = |plan: &Plan, estimate: Option<&Estimate>| {
        WorkpieceFrame::new(plan, estimate).unwrap().point(&reading).unwrap()
    };
    let calibrated = point(&plan, Some(&estimate));
    assert!((calibrated.at_mm - place).norm() < 1e-9, "{calibrated:?}");
    // Of the touch alone: 0.5 µm, as the machine file declares.
    assert!((calibrated.u_mm - Vector3::repeat(0.5e-3)).norm() < 1e-9);
    let nominal = point(&plan, None);
    let off = (nominal.at_mm - place).norm();
    assert!(off > 0.02 && off < 0.3 && nominal.u_mm == calibrated.u_mm, "{off}");
    let offset = estimate.covariance.symbols.iter().position(|own| own == "EX0C").unwrap();
    estimate.covariance.rows[offset][offset] = 4.0;
    // 2 µm along X of the table at C = 114.6°.
    let u = point(&plan, Some(&estimate)).u_mm * 1e3;
    let expected = Vector3::new(2.0 * triple[1].cos(), 2.0 * triple[1].sin(), 0.0);
    assert!((u - expected.map(|part: f64| part.hypot(0.5))).norm() < 0.01, "{u} {expected}");
}

/// Of an offset e of C along X alone: with the work zero at C = 0 the error is 2·e·sin(C/2), largest at 180°.
#[test]
fn the_volume_has_a_largest_and_a_mean_error() {
    let mut estimate = measured();
    estimate.parameters.retain(|parameter| parameter.symbol == "EX0C");
    estimate.covariance.symbols = vec!["EX0C".to_owned()];
    estimate.covariance.rows = vec![vec![4.0]];
    estimate.measured = [(Axis::C, [0.0, 330.0]), (Axis::Z, [400.0, 400.0])].into();
    let predictor = Predictor::new(&machine(), &estimate, None).unwrap();
    let poses = predictor.volume().unwrap();
    assert_eq!(poses.len(), 12);
    let [zeroed, fitted] = predictor.volume_errors(&poses);
    assert_eq!(poses[zeroed.worst].at(Axis::C).to_degrees().round(), 180.0);
    let near = |value: f64, expected: f64, within: f64| {
        assert!((value - expected).abs() < within, "{value} {expected}");
    };
    near(zeroed.largest_mm, 0.210, 1e-9);
    // Its u is twice 2 µm, to the number of draws.
    near(zeroed.u_largest_mm, 4e-3, 0.6e-3);
    let mean = (0..12).map(|k| 0.21 * (f64::from(k) * 15.0).to_radians().sin()).sum::<f64>() / 12.0;
    near(zeroed.mean_mm, mean, 1e-9);
    assert!(fitted.largest_mm < zeroed.largest_mm);
}
