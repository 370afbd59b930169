//! Gate G4 of METHODS section 4, on the built-in designs and on the paper's counts. The measurements are
//! computed by plain matrix products.

use faer::Mat;
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};

use super::built_in::{ALL_DESIGNS, D_OPTIMAL_DESIGN, design_measurements};
use super::reference_machine::{BcsAnglesRad, ReferenceMachine};
use super::{BAR_LENGTH_MM, PAPER_TOOL_TIP_MM, machine, paper_ball_centres, paper_errors, true_ball_centres};
use crate::samba::fit::{GeometryProblem, LengthConstraint, ObservedValues, PlannedBallMeasurement};
use crate::samba::geometry_model::GeometryModel;
use crate::samba::geometry_solution::{describe_undetermined, unknown_names};
use crate::samba::settings::{DesignKind, OptimalityCriterion};
use estimation::linear_least_squares::RankAnalysis;
use estimation::null_space_names::name_null_space;
use estimation::random::seeded_stream;
use estimation::schur::factorise_and_project_right_side;
use machine::record::artefact::{Ball, Balls};
use machine::{Axis, Position};
use testing::population::{population_size, sd_ratio_bounds};

/// Standard deviation of each coordinate of a measurement, and standard uncertainty of the bar, mm.
const COORDINATE_NOISE_STD_MM: f64 = 1e-3;
const BAR_STD_U_MM: f64 = 1e-4;

fn reference_machine() -> ReferenceMachine {
    ReferenceMachine { errors: paper_errors().into_iter().collect(), tool: PAPER_TOOL_TIP_MM }
}

fn paper_model() -> GeometryModel {
    let parameters: Vec<_> = paper_errors().iter().map(|(name, _)| name.parse().unwrap()).collect();
    GeometryModel::new(&machine("wCBXFZYSt"), &parameters).unwrap()
}

fn rotary_position([b, c, s]: BcsAnglesRad) -> Position {
    Position::new().with(Axis::B, b).with(Axis::C, c).with(Axis::S, s)
}

type DesignAndCriterion = (DesignKind, OptimalityCriterion);

/// A design measured on the machine of the paper's table 2, with and without bar and spindle orientation.
fn simulate_design_measurement(
    kind: DesignAndCriterion,
    has_bar: bool,
    orients_spindle: bool,
) -> (GeometryProblem, ObservedValues) {
    let balls = true_ball_centres();
    let visits: Vec<(BcsAnglesRad, usize)> = design_measurements(kind)
        .into_iter()
        .map(|([b, c, s], ball)| ([b, c, if orients_spindle { s } else { 0.0 }], ball))
        .collect();
    let mut places: Vec<Position> = Vec::new();
    let mut seen = Vec::new();
    for (bcs_rad, ball) in &visits {
        let here = rotary_position(*bcs_rad);
        let known = places.iter().position(|place| *place == here);
        let place = known.unwrap_or_else(|| {
            places.push(here);
            places.len() - 1
        });
        seen.push(PlannedBallMeasurement {
            rotary_position_index: place,
            ball_index: *ball,
            whitening: Matrix3::identity() / COORDINATE_NOISE_STD_MM,
        });
    }
    let bars =
        if has_bar { vec![LengthConstraint { from_ball: 0, to_ball: 1, u_mm: BAR_STD_U_MM }] } else { Vec::new() };
    let truth = reference_machine();
    let measured = ObservedValues {
        centre_axes_mm: visits
            .iter()
            .map(|(bcs_rad, ball)| truth.axis_positions_at_ball(balls[*ball], *bcs_rad))
            .collect(),
        lengths_mm: vec![BAR_LENGTH_MM; bars.len()],
    };
    (GeometryProblem::new(paper_model(), places, seen, bars, balls.len(), nominal_tool()), measured)
}

fn nominal_tool() -> Vector3<f64> {
    Vector3::new(0.0, 0.0, -326.717)
}

fn analyse_design_rank(kind: DesignAndCriterion, has_bar: bool, orients_spindle: bool) -> (RankAnalysis, Vec<String>) {
    let (problem, measured) = simulate_design_measurement(kind, has_bar, orients_spindle);
    let start = problem.initial_values(&measured);
    let survey = factorise_and_project_right_side(problem.row_blocks(&start, &problem.noise_free_observations(&start)))
        .0
        .analyse_rank()
        .unwrap();
    let named = |(i, centre): (usize, Vector3<f64>)| Ball {
        id: (i + 1).to_string(),
        centre_mm: centre.into(),
        radius_mm: 10.0,
        stem: [0.0, 0.0, -1.0],
        stem_radius_mm: 0.0,
        stem_length_mm: 0.0,
    };
    let balls = Balls { balls: paper_ball_centres().into_iter().enumerate().map(named).collect(), ..Balls::default() };
    let lost = describe_undetermined(&survey, &unknown_names(&problem, &balls));
    (survey, lost)
}

#[test]
fn gate_g4_ranks_and_description_of_the_null_space() {
    for kind in ALL_DESIGNS {
        check_ranks(kind);
    }
}

fn check_ranks(kind: DesignAndCriterion) {
    let spindle = ["EX0S + tool_x (inseparable)", "EY0S + tool_y (inseparable)"];
    let (full, lost) = analyse_design_rank(kind, true, true);
    println!("{kind:?}: scaled condition {:.1}", full.condition);
    assert_eq!((full.rank, lost.len()), (34, 0), "{kind:?}");
    assert!(full.condition < 40.0, "{kind:?}: {}", full.condition);
    let (no_bar, lost) = analyse_design_rank(kind, false, true);
    assert_eq!((no_bar.rank, lost.len()), (33, 1), "{kind:?}");
    assert!(lost[0].starts_with("the uniform scale") && lost[0].contains("EXX1"), "{lost:?}");
    let (no_spindle, mut lost) = analyse_design_rank(kind, true, false);
    lost.sort();
    assert_eq!(no_spindle.rank, 32, "{kind:?}");
    assert_eq!(lost, spindle, "{kind:?}");
    let (neither, lost) = analyse_design_rank(kind, false, false);
    assert_eq!((neither.rank, lost.len()), (31, 3), "{kind:?}");
    assert!(lost.iter().any(|line| line.starts_with("the uniform scale")), "{lost:?}");
}

/// METHODS section 4: additional errors that are inseparable from others are named.
#[test]
fn inseparable_added_errors_are_named() {
    for (addition, partner) in [
        ("EX0B", "EX0S"),
        ("EB0B", "EB0C"),
        ("EZ0B", "tool_z"),
        ("EY0B", "EY0S"),
        ("EY0C", "EY0S"),
        ("EC0C", "ball"),
        ("EB0S", "EX0S"),
        ("EA0S", "EY0S"),
    ] {
        let (problem, measured) = simulate_design_measurement(D_OPTIMAL_DESIGN, true, true);
        let mut parameters = problem.model().parameters().to_vec();
        parameters.push(addition.parse().unwrap());
        let model = GeometryModel::new(&machine("wCBXFZYSt"), &parameters).unwrap();
        let problem = problem.with_model(model);
        let start = problem.initial_values(&measured);
        let survey =
            factorise_and_project_right_side(problem.row_blocks(&start, &problem.noise_free_observations(&start)))
                .0
                .analyse_rank()
                .unwrap();
        let mut names: Vec<String> = parameters.iter().map(ToString::to_string).collect();
        names.extend(["tool_x", "tool_y", "tool_z"].map(str::to_owned));
        names.extend((0..18).map(|i| format!("ball_{}", i / 3 + 1)));
        let lost = name_null_space(survey.null_space.as_ref(), &names);
        println!("{addition}: {lost:?}");
        assert_eq!(survey.nullity, 1, "{addition}");
        assert!(lost[0].contains(addition) && lost[0].contains(partner), "{lost:?}");
    }
}

/// The misclosure is zero for the true errors: the readings give the true positions of the balls.
#[test]
fn no_misclosure_at_the_truth() {
    let (model, truth) = (paper_model(), reference_machine());
    let errors: Vec<f64> = paper_errors().into_iter().map(|(_, value)| value).collect();
    for (bcs_rad, ball) in design_measurements(D_OPTIMAL_DESIGN) {
        let centre = true_ball_centres()[ball];
        let xyz = truth.axis_positions_at_ball(centre, bcs_rad);
        let here = rotary_position(bcs_rad).updated_by(&Position::from_xyz(xyz));
        let misclosure = model.tip_function(&here, &errors, PAPER_TOOL_TIP_MM).value_at(xyz) - centre;
        assert!(misclosure.norm() < 1e-11, "{misclosure}");
    }
}

#[test]
fn gate_g4_noise_free_errors_are_recovered_in_three_iterations() {
    ALL_DESIGNS.into_iter().for_each(check_recovery);
}

fn check_recovery(kind: DesignAndCriterion) {
    let (problem, measured) = simulate_design_measurement(kind, true, true);
    let found = problem.solve(&measured, problem.initial_values(&measured)).unwrap();
    assert!(found.jacobian_evaluation_count <= 3, "{kind:?}: {}", found.jacobian_evaluation_count);
    for ((name, expected), x) in paper_errors().iter().zip(&found.x) {
        let micro = (x - expected).abs() * if expected.abs() > 1e-3 { 1e3 } else { 1e6 };
        assert!(micro <= 1e-6, "{kind:?}, {name}: {micro:e}");
    }
    for k in 0..3 {
        assert!((found.x[13 + k] - PAPER_TOOL_TIP_MM[k]).abs() <= 1e-9, "tool {:?}", &found.x[13..16]);
    }
    for (ball, centre) in true_ball_centres().into_iter().enumerate() {
        let at = problem.ball_unknown_index(ball);
        let off = Vector3::from_column_slice(&found.x[at..at + 3]).metric_distance(&centre);
        assert!(off <= 1e-9, "ball {ball}: {off:e}");
    }
}

/// Offsets ≤ 0.8 µm, angles ≤ 2 µrad, gains ≤ 2.5 µm/m; the scatter over 200 seeds is as predicted.
#[test]
fn gate_g4_uncertainties_meet_limits_and_match_scatter_of_200_seeds() {
    for kind in ALL_DESIGNS {
        let (problem, exact) = simulate_design_measurement(kind, true, true);
        check_requirements(kind, &problem, &exact);
        check_scatter(kind, &problem, &exact);
    }
}

fn check_requirements(kind: DesignAndCriterion, problem: &GeometryProblem, exact: &ObservedValues) {
    let start = problem.initial_values(exact);
    let covariance = problem.solve(exact, start).unwrap().factorisation.covariance();
    let mut worst = 0.0_f64;
    for (i, (name, _)) in paper_errors().iter().enumerate() {
        let sd = covariance[(i, i)].sqrt();
        let (micro, limit) = match (name.as_bytes()[1], name.ends_with('1')) {
            (_, true) => (sd * 1e6, 2.5),
            (b'X' | b'Y' | b'Z', _) => (sd * 1e3, 0.8),
            _ => (sd * 1e6, 2.0),
        };
        worst = worst.max(micro / limit);
        assert!(micro <= limit, "{kind:?}, {name}: {micro}");
    }
    println!("{kind:?}: worst sd {worst:.2} of what METHODS asks");
}

fn check_scatter(kind: DesignAndCriterion, problem: &GeometryProblem, exact: &ObservedValues) {
    const FULL_SEED_COUNT: u64 = 200;
    let seeds = population_size(FULL_SEED_COUNT);
    let start = problem.initial_values(exact);
    let at_truth = problem.solve(exact, start).unwrap();
    let covariance = at_truth.factorisation.covariance();
    let mut squares = vec![0.0; problem.unknown_count()];
    let mut chi2 = 0.0;
    for seed in 0..seeds {
        let mut normal = StandardNormal.sample_iter(seeded_stream(seed, &[4]));
        let mut next = || -> f64 { normal.next().unwrap() };
        let mut noisy = exact.clone();
        for xyz in &mut noisy.centre_axes_mm {
            *xyz += Vector3::new(next(), next(), next()) * COORDINATE_NOISE_STD_MM;
        }
        noisy.lengths_mm[0] += next() * BAR_STD_U_MM;
        let start = problem.initial_values(&noisy);
        let found = problem.solve(&noisy, start).unwrap();
        chi2 += found.residuals.iter().map(|r| r * r).sum::<f64>();
        for (sum, (x, expected)) in squares.iter_mut().zip(found.x.iter().zip(&at_truth.x)) {
            *sum += (x - expected).powi(2);
        }
    }
    let (low, high) = sd_ratio_bounds(seeds, FULL_SEED_COUNT, (0.85, 1.15));
    for (i, sum) in squares.iter().enumerate() {
        let ratio = (sum / seeds as f64 / covariance[(i, i)]).sqrt();
        assert!((low..=high).contains(&ratio), "{kind:?}, unknown {i}: {ratio}");
    }
    // Sums of 3·109 + 1 − 34 squares: within four standard deviations of their expectation.
    let dof = (seeds * (3 * 109 + 1 - 34)) as f64;
    assert!((chi2 / dof - 1.0).abs() < 4.0 * (2.0 / dof).sqrt(), "{}", chi2 / dof);
}

/// Compares the blocks with all rows in one dense matrix, with derivatives by differences of the residuals.
#[test]
fn row_blocks_match_differences_of_the_residuals() {
    let (problem, measured) = simulate_design_measurement(D_OPTIMAL_DESIGN, true, true);
    let x = problem.solve(&measured, problem.initial_values(&measured)).unwrap().x;
    let (factored, _) = factorise_and_project_right_side(problem.row_blocks(&x, &measured));
    let mut jacobian = Mat::zeros(problem.row_count(), x.len());
    for j in 0..x.len() {
        let h = if j < 13 && x[j].abs() < 1e-3 { 1e-5 } else { 1e-2 };
        let at = |step: f64| {
            let mut moved = x.clone();
            moved[j] += step;
            problem.weighted_residuals(&moved, &measured)
        };
        for (i, (up, down)) in at(h).into_iter().zip(at(-h)).enumerate() {
            jacobian[(i, j)] = (down - up) / (2.0 * h);
        }
    }
    let normal = jacobian.transpose() * &jacobian;
    let product = &normal * factored.covariance();
    for i in 0..x.len() {
        for j in 0..x.len() {
            let scale = (normal[(i, i)] / normal[(j, j)]).sqrt();
            let expected = f64::from(u8::from(i == j));
            assert!((product[(i, j)] / scale - expected).abs() < 1e-5, "{i} {j}");
        }
    }
}
