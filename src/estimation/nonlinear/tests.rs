//! One published problem and the typed failures; all of NIST's stand in tests/nist_strd.

use faer::Mat;

use super::*;
use crate::estimation::linear::LinearError;

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

fn misra(b: &[f64]) -> Linearised {
    let model = |x: f64| b[0] * (1.0 - (-b[1] * x).exp());
    Linearised {
        residuals: MISRA1A.iter().map(|(y, x)| y - model(*x)).collect(),
        jacobian: Mat::from_fn(14, 2, |i, j| {
            let x = MISRA1A[i].1;
            if j == 0 { 1.0 - (-b[1] * x).exp() } else { b[0] * x * (-b[1] * x).exp() }
        }),
    }
}

#[test]
fn paper_nist_misra1a_certified_values() {
    let settings = Settings { damping: Some(1e-3), ..Settings::default() };
    let found = minimise(&[500.0, 1e-4], &[1.0; 14], None, &settings, misra).unwrap().at;
    assert!((found.x[0] / 2.389_421_291_8e2 - 1.0).abs() < 1e-9, "{:?}", found.x);
    assert!((found.x[1] / 5.501_564_318_1e-4 - 1.0).abs() < 1e-9, "{:?}", found.x);
    assert!((found.chi2 / 1.245_513_889_4e-1 - 1.0).abs() < 1e-9);
    let scale = (found.chi2 / found.dof as f64).sqrt();
    let deviation = [0, 1].map(|j| scale * found.covariance[(j, j)].sqrt());
    assert!((deviation[0] / 2.707_007_524_1 - 1.0).abs() < 1e-6, "{deviation:?}");
    assert!((deviation[1] / 7.266_868_806_0e-6 - 1.0).abs() < 1e-6, "{deviation:?}");
    // From near, pure Gauss–Newton ends at the same place.
    let near = minimise(&[250.0, 5e-4], &[1.0; 14], None, &Settings::default(), misra).unwrap();
    assert!((near.at.x[0] / found.x[0] - 1.0).abs() < 1e-9);
}

#[test]
fn regress_failures_are_typed() {
    let few = Settings { max_steps: 2, ..Settings::default() };
    let stopped = minimise(&[500.0, 1e-4], &[1.0; 14], None, &few, misra);
    assert!(matches!(stopped, Err(NonlinearError::NotConverged { .. })), "{stopped:?}");
    // Only the sum of two unknowns is seen: refused without, solved with the gauge.
    let twice = |x: &[f64]| Linearised {
        residuals: vec![4.0 - (x[0] + x[1]).powi(2); 2],
        jacobian: Mat::from_fn(2, 2, |_, _| 2.0 * (x[0] + x[1])),
    };
    for damping in [None, Some(1e-3)] {
        let settings = Settings { damping, ..Settings::default() };
        let open = minimise(&[1.5, 0.0], &[1.0; 2], None, &settings, twice);
        assert!(matches!(open, Err(NonlinearError::Linear(LinearError::RankDeficient(_)))));
        let gauge = Mat::from_fn(1, 2, |_, j| [1.0, -1.0][j]);
        let fixed =
            minimise(&[1.5, 0.0], &[1.0; 2], Some(gauge.as_ref()), &settings, twice).unwrap();
        assert!((fixed.at.x[0] - 1.75).abs() < 1e-9 && (fixed.at.x[1] - 0.25).abs() < 1e-9);
    }
}
