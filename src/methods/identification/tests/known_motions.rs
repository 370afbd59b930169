//! Error motions of earlier estimates: which are accepted, which are refused, and their uncertainty.

use machine::Axis;
use machine::record::estimate::Estimate;
use serde_json::{Value, json};

use super::assert_near;
use crate::identification::{KnownErrorMotions, ObservationEffect};

/// A function over a revolution in steps of 45°: EXC is 2·cos 2C − 1 µm with u = 0.5 µm at each point.
fn motion_function(symbol: &str, axis: &str, unit: &str) -> Value {
    let x: Vec<f64> = (0..=8).map(|i| 45.0 * f64::from(i)).collect();
    let y: Vec<f64> = x.iter().map(|deg| 2.0 * (2.0 * deg.to_radians()).cos() - 1.0).collect();
    json!({"symbol": symbol, "argument": axis, "argument_unit": "deg", "x": x, "unit": unit, "y": y,
        "u": vec![0.5; 9]})
}

fn estimate_with_functions(functions: &[Value]) -> Estimate {
    serde_json::from_value(json!({
        "trued_estimate": 1, "method": "ball-plate", "parameters": [], "functions": functions,
        "covariance": {"symbols": [], "rows": []}, "rank": 1, "unknowns": 1, "condition": 1.0,
        "gauge": [], "not_identifiable": [], "residual_rms_um": 0.3, "degrees_of_freedom": 5,
        "chi2_per_dof": 1.1, "verdict": "none", "warnings": [], "priors": [],
    }))
    .unwrap()
}

/// An estimate with the coefficients 2 and 0.5 µm of order 2, of u = 0.3 and 0.4 µm.
fn estimate_with_coefficients() -> Estimate {
    let parameter = |symbol: &str, value: f64, u: f64| {
        json!({"symbol": symbol, "value": value, "unit": "um", "u": u, "U": 2.0 * u, "k": 2.0,
            "dof": null, "identifiable": true})
    };
    let mut estimate = estimate_with_functions(&[motion_function("EXC", "C", "um")]);
    let parameters = [parameter("EXC_c2", 2.0, 0.3), parameter("EXC_s2", 0.5, 0.4)];
    estimate.parameters = serde_json::from_value(parameters.to_vec().into()).unwrap();
    estimate.covariance.symbols = vec!["EXC_c2".to_owned(), "EXC_s2".to_owned()];
    estimate.covariance.rows = vec![vec![0.09, 0.06], vec![0.06, 0.16]];
    estimate
}

fn known_motion_mm(known: &KnownErrorMotions<'_>, degrees: f64) -> f64 {
    let angle = degrees.to_radians();
    known.error_terms_at(angle).iter().map(|term| term.value * term.parameter.shape_factor(angle)).sum()
}

/// The draws of the only source, for one observation per angle.
fn draws_of_only_source(known: &KnownErrorMotions<'_>, degrees: &[f64]) -> Vec<Vec<f64>> {
    let angles: Vec<f64> = degrees.iter().map(|deg| deg.to_radians()).collect();
    let sources = known.uncertainty_sources(&angles, |_| vec![-1.0; angles.len()]);
    assert_eq!(sources.len(), 1);
    match &sources[0].effect {
        ObservationEffect::Joint(columns) => columns.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn coefficients_with_covariance_are_preferred_to_points() {
    let priors = [estimate_with_coefficients()];
    let known = KnownErrorMotions::new(Axis::C, &priors).unwrap();
    for degrees in [20.0_f64, 380.0, -700.0] {
        let (sin, cos) = (2.0 * degrees.to_radians()).sin_cos();
        assert_near(known_motion_mm(&known, degrees), (2.0 * cos + 0.5 * sin) * 1e-3, 1e-15);
    }
    let draws = draws_of_only_source(&known, &[0.0, 45.0]);
    let covariance = |i: usize, j: usize| draws.iter().map(|d| d[i] * d[j]).sum::<f64>();
    assert_near(covariance(0, 0), 0.09e-6, 1e-18);
    assert_near(covariance(1, 1), 0.16e-6, 1e-18);
    assert_near(covariance(0, 1), 0.06e-6, 1e-18);
    let words = "known error motions from an estimate of ball-plate: EXC from its Fourier coefficients up to order 2";
    assert_eq!(known.describe(), [words]);
}

/// The mean is subtracted; u is the same draw at all angles.
#[test]
fn points_are_interpolated_linearly_and_fully_correlated() {
    let mut without_covariance = estimate_with_coefficients();
    without_covariance.covariance.rows.pop();
    for prior in [estimate_with_functions(&[motion_function("EXC", "C", "um")]), without_covariance] {
        let priors = [prior];
        let known = KnownErrorMotions::new(Axis::C, &priors).unwrap();
        for (degrees, um) in [(0.0, 2.0), (22.5, 1.0), (90.0, -2.0), (-22.5, 1.0)] {
            assert_near(known_motion_mm(&known, degrees), um * 1e-3, 1e-15);
        }
        assert_eq!(draws_of_only_source(&known, &[0.0, 22.5]).len(), 1);
        draws_of_only_source(&known, &[0.0, 22.5])[0].iter().for_each(|mm| assert_near(*mm, -0.5e-3, 1e-15));
    }
}

#[test]
fn estimates_without_usable_error_motions_are_refused() {
    let reason = |priors: &[Estimate]| KnownErrorMotions::new(Axis::C, priors).unwrap_err().reason;
    let of_b = estimate_with_functions(&[motion_function("EXB", "B", "um")]);
    assert!(reason(&[of_b]).ends_with("the function EXB is of the axis B"));
    for other in ["EXC_total", "EXC_spectrum", "EXC@Z50.0", "W_form", "EXX"] {
        let found = reason(&[estimate_with_functions(&[motion_function(other, "C", "um")])]);
        assert!(found.contains("no error motions of C") && found.ends_with("no such function"));
    }
    assert!(reason(&[estimate_with_functions(&[motion_function("EXC", "C", "urad")])]).ends_with("no such function"));
    let of = |symbol: &str, unit: &str| estimate_with_functions(&[motion_function(symbol, "C", unit)]);
    assert_eq!(reason(&[of("EXC", "um"), of("EXC", "um")]), "two estimates contain EXC");
    let mut turns = of("EXC", "um");
    turns.functions[0].x.iter_mut().for_each(|deg| *deg *= 3.0);
    assert!(reason(&[turns]).contains("EXC of the estimate of ball-plate covers more than one revolution"));
    let priors = [of("EXC", "um"), of("EAC", "urad")];
    let known = KnownErrorMotions::new(Axis::C, &priors).unwrap();
    assert!(
        known.has_component(Axis::X)
            && known.has_component(Axis::A)
            && !known.has_component(Axis::Y)
            && !known.is_empty()
    );
}
