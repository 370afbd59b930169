//! Gate G1 (METHODS section 1), with paper 1's tables and with exact geometry that is independent of the model.

use std::f64::consts::TAU;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::design::AngleGridDesign;
use super::fit::{SELF_CALIBRATION_RANK_THRESHOLD, SelfCalibrationFit};
use super::model::{RadiusObservation, UnknownsLayout};
use super::outputs::axis_position_coefficients;
use super::paper_system::PaperSystem;
use super::settings::SelfCalibrationSettings;
use crate::identification::{
    FitQuality, IdentificationOutputs, ObservationEffect, OutputParameter, SolvedLinearFit, SolvedModel, TrialSettings,
    UncertaintySource, dot_product, identify, multiply_vector,
};
use estimation::linear_least_squares::{LinearSolution, analyse_rank};
use estimation::monte_carlo::TrialCount;
use estimation::random::seeded_stream;
use estimation::{circle, linear_least_squares};
use machine::record::estimate::Unit;
use testing::population::population_size;

mod propagation;

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

fn two_angle_paper_system(n: usize, k_b: usize) -> PaperSystem {
    PaperSystem::new(&AngleGridDesign { angle_count: n, probe_angle_indices: vec![0, k_b] })
}

/// Largest standard uncertainty of any unknown for unit differences.
fn largest_standard_uncertainty(form: &PaperSystem) -> f64 {
    let solution = form.solve(&vec![0.0; form.touches.len()], 1.0).unwrap();
    let variance = &solution.covariance;
    (0..variance.nrows()).map(|i| variance[(i, i)]).fold(0.0, f64::max).sqrt()
}

#[test]
fn gate_g1_rank_and_condition_of_the_papers_design() {
    let form = two_angle_paper_system(8, 1);
    let free = analyse_rank(form.design_matrix.as_ref(), None, SELF_CALIBRATION_RANK_THRESHOLD).unwrap();
    assert_eq!((free.rank, free.nullity), (26, 6));
    let fixed =
        analyse_rank(form.design_matrix.as_ref(), Some(form.gauge.as_ref()), SELF_CALIBRATION_RANK_THRESHOLD).unwrap();
    assert_eq!((fixed.rank, fixed.nullity), (26, 0));
    assert!((fixed.condition_unscaled - 21.88).abs() < 0.01, "{}", fixed.condition_unscaled);
}

#[test]
fn rank_deficiency_is_gcd_minus_one() {
    for n in 4..=36 {
        for k_b in 1..n {
            let form = two_angle_paper_system(n, k_b);
            let nullity =
                analyse_rank(form.design_matrix.as_ref(), None, SELF_CALIBRATION_RANK_THRESHOLD).unwrap().nullity;
            assert_eq!(nullity - 6, gcd(k_b, n) - 1, "N = {n}, k_b = {k_b}");
        }
    }
}

#[test]
fn angle_of_45_degrees_works_for_8_positions_only() {
    for n in [8, 16, 24, 32] {
        let settings = SelfCalibrationSettings {
            positions: n,
            probe_angles_deg: Some(vec![0.0, 45.0]),
            ..SelfCalibrationSettings::default()
        };
        match AngleGridDesign::new(&settings) {
            Ok(_) => assert_eq!(n, 8),
            Err(refused) => {
                assert_ne!(n, 8);
                let better = format!("[0, {}]", 360.0 / n as f64);
                assert!(refused.remedy.contains(&better), "{}", refused.remedy);
            }
        }
    }
}

/// Standard deviations of the unknowns from Monte Carlo trials, for differences of unit uncertainty.
fn monte_carlo_standard_deviations(form: &PaperSystem, trials: usize) -> Vec<f64> {
    let LinearSolution { x, gain, rank, condition, dof, .. } = form.solve(&vec![0.0; form.touches.len()], 1.0).unwrap();
    let sigma = vec![1.0; form.touches.len()];
    let unknowns = (0..x.len()).map(|j| OutputParameter::from_unknown("x", Unit::Mm, j, &x));
    let outputs = IdentificationOutputs { linear_parameters: unknowns.collect(), ..IdentificationOutputs::default() };
    let figures = FitQuality { rank, unknown_count: rank, condition_number: condition, dof, residual_rms_mm: 0.0 };
    let solution = SolvedModel {
        model: &SolvedLinearFit { x: &x, design_matrix: &form.design_matrix, sigma: &sigma, gain: &gain },
        weighted_residuals: &vec![0.0; sigma.len()],
        has_declared_source_sizes: true,
        fit_quality: figures,
        measurements: &[],
    };
    let source = UncertaintySource::new("differences", ObservationEffect::Independent(sigma.clone()));
    let plan = TrialSettings { seed: 5, trial_count: TrialCount::Fixed(trials) };
    identify(&solution, &[source], outputs, Some(plan)).unwrap().trial_statistics.unwrap().standard_deviation
}

/// Paper 1, Table 5. W(180°) is the one exception that METHODS lists (1.63 against 1.94).
#[test]
fn paper_table_5_uncertainties() {
    let form = two_angle_paper_system(8, 1);
    let standard_deviations = monte_carlo_standard_deviations(&form, 100_000);
    let expanded = |with_r: usize| 2.0 * standard_deviations[with_r - 1];
    let layout = &form.layout;
    let mut squares = Vec::new();
    for line in include_str!("../../../tests/data/paper1-table5.csv").lines().skip(2) {
        let row: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let i = ((row[0] / 45.0).round() as i64).rem_euclid(8) as usize;
        let own = [
            layout.ex_index(0, i),
            layout.ey_index(0, i),
            layout.linear_axes_radial_error_index(0, i),
            layout.flank_form_index(0, i),
        ];
        for (column, index) in own.into_iter().enumerate() {
            let printed = row[column + 1];
            let excepted = i == 4 && column == 3;
            if printed > 0.0 && !excepted {
                squares.push((expanded(index) / printed).ln().powi(2));
            } else if printed == 0.0 {
                assert!(expanded(index) < 1e-6);
            }
        }
    }
    assert_eq!(squares.len(), 7 * 4 - 2);
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!(rms <= 0.04, "rms log-ratio {rms}");
}

/// At a touch noise of 1 µm, u of the axis position (mean of E_total) is 0.97 µm in X and 1.06 µm in Y (METHODS
/// section 1).
#[test]
fn uncertainty_of_the_mean_axis_position() {
    let form = two_angle_paper_system(8, 1);
    let solution = form.solve(&[0.0; 32], 1.0).unwrap();
    let (x, y) = axis_position_coefficients(&form.layout, 0);
    let u = |c: &[f64]| {
        let product = multiply_vector(&solution.covariance, &c[1..]);
        dot_product(&c[1..], &product).sqrt()
    };
    assert!((u(&x) - 0.97).abs() < 0.006, "{}", u(&x));
    assert!((u(&y) - 1.06).abs() < 0.006, "{}", u(&y));
}

#[test]
fn a_third_probe_angle_reduces_the_largest_uncertainty() {
    for (n, paper, third) in [(8, 3.34, 1.40), (24, f64::NAN, 1.88), (36, 13.8, 2.06)] {
        let with = PaperSystem::new(&AngleGridDesign { angle_count: n, probe_angle_indices: vec![0, 1, n / 4] });
        let worst = largest_standard_uncertainty(&with);
        assert!((worst - third).abs() < 0.006, "N = {n}: {worst}");
        if paper.is_finite() {
            let worst = largest_standard_uncertainty(&two_angle_paper_system(n, 1));
            assert!((worst / paper - 1.0).abs() < 0.005, "N = {n}: {worst}");
        }
    }
}

/// Any E, E_r, W that satisfy the gauge are recovered from the equation itself.
#[test]
fn noise_free_unknowns_are_recovered() {
    let form = two_angle_paper_system(8, 1);
    let mut rng = seeded_stream(7, &[1]);
    let mut truth: Vec<f64> = (0..form.design_matrix.ncols()).map(|_| StandardNormal.sample(&mut rng)).collect();
    let l = &form.layout;
    for zero in [
        l.ex_index(0, 0),
        l.ey_index(0, 0),
        l.linear_axes_radial_error_index(0, 0),
        l.flank_form_index(0, 0),
        l.linear_axes_radial_error_index(0, 4),
    ] {
        truth[zero - 1] = 0.0;
    }
    truth[l.linear_axes_radial_error_index(0, 6) - 1] = truth[l.linear_axes_radial_error_index(0, 2) - 1];
    let differences = multiply_vector(&form.design_matrix, &truth);
    let found = form.solve(&differences, 1.0).unwrap().x;
    let worst = found.iter().zip(&truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-9, "{worst}");
}

/// Exact contact of a ball, moved along the ray at φ through the machine's origin, with an off-centre round part on
/// a table whose true axis is at c: an intersection of line and circle.
struct RoundPart {
    contact_radius_mm: f64,
    /// Centre at C = 0.
    centre: [f64; 2],
    axis: [f64; 2],
}

impl RoundPart {
    fn measured_radius_mm(&self, c: f64, phi: f64) -> f64 {
        let from_axis = [self.centre[0] - self.axis[0], self.centre[1] - self.axis[1]];
        let (sin, cos) = (-c).sin_cos();
        let x = self.axis[0] + cos * from_axis[0] - sin * from_axis[1];
        let y = self.axis[1] + sin * from_axis[0] + cos * from_axis[1];
        let (sin, cos) = phi.sin_cos();
        let across = -x * sin + y * cos;
        x * cos + y * sin + (self.contact_radius_mm * self.contact_radius_mm - across * across).sqrt()
    }
}

fn identified_axis_position(part: &RoundPart, n: usize, with_second_order: bool) -> [f64; 2] {
    let design = AngleGridDesign { angle_count: n, probe_angle_indices: vec![0, 1, n / 4] };
    let observations: Vec<RadiusObservation> = design
        .cycle_touches(false)
        .into_iter()
        .map(|t| RadiusObservation {
            step_id: 0,
            height_index: 0,
            c_index: t.c_index,
            phi_index: t.phi_index,
            along_ray_mm: part.measured_radius_mm(design.grid_angle_rad(t.c_index), design.grid_angle_rad(t.phi_index)),
            across_ray_mm: 0.0,
            time_s: 0.0,
            relative_time: 0.0,
        })
        .collect();
    let layout = UnknownsLayout { design, height_count: 1, drift_order: 0, interruption_times: Vec::new() };
    let sigma = vec![1e-3; observations.len()];
    let SelfCalibrationFit { layout, x, .. } =
        SelfCalibrationFit::new(layout, observations, sigma, with_second_order).unwrap();
    let (cx, cy) = axis_position_coefficients(&layout, 0);
    [dot_product(&cx, &x), dot_product(&cy, &x)]
}

/// METHODS section 1: e = 1.5 mm, c = (50, −30) um, R = 45, r_ball = 3.
#[test]
fn second_order_correction_recovers_axis_on_exact_geometry() {
    let mut worst = [0.0f64; 2];
    for turn in 0..16 {
        let (sin, cos) = (TAU * f64::from(turn) / 16.0).sin_cos();
        let axis = [0.050, -0.030];
        let part = RoundPart { contact_radius_mm: 48.0, centre: [axis[0] + 1.5 * cos, axis[1] + 1.5 * sin], axis };
        for (i, second_order) in [false, true].into_iter().enumerate() {
            let found = identified_axis_position(&part, 8, second_order);
            let off = (found[0] - axis[0]).hypot(found[1] - axis[1]);
            worst[i] = worst[i].max(off);
        }
    }
    assert!(worst[1] <= 0.20e-3, "corrected: {} mm", worst[1]);
    assert!(worst[0] > 1e-3, "the test must need the correction: {} mm", worst[0]);
}

/// The pattern of paper 1, Table 9: with the machine's origin shifted by ±20 um, the estimated centre is c0 −
/// shift.
#[test]
fn gate_g1_shifted_origin_shifts_the_axis_position() {
    let axis = [0.003, 0.005];
    let centre = [0.4, -0.3];
    let shifts = (0..9).filter(|i| *i != 4).map(|i| [i % 3 - 1, i / 3 - 1].map(|s| 0.02 * f64::from(s)));
    for shift in shifts {
        let moved = |p: [f64; 2]| [p[0] - shift[0], p[1] - shift[1]];
        let part = RoundPart { contact_radius_mm: 48.0, centre: moved(centre), axis: moved(axis) };
        let found = identified_axis_position(&part, 8, true);
        let expected = moved(axis);
        for i in 0..2 {
            assert!((found[i] - expected[i]).abs() < 0.03e-3, "{found:?} for {expected:?}");
        }
    }
}

/// Paper 1, Table 6: the Gauss circle for c = (3, 5.1) um has U = 3.10 um for EY0C at k = 2. EX0C is the exception:
/// the paper prints 3.68 um, METHODS finds 2.93 um. With 100 000 trials this fit has 3.16 um for EY0C, 2 % above the
/// printed value.
#[test]
fn paper_table_6_circle_centre() {
    let form = two_angle_paper_system(8, 1);
    let layout = &form.layout;
    let truth = |i: usize| {
        let (sin, cos) = layout.design.grid_angle_rad(i).sin_cos();
        let c = [3.0, 5.1];
        [c[0] - cos * c[0] - sin * c[1], c[1] + sin * c[0] - cos * c[1]]
    };
    let solution = form.solve(&[0.0; 32], 1.0).unwrap();
    let mut rng = seeded_stream(11, &[6]);
    const FULL_TRIAL_COUNT: u32 = 100_000;
    let trials = population_size(FULL_TRIAL_COUNT.into()) as u32;
    let (mut sum, mut squares) = ([0.0; 2], [0.0; 2]);
    for _ in 0..trials {
        let noise: Vec<f64> = (0..32).map(|_| StandardNormal.sample(&mut rng)).collect();
        let x = multiply_vector(&solution.gain, &noise);
        let points: Vec<[f64; 2]> = (0..8)
            .map(|i| [truth(i)[0] + x[layout.ex_index(0, i) - 1], truth(i)[1] + x[layout.ey_index(0, i) - 1]])
            .collect();
        let centre = circle::fit_circle(&points).unwrap().centre;
        for i in 0..2 {
            sum[i] += centre[i];
            squares[i] += centre[i] * centre[i];
        }
    }
    let expanded = |i: usize| {
        let mean: f64 = sum[i] / f64::from(trials);
        2.0 * (squares[i] / f64::from(trials) - mean * mean).sqrt()
    };
    let tolerance = 0.03 * (f64::from(FULL_TRIAL_COUNT) / f64::from(trials)).sqrt();
    assert!((expanded(0) / 2.93 - 1.0).abs() < tolerance, "{}", expanded(0));
    assert!((expanded(1) / 3.10 - 1.0).abs() < tolerance, "{}", expanded(1));
}

#[test]
fn linear_drift_is_removed() {
    // Random drift in X, Y and radius is removed exactly if it is linear in time.
    let design = AngleGridDesign { angle_count: 8, probe_angle_indices: vec![0, 1, 2] };
    let part = RoundPart { contact_radius_mm: 48.0, centre: [0.3, 0.2], axis: [0.02, -0.01] };
    let touches = design.cycle_touches(true);
    let mut rng = seeded_stream(3, &[9]);
    let rate: [f64; 3] = std::array::from_fn(|_| 0.01 * (rng.random::<f64>() - 0.5));
    let last = (touches.len() - 1) as f64;
    let observations: Vec<RadiusObservation> = touches
        .iter()
        .enumerate()
        .map(|(i, t)| {
            let time = 2.0 * i as f64 / last - 1.0;
            let (sin, cos) = design.grid_angle_rad(t.phi_index).sin_cos();
            let drift = time * (rate[0] * cos + rate[1] * sin + rate[2]);
            let radius =
                part.measured_radius_mm(design.grid_angle_rad(t.c_index), design.grid_angle_rad(t.phi_index)) + drift;
            RadiusObservation {
                step_id: 0,
                height_index: 0,
                c_index: t.c_index,
                phi_index: t.phi_index,
                along_ray_mm: radius,
                across_ray_mm: 0.0,
                time_s: 0.0,
                relative_time: time,
            }
        })
        .collect();
    let layout = UnknownsLayout { design, height_count: 1, drift_order: 1, interruption_times: Vec::new() };
    let sigma = vec![1e-3; observations.len()];
    let SelfCalibrationFit { layout, x, .. } = SelfCalibrationFit::new(layout, observations, sigma, true).unwrap();
    let (cx, cy) = axis_position_coefficients(&layout, 0);
    assert!((dot_product(&cx, &x) - 0.02).abs() < 5e-5, "{}", dot_product(&cx, &x));
    assert!((dot_product(&cy, &x) + 0.01).abs() < 5e-5, "{}", dot_product(&cy, &x));
}

#[test]
fn the_default_design_is_well_posed_for_any_n() {
    for n in 5..=36 {
        let design =
            AngleGridDesign::new(&SelfCalibrationSettings { positions: n, ..SelfCalibrationSettings::default() })
                .unwrap();
        let layout = UnknownsLayout { design, height_count: 1, drift_order: 1, interruption_times: Vec::new() };
        let touches = layout.design.cycle_touches(true);
        let last = touches.len() as f64;
        let seen: Vec<RadiusObservation> = touches
            .iter()
            .enumerate()
            .map(|(i, t)| RadiusObservation {
                step_id: 0,
                height_index: 0,
                c_index: t.c_index,
                phi_index: t.phi_index,
                along_ray_mm: 0.0,
                across_ray_mm: 0.0,
                time_s: 0.0,
                relative_time: 2.0 * i as f64 / last - 1.0,
            })
            .collect();
        let a = layout.design_matrix(&seen);
        let gauge = layout.gauge_matrix();
        let found =
            linear_least_squares::analyse_rank(a.as_ref(), Some(gauge.as_ref()), SELF_CALIBRATION_RANK_THRESHOLD)
                .unwrap();
        assert_eq!(found.nullity, 0, "N = {n}");
    }
}
