//! One published problem and the typed failures. The complete set of NIST problems is in tests/numerics/nist_strd.

use super::*;
use crate::linear_least_squares::LinearError;

/// y = b1·(1 − exp(−b2·x)): NIST StRD "Misra1a", data and certified values from its file.
const MISRA1A: [(f64, f64); 14] = [
    (10.07, 77.6),
    (14.73, 114.9),
    (17.94, 141.1),
    (23.93, 190.8),
    (29.61, 239.9),
    (35.18, 289.0),
    (40.02, 332.8),
    (44.82, 378.4),
    (50.76, 434.8),
    (55.05, 477.3),
    (61.01, 536.8),
    (66.40, 593.1),
    (75.47, 689.1),
    (81.78, 760.0),
];

fn misra1a_residuals(b: &[f64]) -> Vec<f64> {
    MISRA1A.iter().map(|(y, x)| y - b[0] * (1.0 - (-b[1] * x).exp())).collect()
}

fn misra1a_rows(b: &[f64]) -> Vec<BlockRows> {
    let mut rows = BlockRows::zeros(14, 0, 2);
    for (i, (residual, (_, x))) in misra1a_residuals(b).into_iter().zip(MISRA1A).enumerate() {
        rows.set_right_side(i, residual);
        rows.set_common_coefficient(i, 0, 1.0 - (-b[1] * x).exp());
        rows.set_common_coefficient(i, 1, b[0] * x * (-b[1] * x).exp());
    }
    vec![rows]
}

#[test]
fn paper_nist_misra1a_certified_values() {
    let found = minimise_squares(vec![500.0, 1e-4], misra1a_rows, misra1a_residuals).unwrap();
    assert!((found.x[0] / 2.389_421_291_8e2 - 1.0).abs() < 1e-9, "{:?}", found.x);
    assert!((found.x[1] / 5.501_564_318_1e-4 - 1.0).abs() < 1e-9, "{:?}", found.x);
    let squares = square_sum(&found.residuals);
    assert!((squares / 1.245_513_889_4e-1 - 1.0).abs() < 1e-9);
    let (scale, covariance) = ((squares / 12.0).sqrt(), found.factorisation.covariance());
    let deviation = [0, 1].map(|j| scale * covariance[(j, j)].sqrt());
    assert!((deviation[0] / 2.707_007_524_1 - 1.0).abs() < 1e-6, "{deviation:?}");
    assert!((deviation[1] / 7.266_868_806_0e-6 - 1.0).abs() < 1e-6, "{deviation:?}");
}

#[test]
fn each_failure_has_its_error_variant() {
    let lost = minimise_squares(vec![f64::NAN, 1e-4], misra1a_rows, misra1a_residuals);
    assert!(matches!(lost, Err(NonlinearError::Linear(LinearError::Malformed(_)))), "{lost:?}");
    // A derivative of the wrong sign: no step decreases the sum of squares.
    let wrong = |x: &[f64]| {
        let mut rows = BlockRows::zeros(1, 0, 1);
        rows.set_right_side(0, 1.0 - x[0]);
        rows.set_common_coefficient(0, 0, -1.0);
        vec![rows]
    };
    let stuck = minimise_squares(vec![0.0], wrong, |x| vec![1.0 - x[0]]);
    assert!(matches!(stuck, Err(NonlinearError::NotConverged { .. })), "{stuck:?}");
    // The rows determine only the sum of two unknowns.
    let seen = |x: &[f64]| vec![4.0 - (x[0] + x[1]).powi(2); 2];
    let twice = |x: &[f64]| {
        let mut rows = BlockRows::zeros(2, 0, 2);
        for (i, value) in seen(x).into_iter().enumerate() {
            rows.set_right_side(i, value);
            (0..2).for_each(|j| rows.set_common_coefficient(i, j, 2.0 * (x[0] + x[1])));
        }
        vec![rows]
    };
    let open = minimise_squares(vec![1.5, 0.0], twice, seen);
    assert!(matches!(open, Err(NonlinearError::Linear(LinearError::RankDeficient(_)))), "{open:?}");
}

/// Model of two blocks: the sine of a common unknown, and the product of a common unknown with one of the block.
#[test]
fn curved_model_converges_to_its_minimum() {
    let truth = [1.5, 0.7, 2.0, -1.0];
    let model = |x: &[f64], block: usize, t: f64| (x[0] * t).sin() + x[1] * x[2 + block] * t;
    let times: Vec<f64> = (1..8).map(|i| f64::from(i) * 0.2).collect();
    let noise = |block: usize, i: usize| 1e-3 * ((block * 7 + i) as f64 * 1.7).sin();
    // The product needs a second observation of x[1]: the last row of each block.
    let values =
        |x: &[f64], block: usize| -> Vec<f64> { times.iter().map(|t| model(x, block, *t)).chain([x[1]]).collect() };
    let residuals = |x: &[f64]| -> Vec<f64> {
        (0..2)
            .flat_map(|block| {
                let pairs = values(&truth, block).into_iter().zip(values(x, block));
                let rest = pairs.enumerate().map(move |(i, (m, v))| m + noise(block, i) - v);
                rest.collect::<Vec<_>>()
            })
            .collect()
    };
    // Solved once with each block's factor eliminated and once with all unknowns in one dense block.
    let rows = |x: &[f64], own: usize| {
        let y = residuals(x);
        let (blocks, common) = if own == 1 { (2, 2) } else { (1, 4) };
        let mut blocks = vec![BlockRows::zeros(16 / blocks, own, common); blocks];
        for (row, y) in y.iter().enumerate() {
            let (block, i) = (row / 8, row % 8);
            let (rows, row) = if own == 1 { (&mut blocks[block], i) } else { (&mut blocks[0], row) };
            rows.set_right_side(row, *y);
            let Some(t) = times.get(i) else {
                rows.set_common_coefficient(row, 1, 1.0);
                continue;
            };
            rows.set_common_coefficient(row, 0, t * (x[0] * t).cos());
            rows.set_common_coefficient(row, 1, x[2 + block] * t);
            match own {
                1 => rows.set_own_coefficient(row, 0, x[1] * t),
                _ => rows.set_common_coefficient(row, 2 + block, x[1] * t),
            }
        }
        blocks
    };
    let [found, dense] =
        [1, 0].map(|own| minimise_squares(vec![1.3, 0.9, 1.5, -0.5], |x| rows(x, own), residuals).unwrap());
    let [covariance, of_dense] = [&found, &dense].map(|minimum| minimum.factorisation.covariance());
    for j in 0..4 {
        assert!((found.x[j] / dense.x[j] - 1.0).abs() < 1e-10, "{j}");
        assert!((covariance[(j, j)] / of_dense[(j, j)] - 1.0).abs() < 1e-10, "{j}");
    }
    // At the minimum the gradient is zero: no first-order change lowers the sum of squares.
    let sum = |x: &[f64]| residuals(x).iter().map(|r| r * r).sum::<f64>();
    for j in 0..4 {
        let at = |h: f64| {
            let mut x = found.x.clone();
            x[j] += h;
            sum(&x)
        };
        assert!((at(1e-4) - at(-1e-4)).abs() < 1e-11, "{j}: {:e}", at(1e-4) - at(-1e-4));
        assert!(at(1e-4) > sum(&found.x));
    }
    assert!((found.x[0] - truth[0]).abs() < 1e-2);
}
