//! Prediction, before the measurement, of what a layout of radial sensors and indexes separates: noise gain, best
//! angle of the third sensor.

use std::ops::RangeInclusive;

use estimation::revolutions::{AngleRange, ChannelAtMounting, HarmonicData};
use faer::c64;

use super::fit::SeparationFit;
use super::model::{MotionOrForm, ProbeLayout};
use super::outputs::ReportedMotions;
use crate::MethodRefusal;

/// Harmonics by which layouts are ranked.
pub const LAYOUT_RANKING_HARMONICS: RangeInclusive<usize> = 2..=20;
/// Minimum angle between two sensors, and between a sensor and the opposite side of another. Sensors at a smaller angle
/// do not separate X from Y.
pub const MIN_ANGLE_BETWEEN_SENSORS_DEG: f64 = 5.0;
/// Step of the search for the angle of a third sensor.
const THIRD_ANGLE_SEARCH_STEP_DEG: usize = 10;

/// Selection of the measurements of a layout that are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeparationMethod {
    /// All sensors at the first index only.
    Multiprobe,
    /// The first two sensors at every index.
    Multistep,
    /// All sensors at every index.
    Combined,
}

/// Each of the harmonics `orders`, from 2 on, with its noise gain: standard uncertainty of a coefficient of EXC
/// divided by that of one sensor, for radial sensors of one section. The value is infinite if the order is not
/// determined.
///
/// # Errors
/// An angle is not finite.
pub fn noise_gain_by_order(
    layout: &ProbeLayout,
    separation: SeparationMethod,
    orders: RangeInclusive<usize>,
) -> Result<Vec<(usize, f64)>, MethodRefusal> {
    let is_used = |row: &ChannelAtMounting| match separation {
        SeparationMethod::Multiprobe => row.mounting_index == 0,
        SeparationMethod::Multistep => row.channel_index < 2,
        SeparationMethod::Combined => true,
    };
    let rows = layout.all_row_keys().into_iter().filter(is_used).collect();
    let fit = unit_noise_fit(layout, rows, *orders.end())?;
    let motions = ReportedMotions::new(layout, &fit);
    let gain = |order: usize| match motions.is_identifiable(MotionOrForm::X, order) {
        true => (order, fit.blocks[order - 1].solution.covariance[(0, 0)].sqrt()),
        false => (order, f64::INFINITY),
    };
    Ok(orders.map(gain).collect())
}

/// Root mean square of the noise gains over [`LAYOUT_RANKING_HARMONICS`].
pub fn rms_noise_gain(layout: &ProbeLayout, separation: SeparationMethod) -> Result<f64, MethodRefusal> {
    let gains = noise_gain_by_order(layout, separation, LAYOUT_RANKING_HARMONICS)?;
    Ok(crate::identification::rms(&gains.iter().map(|(_, gain)| *gain).collect::<Vec<_>>()))
}

/// Fit of the harmonics 1..=`orders` to zeros, each observation with a standard uncertainty of 1 mm: its covariance
/// gives the noise gains.
pub fn unit_noise_fit(
    layout: &ProbeLayout,
    rows: Vec<ChannelAtMounting>,
    orders: usize,
) -> Result<SeparationFit, MethodRefusal> {
    let means = vec![vec![c64::ZERO; rows.len()]; orders];
    let data = HarmonicData::from_declared_uncertainty(rows, means, 1.0, 2);
    let refused = |why: String| MethodRefusal::new(why, "correct angles and heights of the sensors");
    SeparationFit::new(layout, &data).map_err(|error| refused(error.to_string()))
}

/// Angles of the third sensor in steps of [`THIRD_ANGLE_SEARCH_STEP_DEG`] outside the `obstructed_ranges`, with the
/// noise gain of the multiprobe separation, in ascending order of the noise gain. Angles that do not determine all
/// [`LAYOUT_RANKING_HARMONICS`] are omitted.
pub fn third_sensor_angles_and_gains(pair_deg: [f64; 2], obstructed_ranges: &[AngleRange]) -> Vec<(f64, f64)> {
    let is_free = |deg: &f64| {
        !obstructed_ranges.iter().any(|range| range.contains(*deg))
            && pair_deg
                .iter()
                .all(|other| acute_angle_between_sensors_deg(*deg, *other) >= MIN_ANGLE_BETWEEN_SENSORS_DEG)
    };
    let gain = |deg: f64| {
        let layout = ProbeLayout::with_radial_sensors(&[pair_deg[0], pair_deg[1], deg], 1);
        Some((deg, rms_noise_gain(&layout, SeparationMethod::Multiprobe).ok()?))
    };
    let free = (0..360).step_by(THIRD_ANGLE_SEARCH_STEP_DEG).map(f64::from).filter(is_free);
    let mut candidates: Vec<(f64, f64)> = free.filter_map(gain).filter(|(_, gain)| gain.is_finite()).collect();
    candidates.sort_by(|a, b| a.1.total_cmp(&b.1));
    candidates
}

/// Acute angle between the lines of two sensors, 0 to 90°: opposed sensors have 0°.
pub fn acute_angle_between_sensors_deg(a_deg: f64, b_deg: f64) -> f64 {
    let angle_deg = (a_deg - b_deg).rem_euclid(180.0);
    angle_deg.min(180.0 - angle_deg)
}
