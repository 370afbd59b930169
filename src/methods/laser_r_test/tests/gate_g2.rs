//! Acceptance tests G2 of METHODS section 2.

use nalgebra::{Matrix3, Vector3};

use super::simulated_machine::{PAPER_TABLE_5, SimulatedMachine, simulate_run, table_5_machine};
use super::{ideal_plan, settings_with_few_trials};
use crate::laser_r_test::identify::{identify, identify_scans};
use crate::laser_r_test::paper_estimator;
use crate::laser_r_test::parameter_selection::select_parameters;
use crate::laser_r_test::setup::LaserSetup;
use crate::laser_r_test::sphere_geometry;
use crate::laser_r_test::sphere_model::{CentreObservation, MachineEquations, SphereModel, with_linear_axes};
use estimation::schur::{BlockRows, factorise_and_project_right_side};
use machine::kinematics::KinematicChain;
use machine::record::estimate::Estimate;
use machine::{Axis, Position};
use testing::population::{population_size, sd_ratio_bounds};

pub const TABLE_5_SYMBOLS: [&str; 5] = ["EA0B", "EB0B", "EC0B", "EX0C", "EA0C"];
/// Units of Table 5 per internal unit: µrad per rad, µm per mm.
pub const TABLE_5_UNIT_FACTORS: [f64; 5] = [1e6, 1e6, 1e6, 1e3, 1e6];

fn table_5_values_and_u(estimate: &Estimate) -> [(f64, f64); 5] {
    TABLE_5_SYMBOLS.map(|name| {
        let found = estimate.parameters.iter().find(|p| p.symbol == name).unwrap();
        (found.value, found.u)
    })
}

/// Equations of 42 poses of a sphere, each observed with the standard uncertainty `u` mm, and the nominal unknowns.
pub fn equations_of_42_poses_and_nominal_unknowns(
    names: &[&str],
    harmonics: &[u32],
    ball: Vector3<f64>,
    u: f64,
) -> (MachineEquations, Vec<f64>) {
    let plan = ideal_plan(1.0);
    let chain = KinematicChain::new(&plan.machine).unwrap();
    let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
    let parameters = select_parameters(&chain, &names, harmonics).unwrap().parameters;
    let zero = Vector3::new(0.0, 0.0, -150.0);
    let mut centre_observations = Vec::new();
    for b in (-90..=90).step_by(30) {
        for c in (0..360).step_by(60) {
            let rotary: Position = [(Axis::B, f64::from(b)), (Axis::C, f64::from(c))]
                .map(|(axis, degrees)| (axis, degrees.to_radians()))
                .into_iter()
                .collect();
            let tip = machine::frame::Point::from_vec(zero);
            let target = machine::frame::Point::from_vec(ball);
            let at = chain.solve_linear_axes(target, tip, &rotary, &[]).unwrap();
            centre_observations.push(CentreObservation {
                axis_positions: rotary.updated_by(&at),
                whitening_matrix: Matrix3::identity() / u,
            });
        }
    }
    let mut x = vec![0.0; parameters.len()];
    x.extend(&zero);
    x.extend(&ball);
    (MachineEquations { model: SphereModel { chain, parameters }, centre_observations, zero_point_prior: None }, x)
}

/// The parameter set that the topology implies is that of the paper, with the uncertainties of METHODS at 1 µm.
#[test]
fn gate_g2_default_parameters_have_full_rank_and_expected_u() {
    let (problem, x) = equations_of_42_poses_and_nominal_unknowns(&[], &[], Vector3::new(80.0, 0.0, 60.0), 1e-3);
    let names: Vec<String> = problem.model.parameters.iter().map(ToString::to_string).collect();
    assert_eq!(names, TABLE_5_SYMBOLS);
    let survey = problem.analyse_rank(&x).unwrap();
    assert_eq!((survey.rank, survey.nullity), (11, 0));
    assert!((survey.condition - 2.9).abs() < 0.06, "{}", survey.condition);
    let minimum = problem.solve(x).unwrap();
    let covariance = minimum.factorisation.covariance();
    for (i, sd) in [2.3, 2.7, 2.2, 0.25, 3.0].into_iter().enumerate() {
        let found = covariance[(i, i)].sqrt() * TABLE_5_UNIT_FACTORS[i];
        assert!((found / sd - 1.0).abs() < 0.03, "{}: {found} {sd}", TABLE_5_SYMBOLS[i]);
    }
}

/// The columns of METHODS equal those of the chain, except for the part that offset and sphere position absorb.
#[test]
fn gate_g2_paper_columns_equal_those_of_the_chain() {
    let ball = Vector3::new(80.0, -12.0, 60.0);
    let (problem, x) = equations_of_42_poses_and_nominal_unknowns(&[], &[], ball, 1.0);
    let count = 3 * problem.centre_observations.len();
    // Differences of both sets, projected orthogonally to offset and sphere: the remainder must vanish.
    let mut rows = BlockRows::zeros(count, 0, 6);
    let mut differences = vec![vec![0.0; count]; 5];
    for (i, sight) in problem.centre_observations.iter().enumerate() {
        let (b, c) = (sight.axis_positions.get_or_zero(Axis::B), sight.axis_positions.get_or_zero(Axis::C));
        let turn = paper_estimator::nominal_rotation(b, c);
        let own = problem.model.misclosure_derivatives(&sight.axis_positions, &x);
        let of_paper = paper_estimator::location_error_derivatives(b, c, ball);
        for k in 0..3 {
            rows.set_common_coefficient(3 * i + k, k, 1.0);
            (0..3).for_each(|j| rows.set_common_coefficient(3 * i + k, 3 + j, turn[(k, j)]));
            for j in 0..5 {
                // If the sphere is displaced by d, the axes find it at positions displaced by d.
                differences[j][3 * i + k] = of_paper[j][k] + (turn * own[j])[k];
            }
        }
    }
    let (factored, _) = factorise_and_project_right_side(vec![rows]);
    for (j, difference) in differences.iter().enumerate() {
        let rest = factored.residuals(difference);
        let worst = rest.iter().fold(0.0_f64, |worst, value| worst.max(value.abs()));
        assert!(worst < 1e-9, "{}: {worst}", TABLE_5_SYMBOLS[j]);
        assert!(difference.iter().any(|value| value.abs() > 1e-3) || j == 3);
    }
}

/// Axis positions in the independent simulation, by fixed-point iteration with its own matrix product.
#[test]
fn chain_agrees_with_the_matrix_product_of_the_paper() {
    let world = SimulatedMachine { location_errors: [3e-3, -2e-3, 1e-3, 0.1, 4e-3], ..table_5_machine(0.0, 1) };
    let (problem, mut x) = equations_of_42_poses_and_nominal_unknowns(&[], &[], world.ball_centre, 1.0);
    x[..5].copy_from_slice(&world.location_errors);
    let zero = problem.model.zero_point(&x);
    for sight in &problem.centre_observations {
        let (b, c) = (sight.axis_positions.get_or_zero(Axis::B), sight.axis_positions.get_or_zero(Axis::C));
        let at = with_linear_axes(
            &sight.axis_positions,
            world.table_pose(b, c).transform_point(&world.ball_centre.into()).coords - zero,
        );
        let miss = problem.model.misclosure(&at, &x).norm();
        assert!(miss < 1e-12, "{miss} at {:?}", at.xyz_or_zero());
    }
}

#[test]
fn three_heights_determine_the_beam_direction() {
    let plan = ideal_plan(0.025);
    let mut square = 0.0;
    for seed in 0..40 {
        let world = table_5_machine(0.025, seed);
        let (plan, _, readings) = simulate_run(plan.clone(), &settings_with_few_trials(), &world, 2).unwrap();
        let own = settings_with_few_trials();
        let setup = LaserSetup::new(&plan, &own).unwrap();
        let beam = sphere_geometry::measured_geometry(&setup, &readings).unwrap().beam_direction;
        square += (beam.normalize() - world.beam_direction).norm_squared();
        assert!((beam.norm() - 1.0).abs() < 1e-4, "gain {}", beam.norm());
    }
    let rms_urad = (square / 40.0).sqrt() * 1e6;
    println!("beam direction: rms {rms_urad:.2} µrad");
    assert!(rms_urad <= 1.5, "{rms_urad}");
}

#[test]
fn noise_free_dwell_scans_give_the_values_of_table_5() {
    let world = table_5_machine(0.0, 1);
    let (plan, done, readings) = simulate_run(ideal_plan(0.5), &settings_with_few_trials(), &world, 9).unwrap();
    assert_eq!(done.len(), 7);
    // The references measure the pose at zero two more times.
    assert_eq!(plan.steps.len(), 1 + 3 + 41 + 2);
    let own = settings_with_few_trials();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    let result = identify_scans(&setup, &readings).unwrap();
    assert_eq!(result.grouped.groups.len(), 42 + 2);
    assert_eq!(result.observed.excluded_sample_counts_by_reason.values().sum::<usize>(), 0);
    for (i, (found, _)) in table_5_values_and_u(&identify(&setup, &readings).unwrap()).into_iter().enumerate() {
        let error = found - PAPER_TABLE_5[i] * TABLE_5_UNIT_FACTORS[i];
        assert!(error.abs() <= 1e-3, "{}: {found} off by {error}", TABLE_5_SYMBOLS[i]);
    }
    // Zero point and sphere are identified as well, as B and C of the simulation intersect in the origin.
    assert!((result.machine_equations.model.zero_point(&result.machine_fit.x) - world.zero_point).norm() < 1e-6);
    assert!((result.machine_equations.model.ball_centre(&result.machine_fit.x) - world.ball_centre).norm() < 1e-6);
}

#[test]
fn parameters_scatter_as_predicted() {
    // The scatter of the 30 seeds of METHODS, G2, is known only to 13 %, so more seeds are used for each parameter.
    const FULL_SEED_COUNT: u64 = 400;
    let seeds = population_size(FULL_SEED_COUNT);
    let (low, high) = sd_ratio_bounds(seeds, FULL_SEED_COUNT, (0.85, 1.15));
    let (mut squares, mut predicted) = ([0.0; 5], [0.0; 5]);
    let own = settings_with_few_trials();
    for seed in 0..seeds {
        let (plan, _, readings) = simulate_run(ideal_plan(0.5), &own, &table_5_machine(0.5, seed), 9).unwrap();
        let setup = LaserSetup::new(&plan, &own).unwrap();
        let estimate = identify(&setup, &readings).unwrap();
        for (i, (value, u)) in table_5_values_and_u(&estimate).into_iter().enumerate() {
            squares[i] += (value - PAPER_TABLE_5[i] * TABLE_5_UNIT_FACTORS[i]).powi(2) / seeds as f64;
            predicted[i] = u;
        }
    }
    for i in 0..5 {
        let sd = squares[i].sqrt();
        println!("{}: observed {sd:.3}, predicted {:.3}", TABLE_5_SYMBOLS[i], predicted[i]);
        assert!(sd <= if i == 3 { 0.2 } else { 2.0 }, "{}: {sd}", TABLE_5_SYMBOLS[i]);
        let ratio = sd / predicted[i];
        assert!((low..=high).contains(&ratio), "{}: {ratio}", TABLE_5_SYMBOLS[i]);
    }
}

/// The paper's own estimator. Without noise its error is only of second order, and it is reported beside the
/// estimate.
#[test]
fn paper_estimator_gives_table_5_and_is_reported_in_the_estimate() {
    let (plan, _, readings) =
        simulate_run(ideal_plan(0.5), &settings_with_few_trials(), &table_5_machine(0.0, 1), 9).unwrap();
    let own = settings_with_few_trials();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    let result = identify_scans(&setup, &readings).unwrap();
    let found = paper_estimator::identify_by_paper_method(&setup, &result.grouped, &result.centre_fit.x).unwrap();
    for i in 0..5 {
        let error = (found[i] - PAPER_TABLE_5[i]) * TABLE_5_UNIT_FACTORS[i];
        assert!(error.abs() < 0.1, "{}: off by {error}", TABLE_5_SYMBOLS[i]);
    }
    let estimate = identify(&setup, &readings).unwrap();
    assert!(estimate.gauge.iter().any(|line| line.contains("by the estimator of paper 2")));
}
