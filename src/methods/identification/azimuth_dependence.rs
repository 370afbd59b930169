//! Deviations that depend on the azimuth of a contact, and the size of each order from a declared total.

use std::f64::consts::TAU;

use nalgebra::Vector3;

/// Harmonic orders of pre-travel if none are declared. Lower orders are the radius and the stylus offset.
pub const DEFAULT_LOBING_ORDERS: [u32; 5] = [2, 3, 4, 5, 6];

/// Orders, each with the standard deviation of its cosine and of its sine part. `declared` orders share the variance
/// equally. If none are declared, each of the `possible` orders gets the total, so that the worst case is
/// never too small.
pub fn harmonic_sd_by_order(total: f64, declared: &[u32], possible: &[u32]) -> Vec<(u32, f64)> {
    let (orders, size) = match declared {
        [] => (possible, total),
        orders => (orders, total / (orders.len() as f64).sqrt()),
    };
    orders.iter().map(|order| (*order, size)).collect()
}

/// cos kα of the azimuth α of the unit vector `normal` (spindle frame), or sin kα with a `phase_turns` of
/// 0.25 (revolutions), times the sine of the angle between `normal` and the spindle axis.
pub fn azimuth_factor(order: u32, phase_turns: f64, normal: &Vector3<f64>) -> f64 {
    let phase = f64::from(order) * normal.y.atan2(normal.x) - phase_turns * TAU;
    normal.x.hypot(normal.y) * phase.cos()
}

/// Patterns of a deviation of standard deviation `total_mm` that depends on the direction
/// ([`azimuth_factor`]) of the outward unit `normals` of the contacts. `declared`: its orders, if known;
/// `is_included`: whether an order is included. The patterns follow the order of the declared orders, cosine
/// before sine.
pub fn azimuth_patterns(
    total_mm: f64,
    declared: &[u32],
    normals: &[Vector3<f64>],
    is_included: impl Fn(u32) -> bool,
) -> Vec<Vec<f64>> {
    let pattern = |(order, size): (u32, f64), phase_turns: f64| {
        normals.iter().map(|normal| size * azimuth_factor(order, phase_turns, normal)).collect()
    };
    let sizes = harmonic_sd_by_order(total_mm, declared, &DEFAULT_LOBING_ORDERS).into_iter();
    let sizes = sizes.filter(|(order, _)| is_included(*order));
    sizes.flat_map(|size| [0.0, 0.25].map(|turns| pattern(size, turns))).collect()
}
