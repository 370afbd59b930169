//! All sources that the machine file declares, drawn in the independent simulation: U must cover them. Also the 0.2
//! mm cube of paper 2, Fig. 8.

use nalgebra::{Rotation3, Vector3};
use rand_distr::{Distribution, StandardNormal};

use super::gate_g2::{TABLE_5_SYMBOLS, TABLE_5_UNIT_FACTORS};
use super::simulated_machine::{PAPER_TABLE_5, SimulatedMachine, simulate_run, table_5_machine};
use super::{ideal_plan, plan_without_steps, settings_with_few_trials};
use crate::laser_r_test::LaserRTestSettings;
use crate::laser_r_test::identify::{identify, identify_scans};
use crate::laser_r_test::observe::observe_scans;
use crate::laser_r_test::pose_groups::group_scans;
use crate::laser_r_test::setup::LaserSetup;
use estimation::coverage::chi_square_bounds;
use estimation::random::seeded_stream;
use machine::record::estimate::Estimate;
use machine::{Axis, Position};
use testing::population::{event_count_limit, population_size};

/// A smooth random function of standard deviation 1 and correlation length `length`, less its value at 0.
fn smooth_random_value(seed: u64, key: u64, length: f64, at: f64) -> f64 {
    const WAVE_COUNT: usize = 24;
    let mut normal = StandardNormal.sample_iter(seeded_stream(seed, &[77, key]));
    let mut next = || -> f64 { normal.next().unwrap() };
    let wave = |_| {
        // A phase with a standard deviation of many turns is practically uniform.
        let (rate, phase) = (next() / length, next() * 60.0);
        (rate * at + phase).cos() - phase.cos()
    };
    (0..WAVE_COUNT).map(wave).sum::<f64>() * (2.0 / WAVE_COUNT as f64).sqrt()
}

/// Displacement of the table, mm, drawn from the uncertainties that config/laser.toml declares.
fn drawn_table_displacement(world: &SimulatedMachine, at: &Position, t_s: f64) -> Vector3<f64> {
    let um = 1e-3;
    let mut all = Vector3::zeros();
    for (key, axis) in (0u64..).zip(Axis::LINEAR) {
        let along = |k: u64| smooth_random_value(world.seed, 3 * key + k, 200.0, at.get_or_zero(axis));
        all += Vector3::new(along(0), along(1), along(2)) * 0.3 * um;
    }
    let harmonics = |key: u64, angle: f64| {
        let mut normal = StandardNormal.sample_iter(seeded_stream(world.seed, &[78, key]));
        let mut sum = Vector3::zeros();
        for order in 2..=5 {
            let (s, c) = (f64::from(order) * angle).sin_cos();
            let mut draw = || -> f64 { normal.next().unwrap() };
            sum += Vector3::new(draw(), draw(), draw()) * c + Vector3::new(draw(), draw(), draw()) * s;
        }
        sum * 0.15 * um
    };
    all += harmonics(0, at.get_or_zero(Axis::B));
    all += Rotation3::from_axis_angle(&Vector3::y_axis(), -at.get_or_zero(Axis::B))
        * harmonics(1, at.get_or_zero(Axis::C));
    let mut rate = StandardNormal.sample_iter(seeded_stream(world.seed, &[79]));
    let rate = Vector3::from([0; 3].map(|_| -> f64 { rate.next().unwrap() }));
    all + rate * um * t_s / 3600.0
}

fn drawn_linearity_error(world: &SimulatedMachine, distance: f64) -> f64 {
    smooth_random_value(world.seed, 99, 5.0, distance) * 0.5e-3
}

fn chi2_of_location_errors(estimate: &Estimate) -> f64 {
    let at = |name: &str| estimate.parameters.iter().position(|p| p.symbol == name).unwrap();
    let at = TABLE_5_SYMBOLS.map(at);
    let rows = &estimate.covariance.rows;
    let covariance = faer::Mat::from_fn(5, 5, |i, j| rows[at[i]][at[j]]);
    let error =
        faer::Mat::from_fn(5, 1, |i, _| estimate.parameters[at[i]].value - PAPER_TABLE_5[i] * TABLE_5_UNIT_FACTORS[i]);
    use faer::linalg::solvers::Solve;
    (error.transpose() * covariance.partial_piv_lu().solve(&error))[(0, 0)]
}

#[test]
fn covariance_of_the_estimate_covers_all_declared_sources() {
    const FULL_SEED_COUNT: u64 = 100;
    let seeds = population_size(FULL_SEED_COUNT);
    let own = LaserRTestSettings { samples: 5, ..settings_with_few_trials() };
    let (mut sum, mut above) = (0.0, 0);
    for seed in 0..seeds {
        let world = SimulatedMachine {
            table_displacement: drawn_table_displacement,
            reading_deviation: drawn_linearity_error,
            ..table_5_machine(0.5, seed)
        };
        let mut start = plan_without_steps();
        start.machine.axes.values_mut().for_each(|spec| spec.resolution_um = 0.0);
        let (plan, _, readings) = simulate_run(start, &own, &world, 9).unwrap();
        let setup = LaserSetup::new(&plan, &own).unwrap();
        let estimate = identify(&setup, &readings).unwrap();
        sum += chi2_of_location_errors(&estimate);
        above += usize::from(estimate.warnings.iter().any(|line| line.contains("does not explain")));
    }
    let (low, high) = chi_square_bounds(5.0 * seeds as f64, 0.99).unwrap();
    println!("χ² {sum:.0} of {}, bounds {low:.0} to {high:.0}; above {above}", 5 * seeds);
    assert!((low..=high).contains(&sum), "{sum}");
    // A misfit is declared at the 1 % level.
    assert!(above as u64 <= event_count_limit(seeds, FULL_SEED_COUNT, (0.01, 3)), "{above} false alarms");
}

#[test]
fn monte_carlo_agrees_with_first_order() {
    let own = LaserRTestSettings { monte_carlo_trials: 4000, ..settings_with_few_trials() };
    let (plan, _, readings) = simulate_run(plan_without_steps(), &own, &table_5_machine(0.5, 3), 9).unwrap();
    let setup = LaserSetup::new(&plan, &own).unwrap();
    let start = std::time::Instant::now();
    let estimate = identify(&setup, &readings).unwrap();
    println!("{:?} for 4000 trials", start.elapsed());
    for p in &estimate.parameters {
        println!("{} {:.4} u {:.4} MC {:.4} {:?}", p.symbol, p.value, p.u, p.u_monte_carlo.unwrap(), p.unit);
        let ratio = p.u_monte_carlo.unwrap() / p.u;
        assert!((0.93..=1.07).contains(&ratio), "{}: {ratio}", p.symbol);
        let combined: f64 = p.budget.iter().map(|line| line.u * line.u).sum();
        assert!((combined.sqrt() / p.u - 1.0).abs() < 1e-9);
    }
    println!("{:#?}", estimate.parameters[1].budget);
    println!("{:#?}\n{:#?}\n{:#?}", estimate.gauge, estimate.not_identifiable, estimate.warnings);
}

/// An undeclared second harmonic of B increases the residuals, and is identified if it is requested.
#[test]
fn harmonic_of_b_gives_a_misfit_unless_it_is_identified() {
    let shift =
        |_: &SimulatedMachine, at: &Position, _: f64| Vector3::x() * 3e-3 * (2.0 * at.get_or_zero(Axis::B)).cos();
    let world = SimulatedMachine { table_displacement: shift, ..table_5_machine(0.5, 1) };
    let found = |harmonics: &[u32]| {
        let own = LaserRTestSettings { harmonics: harmonics.to_vec(), ..settings_with_few_trials() };
        let (plan, _, readings) = simulate_run(ideal_plan(0.5), &own, &world, 9).unwrap();
        let setup = LaserSetup::new(&plan, &own).unwrap();
        identify(&setup, &readings).unwrap()
    };
    let without = found(&[]);
    assert!(without.warnings.iter().any(|line| line.contains("does not explain")));
    let with = found(&[2]);
    assert!(!with.warnings.iter().any(|line| line.contains("does not explain")), "{:?}", with.warnings);
    let motion = with.parameters.iter().find(|p| p.symbol == "EXB_cos2").unwrap();
    println!("EXB_cos2 {} ± {}", motion.value, motion.expanded);
    assert!((motion.value.abs() - 3.0).abs() < 0.1, "{}", motion.value);
}

/// Paper 2, Fig. 8: the sensor moves to the corners of a cube of 0.2 mm and scans the sphere from each. The sphere
/// does not move, so its position must not depend on the corner. The paper reports deviations of at most 1.4 µm.
#[test]
fn sphere_position_is_equal_from_all_corners_of_the_paper_cube() {
    let own = settings_with_few_trials();
    let curve = |_: &SimulatedMachine, d: f64| 4e-3 * (d / 20.0 * std::f64::consts::TAU).sin();
    let world = SimulatedMachine { reading_deviation: curve, ..table_5_machine(0.5, 1) };
    let (mut plan, _, mut readings) = simulate_run(ideal_plan(0.5), &own, &world, 2).unwrap();
    let scan = plan.steps.iter().find(|step| step.label.starts_with("height/2")).unwrap().clone();
    let mut t_s = 1e3;
    for corner in 0..8u32 {
        let mut step = scan.clone();
        step.id = plan.steps.len() as u32;
        step.label = format!("pose/{corner}/B0/C0");
        let path = &mut step.scan.as_mut().unwrap().path;
        for at in path.iter_mut() {
            for (bit, axis) in Axis::LINEAR.into_iter().enumerate() {
                let by = if corner >> bit & 1 == 1 { 0.1 } else { -0.1 };
                at.set(axis, at.get_or_zero(axis) + by);
            }
        }
        (step.from, step.to) = (path[0].clone(), path[path.len() - 1].clone());
        readings.extend(world.simulate_step(&step, 0.0, &mut t_s));
        plan.steps.push(step);
    }
    let setup = LaserSetup::new(&plan, &own).unwrap();
    let mut observed = observe_scans(&setup, &readings).unwrap();
    let grouped = group_scans(&setup, &mut observed).unwrap();
    let fitted = grouped.centre_equations.solve().unwrap();
    let first = grouped.centre_equations.group_centre(&fitted.x, 0);
    let mut worst = 0.0_f64;
    for group in 1..grouped.groups.len() {
        let off = grouped.centre_equations.group_centre(&fitted.x, group) - first;
        let mean_off = off * 1e3;
        println!("corner {group}: {mean_off:.3?} µm");
        worst = worst.max(mean_off.norm());
    }
    assert_eq!(grouped.groups.len(), 9);
    assert!(worst < 1.4, "{worst} µm");
    assert!(identify_scans(&setup, &readings).is_err());
}
