//! Tests on a published design: the self-calibration of a rotary axis (paper 1, METHODS section 1).

use std::f64::consts::TAU;

use faer::Mat;

use super::linear_least_squares::{LinearError, LinearProblem, analyse_rank, solve_least_squares};

const ANGLE_COUNT: usize = 8;
/// Unknowns in blocks: E_x(C_i), E_y(C_i), E_r(φ_i), W(θ_i), i = 0..8.
const UNKNOWN_COUNT: usize = 4 * ANGLE_COUNT;

/// Coefficients of r = R + E(C)·n(φ) + W(φ+C) − E_r(φ) without R, angles in steps of 45°.
fn reading_coefficients(phi: usize, c: usize) -> [f64; UNKNOWN_COUNT] {
    let mut row = [0.0; UNKNOWN_COUNT];
    let angle = phi as f64 * TAU / ANGLE_COUNT as f64;
    row[c] += angle.cos();
    row[ANGLE_COUNT + c] += angle.sin();
    row[2 * ANGLE_COUNT + phi] -= 1.0;
    row[3 * ANGLE_COUNT + (phi + c) % ANGLE_COUNT] += 1.0;
    row
}

/// Tests 1a, 1b, 2, 3 with probe angle `probe_angle_steps`·45°, each row less r_1a(0): 32 × 32.
pub(super) fn paper_design(probe_angle_steps: usize) -> Mat<f64> {
    let one_a = (0..ANGLE_COUNT).map(|i| (0, i));
    let one_b = (0..ANGLE_COUNT).map(|i| (probe_angle_steps, i));
    let two = (0..ANGLE_COUNT).map(|i| (i, 0));
    let three = (0..ANGLE_COUNT).map(|i| ((ANGLE_COUNT - i) % ANGLE_COUNT, i));
    let rows: Vec<_> = one_a.chain(one_b).chain(two).chain(three).collect();
    let origin = reading_coefficients(0, 0);
    Mat::from_fn(rows.len(), UNKNOWN_COUNT, |i, j| reading_coefficients(rows[i].0, rows[i].1)[j] - origin[j])
}

/// Gauge of the paper: E(0)=0, E_r(0)=W(0)=0, E_r(180)=0, E_r(90)=E_r(−90).
pub(super) fn paper_gauge() -> Mat<f64> {
    let mut c = Mat::zeros(6, UNKNOWN_COUNT);
    for (row, unknown) in
        [0, ANGLE_COUNT, 2 * ANGLE_COUNT, 3 * ANGLE_COUNT, 2 * ANGLE_COUNT + 4].into_iter().enumerate()
    {
        c[(row, unknown)] = 1.0;
    }
    c[(5, 2 * ANGLE_COUNT + 2)] = 1.0;
    c[(5, 2 * ANGLE_COUNT + 6)] = -1.0;
    c
}

/// The same gauge by hand: the columns of the fixed unknowns are removed, E_r(90) and E_r(−90) are merged.
fn without_gauge_columns(a: &Mat<f64>) -> Mat<f64> {
    let fixed = [0, ANGLE_COUNT, 2 * ANGLE_COUNT, 3 * ANGLE_COUNT, 2 * ANGLE_COUNT + 4, 2 * ANGLE_COUNT + 6];
    let kept: Vec<usize> = (0..UNKNOWN_COUNT).filter(|j| !fixed.contains(j)).collect();
    Mat::from_fn(a.nrows(), kept.len(), |i, j| match kept[j] {
        j if j == 2 * ANGLE_COUNT + 2 => a[(i, j)] + a[(i, 2 * ANGLE_COUNT + 6)],
        j => a[(i, j)],
    })
}

#[test]
fn gate_g1_rank_26_and_condition_21_88_at_eight_angles() {
    let a = paper_design(1);
    let constrained = analyse_rank(a.as_ref(), Some(paper_gauge().as_ref()), 1e-9).unwrap();
    assert_eq!((constrained.rank, constrained.nullity), (26, 0));
    // 21.88 is the condition without column scaling; all unknowns here are lengths.
    let unscaled = constrained.condition_unscaled;
    assert!((unscaled - 21.88).abs() < 0.01, "{unscaled}");
    assert!((constrained.condition - 14.203).abs() < 1e-3, "{}", constrained.condition);

    let removed = analyse_rank(without_gauge_columns(&a).as_ref(), None, 1e-9).unwrap();
    assert_eq!((removed.rank, removed.nullity), (26, 0));
    assert!((removed.condition - constrained.condition).abs() < 1e-9, "{}", removed.condition);

    let free = analyse_rank(a.as_ref(), None, 1e-9).unwrap();
    assert_eq!((free.rank, free.nullity), (26, 6));
    let seen = &a * &free.null_space;
    assert!(seen.norm_max() < 1e-12);
}

/// The rank deficiency is gcd(k_b, N) − 1 (METHODS section 1). At φ_b = 180° some columns contain only rounding
/// errors.
#[test]
fn gate_g1_deficient_probe_angles_lose_gcd_less_one_directions() {
    for (k_b, lost) in [(1, 0), (2, 1), (3, 0), (4, 3), (5, 0), (6, 1), (7, 0)] {
        let found = analyse_rank(paper_design(k_b).as_ref(), Some(paper_gauge().as_ref()), 1e-9).unwrap();
        assert_eq!(found.nullity, lost, "k_b = {k_b}");
        let residue = &paper_gauge() * &found.null_space;
        assert!(residue.ncols() == 0 || residue.norm_max() < 1e-12);
    }
}

#[test]
fn constrained_solution_is_exact_and_rank_deficiency_is_refused() {
    let a = paper_design(1);
    let gauge = paper_gauge();
    let mut truth: Vec<f64> = (0..UNKNOWN_COUNT).map(|j| (0.7 * j as f64).sin() * 1e-3).collect();
    for fixed in [0, ANGLE_COUNT, 2 * ANGLE_COUNT, 3 * ANGLE_COUNT, 2 * ANGLE_COUNT + 4] {
        truth[fixed] = 0.0;
    }
    truth[2 * ANGLE_COUNT + 6] = truth[2 * ANGLE_COUNT + 2];
    let y: Vec<f64> = (0..a.nrows()).map(|i| (0..UNKNOWN_COUNT).map(|j| a[(i, j)] * truth[j]).sum()).collect();
    let sigma: Vec<f64> = (0..a.nrows()).map(|i| 1e-3 * (1.0 + (i % 3) as f64)).collect();
    let mut problem =
        LinearProblem { a: a.as_ref(), y: &y, sigma: &sigma, constraints: Some(gauge.as_ref()), rank_threshold: 1e-9 };
    let solution = solve_least_squares(&problem).unwrap();
    for (x, truth) in solution.x.iter().zip(&truth) {
        assert!((x - truth).abs() < 1e-15, "{x} {truth}");
    }
    assert!(solution.chi2 < 1e-20 && solution.dof == 6);
    // The covariance equals the variances of the rows, propagated through the gain.
    let noise = Mat::from_fn(32, 32, |i, j| if i == j { sigma[i].powi(2) } else { 0.0 });
    let propagated = &solution.gain * noise * solution.gain.transpose();
    assert!((propagated - &solution.covariance).norm_max() < 1e-16);

    problem.constraints = None;
    let Err(LinearError::RankDeficient(found)) = solve_least_squares(&problem) else { panic!("must refuse") };
    assert_eq!((found.rank, found.nullity), (26, 6));
}

/// Straight line through (−1, 1), (0, 2), (1, 4) with sigma 1, 1, 2. The normal equations by hand are 9/4·a − 3/4·b
/// = 4, −3/4·a + 5/4·b = 0, so a = 20/9, b = 4/3, and the covariance is the inverse.
#[test]
fn weighted_line_fit_equals_hand_calculation() {
    let a = Mat::from_fn(3, 2, |i, j| if j == 0 { 1.0 } else { i as f64 - 1.0 });
    let solution = solve_least_squares(&LinearProblem {
        a: a.as_ref(),
        y: &[1.0, 2.0, 4.0],
        sigma: &[1.0, 1.0, 2.0],
        constraints: None,
        rank_threshold: 1e-10,
    })
    .unwrap();
    let expect = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-14, "{found}");
    expect(solution.x[0], 20.0 / 9.0);
    expect(solution.x[1], 4.0 / 3.0);
    expect(solution.covariance[(0, 0)], 5.0 / 9.0);
    expect(solution.covariance[(0, 1)], 1.0 / 3.0);
    expect(solution.covariance[(1, 1)], 1.0);
    // The residuals are 1/9, −2/9, 4/9.
    expect(solution.chi2, (1.0 + 4.0 + 4.0) / 81.0);
    assert_eq!(solution.dof, 1);
}
