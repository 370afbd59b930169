//! Deviations that depend on the azimuth of a contact, and the size of each order from a declared total.

use std::f64::consts::TAU;

use nalgebra::Vector3;

/// Harmonic orders of pre-travel if none are declared. Lower orders are the radius and the stylus offset.
pub const DEFAULT_LOBING_ORDERS: [u32; 5] = [2, 3, 4, 5, 6];

/// Orders, each with the standard deviation of its cosine and of its sine part. The `declared_orders` share the
/// variance equally. If none are declared, each of the `possible_orders` gets the total, so that the worst case is
/// never too small.
pub fn harmonic_sd_by_order(total_sd: f64, declared_orders: &[u32], possible_orders: &[u32]) -> Vec<(u32, f64)> {
    let (orders, size) = match declared_orders {
        [] => (possible_orders, total_sd),
        orders => (orders, total_sd / (orders.len() as f64).sqrt()),
    };
    orders.iter().map(|order| (*order, size)).collect()
}

/// cos kα of the azimuth α of the unit vector `normal` (spindle frame), or sin kα with a `phase_turns` of
/// 0.25 (revolutions), times the sine of the angle between `normal` and the spindle axis.
pub fn azimuth_factor(order: u32, phase_turns: f64, normal: &Vector3<f64>) -> f64 {
    let phase = f64::from(order) * normal.y.atan2(normal.x) - phase_turns * TAU;
    normal.x.hypot(normal.y) * phase.cos()
}

/// Patterns of a deviation of standard deviation `total_sd_mm` that depends on the direction ([`azimuth_factor`]) of
/// the outward unit `normals` of the contacts. `declared_orders`: its orders; if empty, [`DEFAULT_LOBING_ORDERS`].
/// `includes_order`: whether the patterns of an order are returned. They are in the sequence of the orders, cosine
/// before sine.
pub fn azimuth_patterns(
    total_sd_mm: f64,
    declared_orders: &[u32],
    normals: &[Vector3<f64>],
    includes_order: impl Fn(u32) -> bool,
) -> Vec<Vec<f64>> {
    let pattern = |(order, size): (u32, f64), phase_turns: f64| {
        normals.iter().map(|normal| size * azimuth_factor(order, phase_turns, normal)).collect()
    };
    let sizes = harmonic_sd_by_order(total_sd_mm, declared_orders, &DEFAULT_LOBING_ORDERS).into_iter();
    let sizes = sizes.filter(|(order, _)| includes_order(*order));
    sizes.flat_map(|size| [0.0, 0.25].map(|turns| pattern(size, turns))).collect()
}
