//! Comparison of the declared sources with the declarations of a plan.

use machine::Axis;
use machine::record::plan::Plan;
use nalgebra::Vector3;
use serde_json::json;

use super::assert_near;
use crate::identification::declared_sources::{
    control_resolution_mm, drift_rate_sd_mm_per_s, linear_motion_patterns, lobing_patterns, repeatability_mm,
    resolution_u_mm, rotary_error_motions,
};

fn plan() -> Plan {
    let axis = |resolution_um: f64, error_motion_um: f64| {
        json!({"min": -500.0, "max": 500.0, "resolution_um": resolution_um,
            "error_motion_um": error_motion_um, "error_wavelength_mm": 50.0})
    };
    serde_json::from_value(json!({
        "trued_plan": 1, "method": "none", "settings": null,
        "machine": {
            "name": "test", "topology": "w-C-B-X-F-Z-Y-S-t", "drift_um_per_h": 7.2,
            "axes": {"X": axis(3.0, 2.0), "Y": axis(4.0, 0.0), "B": axis(0.0, 0.0), "C": axis(0.0, 1.0)},
        },
        "probe": {"ball_radius_mm": 3.0, "lobing_um": 0.5, "lobing_orders": [2, 3, 4, 5, 6]},
        "artefact": {"kind": "balls"},
    }))
    .unwrap()
}

/// Covariance of two contacts: Σ of the products of the pattern entries; with i = j, the variance.
fn contact_covariance(patterns: &[Vec<f64>], i: usize, j: usize) -> f64 {
    patterns.iter().map(|pattern| pattern[i] * pattern[j]).sum()
}

#[test]
fn repeatability_resolution_and_drift_are_as_declared() {
    let mut plan = plan();
    assert_near(repeatability_mm(&plan), 1e-3, 0.0);
    plan.probe.repeatability_um = Some(0.25);
    assert_near(repeatability_mm(&plan), 0.25e-3, 1e-18);
    assert_near(control_resolution_mm(&plan, Vector3::x()), 3e-3, 1e-18);
    let diagonal = Vector3::new(0.6, 0.8, 0.0);
    assert_near(control_resolution_mm(&plan, diagonal), (1.8_f64.hypot(3.2)) * 1e-3, 1e-17);
    assert_near(resolution_u_mm(&plan, -Vector3::y()), 4e-3 / 12f64.sqrt(), 1e-18);
    assert_near(drift_rate_sd_mm_per_s(&plan), 2e-6, 1e-20);
}

/// The variance is the declared one at each azimuth and zero at the pole. The correlation between two
/// contacts is the mean of the cosines.
#[test]
fn lobing_has_the_declared_variance_at_each_azimuth() {
    let at = |turns: f64| {
        let (sin, cos) = (turns * std::f64::consts::TAU).sin_cos();
        Vector3::new(cos, sin, 0.0)
    };
    let normals = [at(0.0), at(0.1), at(0.37), Vector3::z(), Vector3::new(0.6, 0.0, 0.8)];
    let patterns = lobing_patterns(&plan(), &normals);
    assert_eq!(patterns.len(), 10);
    for i in 0..3 {
        assert_near(contact_covariance(&patterns, i, i), 0.25e-6, 1e-18);
    }
    assert_near(contact_covariance(&patterns, 3, 3), 0.0, 1e-30);
    assert_near(contact_covariance(&patterns, 4, 4), 0.36 * 0.25e-6, 1e-18);
    let cosines: f64 = (2..=6).map(|n| (f64::from(n) * 0.1 * std::f64::consts::TAU).cos()).sum();
    assert_near(contact_covariance(&patterns, 0, 1), 0.25e-6 * cosines / 5.0, 1e-18);
    // Cosine comes before sine: the first pattern of each pair is largest along X.
    assert!(patterns.iter().step_by(2).all(|p| p[0] > 0.0));
    assert!(patterns.iter().skip(1).step_by(2).all(|p| p[0].abs() < 1e-18));
}

/// f(x) − f(0) has the covariance of σ²·exp(−Δ²/2ℓ²), for X only: Y declares no error motion, and Z does not
/// exist.
#[test]
fn linear_motions_have_the_declared_covariance() {
    let points = [0.0, 30.0, -80.0].map(|x| Vector3::new(x, 17.0, 5.0));
    let patterns = linear_motion_patterns(&plan(), &points);
    let bell = |d: f64| (-0.5 * (d / 50.0).powi(2)).exp();
    for (i, u) in [0.0, 30.0, -80.0].into_iter().enumerate() {
        for (j, v) in [0.0, 30.0, -80.0].into_iter().enumerate() {
            let expected = 4e-6 * (bell(u - v) - bell(u) - bell(v) + 1.0);
            assert_near(contact_covariance(&patterns, i, j), expected, 1e-14);
        }
    }
}

/// Motions of C only: four harmonics, cosine and sine, along X, Y and Z, with the declared variance at each
/// angle.
#[test]
fn rotary_motions_share_the_declared_variance() {
    let mut plan = plan();
    plan.machine.axes.get_mut(&Axis::C).unwrap().error_motion_orders = vec![2, 3, 4, 5];
    let motions = rotary_error_motions(&plan, &[8]);
    assert_eq!(motions.len(), 4 * 2 * 3);
    assert!(motions.iter().all(|motion| motion.error.axis() == Axis::C));
    let total: f64 = motions.iter().map(|motion| motion.coefficient_sd_mm.powi(2)).sum();
    // The squares of cosine and sine of an angle sum to one.
    assert_near(total / 2.0, 3.0 * 1e-6, 1e-18);
    let symbols: Vec<String> = motions[..4].iter().map(|motion| motion.error.to_string()).collect();
    assert_eq!(symbols, ["EXC_cos2", "EYC_cos2", "EZC_cos2", "EXC_sin2"]);
}

/// If the orders are not declared, each order gets the whole total.
#[test]
fn each_order_gets_the_whole_size_if_no_orders_are_declared() {
    let mut plan = plan();
    let motions = rotary_error_motions(&plan, &[3, 8]);
    assert_eq!(motions.len(), 2 * 2 * 3);
    assert!(motions.iter().all(|motion| motion.coefficient_sd_mm == 1e-3));
    plan.probe.lobing_orders.clear();
    let patterns = lobing_patterns(&plan, &[Vector3::x()]);
    let sizes: Vec<f64> = patterns.iter().step_by(2).map(|pattern| pattern[0]).collect();
    assert_eq!(sizes, [0.5e-3; 5]);
    plan.probe.lobing_orders = vec![3];
    let three_lobes = lobing_patterns(&plan, &[Vector3::x(), -Vector3::x()]);
    assert_eq!(three_lobes.len(), 2);
    assert_near(three_lobes[0][0] + three_lobes[0][1], 0.0, 1e-18);
}
