//! Sizes and patterns of the sources that the plan declares for probe and axes (METHODS section 6). A pattern
//! is the deviation by one draw of unit variance, mm, with one entry per contact (a touch or a dwell point).

use std::f64::consts::PI;

use estimation::revolutions::{ChannelRevolutions, HarmonicData};
use estimation::smooth_functions::{smooth_change_from_zero_columns, stationary_function_columns};
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape};
use machine::record::machine::StatedAxis;
use machine::record::plan::Plan;
use machine::record::sensor::Sensor;
use nalgebra::Vector3;

use super::azimuth_dependence::{azimuth_patterns, harmonic_sd_by_order};
use super::probe_map::ProbeMap;

/// Harmonic orders of the error motion of a rotary axis if none are declared. The mean is the location of the axis, and
/// the first harmonic is inseparable from the position of the carried artefact or sensor.
pub const DEFAULT_ROTARY_MOTION_ORDERS: [u32; 4] = [2, 3, 4, 5];
/// Assumed standard uncertainty of one touch if none is declared, mm; the residuals rescale it.
const ASSUMED_REPEATABILITY_MM: f64 = 1e-3;

/// Cosine or sine part of one harmonic of the error motion of a rotary axis along X, Y or Z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotaryErrorMotion {
    pub error: ErrorParameter,
    /// Standard deviation of the coefficient of this part, mm.
    pub coefficient_sd_mm: f64,
}

/// Standard uncertainty of one touch, mm: the declared value, or the assumed one if none is declared.
pub fn repeatability_mm(plan: &Plan) -> f64 {
    plan.probe.repeatability_um.map_or(ASSUMED_REPEATABILITY_MM, |um| um * 1e-3)
}

/// Resolution of the position displayed by the control along the unit vector `normal` (machine frame), mm.
pub fn control_resolution_mm(plan: &Plan, normal: Vector3<f64>) -> f64 {
    let width = |axis| plan.machine.axes.get(&axis).map_or(0.0, |spec| spec.resolution_um * 1e-3);
    Vector3::from(Axis::LINEAR.map(width)).component_mul(&normal).norm()
}

/// Standard uncertainty from rounding of the displayed position along the unit vector `normal` (machine
/// frame), mm: rectangular over one step (JCGM 100, F.2.2.1).
pub fn resolution_u_mm(plan: &Plan, normal: Vector3<f64>) -> f64 {
    control_resolution_mm(plan, normal) / 12f64.sqrt()
}

/// Standard uncertainty of a mean of touches from the steps of the display (`step_mm`), mm. The rounding error is a
/// sawtooth function of the true position. Scatter of σ multiplies its first harmonic by exp(−2π²σ²/a²) and reduces
/// the higher ones more. The part that the scatter does not average out remains. `s_mm`: standard deviation of the
/// displayed positions, rounding included.
pub fn rounding_u_of_mean_mm(step_mm: f64, s_mm: f64) -> f64 {
    if step_mm <= 0.0 {
        return 0.0;
    }
    let own = (s_mm / step_mm).powi(2) - 1.0 / 12.0;
    step_mm / 12f64.sqrt() * (-2.0 * PI * PI * own.max(0.0)).exp()
}

/// Standard deviation of the drift rate of the table relative to the spindle, along each axis, mm/s.
pub fn drift_rate_sd_mm_per_s(plan: &Plan) -> f64 {
    plan.machine.drift_um_per_h * 1e-3 / 3600.0
}

/// Standard uncertainty of one coordinate of a point, mm, from the declared errors of the axes and, for a touch, of the
/// probe. `t_s`: time since the start of the run, s, for the drift.
pub fn coordinate_std_u_mm(plan: &Plan, is_touch: bool, t_s: f64) -> f64 {
    let along = |axis: Axis| plan.machine.axes.get(&axis).map_or(0.0, |spec| spec.resolution_um);
    let rounding = Axis::LINEAR.map(along).into_iter().fold(0.0, f64::max) * 1e-3 / 12f64.sqrt();
    let motions = plan.machine.axes.values().map(|spec| (spec.error_motion_um * 1e-3).powi(2));
    let probe = if is_touch { repeatability_mm(plan).hypot(plan.probe.lobing_um * 1e-3) } else { 0.0 };
    let drift = drift_rate_sd_mm_per_s(plan) * t_s;
    (motions.sum::<f64>() + probe.powi(2) + rounding.powi(2) + drift.powi(2)).sqrt()
}

/// Half of the declared lost motion of X, Y and Z, mm: the lag of an axis behind the direction of a touch.
pub fn half_backlash_mm(plan: &Plan) -> Vector3<f64> {
    let half = |axis| plan.machine.axes.get(&axis).map_or(0.0, |spec| spec.backlash_um * 0.5e-3);
    Vector3::from(Axis::LINEAR.map(half))
}

/// Deviation of the true positions of X, Y and Z from the displayed ones after each move through `positions`
/// (mm), from the declared lost motion. An axis follows its command once the backlash is taken up. At the
/// first position the deviation is zero.
pub fn backlash_lags_mm(plan: &Plan, positions: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let half = half_backlash_mm(plan);
    let mut lag = Vector3::zeros();
    let moves = positions.windows(2).map(|two| two[1] - two[0]);
    let first = positions.first().map(|_| Vector3::zeros());
    let lags = moves.map(|by| {
        lag = (lag - by).zip_map(&half, |lag: f64, half| lag.clamp(-half, half));
        lag
    });
    first.into_iter().chain(lags).collect()
}

/// Direction-dependent pre-travel ([`azimuth_patterns`]). For a qualified probe: the part that its map does
/// not contain.
pub fn lobing_patterns(plan: &Plan, normals: &[Vector3<f64>]) -> Vec<Vec<f64>> {
    let (lobing_sd_mm, orders) = (plan.probe.lobing_um * 1e-3, &plan.probe.lobing_orders);
    // A map that cannot be used is refused earlier.
    match ProbeMap::from_plan(plan) {
        Ok(Some(map)) => map.uncertainty_patterns(lobing_sd_mm, orders, normals),
        _ => azimuth_patterns(lobing_sd_mm, orders, normals, |_| true),
    }
}

/// Standard uncertainty of the stated stylus offset in each of X and Y, mm; 0 for a probe whose offset is
/// qualified.
pub fn stylus_offset_u_mm(plan: &Plan) -> f64 {
    match ProbeMap::from_plan(plan) {
        Ok(Some(map)) if map.subtracts_order(1) => 0.0,
        _ => plan.probe.u_stylus_offset_um * 1e-3,
    }
}

/// Correlation length of the linearity error of a sensor, as a fraction of its range. Linearity errors with
/// two to six periods over the range correspond to 0.04 where the slope at one reading matters (r-test) and
/// to 0.025 where the readings span a part of a period (laser R-test).
const LINEARITY_CORRELATION_SHARE: f64 = 0.032;

/// Linearity error of a sensor: a smooth random function of its `readings`, mm. Readings closer than a
/// hundredth of the correlation length have the same error.
pub fn linearity_patterns(sensor: &Sensor, readings: &[f64]) -> Vec<Vec<f64>> {
    if sensor.linearity_um == 0.0 {
        return Vec::new();
    }
    let length_mm = LINEARITY_CORRELATION_SHARE * (sensor.range_mm[1] - sensor.range_mm[0]);
    let per_mm = 100.0 / length_mm;
    let readings: Vec<f64> = readings.iter().map(|mm| (mm * per_mm).round() / per_mm).collect();
    stationary_function_columns(&readings, sensor.linearity_um * 1e-3, length_mm)
}

/// Effects of the linearity errors on the harmonics of revolutions, mm, one entry per observation of `data`.
/// The error of each sensor is a smooth random function of its reading. It is the same in all rows and is
/// evaluated over their mean revolutions. `sensors` must be in the order of the channels.
pub fn linearity_effects_on_harmonics(
    sensors: &[Sensor],
    rows: &[ChannelRevolutions],
    data: &HarmonicData,
) -> Vec<Vec<f64>> {
    let revolutions: Vec<Vec<f64>> = rows.iter().map(ChannelRevolutions::mean_revolution).collect();
    let mut columns = Vec::new();
    for (channel, sensor) in sensors.iter().enumerate() {
        let is_own = |row: &ChannelRevolutions| row.key.channel_index == channel;
        let own = rows.iter().zip(&revolutions).filter(|(row, _)| is_own(row));
        let readings: Vec<f64> = own.flat_map(|(_, of)| of.iter().map(|m| -m)).collect();
        for pattern in linearity_patterns(sensor, &readings) {
            let mut errors = pattern.iter().map(|error| -error);
            let mut of_row = |(row, of): (&ChannelRevolutions, &Vec<f64>)| match is_own(row) {
                true => errors.by_ref().take(of.len()).collect(),
                false => vec![0.0; of.len()],
            };
            let effects: Vec<Vec<f64>> = rows.iter().zip(&revolutions).map(&mut of_row).collect();
            columns.push(data.revolution_observations(&effects));
        }
    }
    columns
}

/// Error motions of X, Y and Z at the axis positions `points` (machine coordinates, mm): a smooth random function of
/// the position of each axis, zero at position zero. The caller applies each pattern along X, Y and Z independently.
pub fn linear_motion_patterns(plan: &Plan, points: &[Vector3<f64>]) -> Vec<Vec<f64>> {
    random_linear_axis_functions(plan, points, |spec| spec.error_motion_um * 1e-3)
        .into_iter()
        .flat_map(|of| of.1)
        .collect()
}

/// Smooth random functions of the position of each of X, Y and Z at the axis positions `points` (rounded to 1 mm),
/// relative to position zero; `size`: their standard deviation before this subtraction. An axis without declared size
/// has none.
fn random_linear_axis_functions(
    plan: &Plan,
    points: &[Vector3<f64>],
    size: fn(&StatedAxis) -> f64,
) -> Vec<(Axis, Vec<Vec<f64>>)> {
    let functions = |(k, axis): (usize, Axis)| {
        let spec = plan.machine.axes.get(&axis).filter(|spec| size(spec) > 0.0)?;
        let positions: Vec<f64> = points.iter().map(|point| point[k].round()).collect();
        Some((axis, smooth_change_from_zero_columns(&positions, size(spec), spec.error_wavelength_mm)))
    };
    Axis::LINEAR.into_iter().enumerate().filter_map(functions).collect()
}

/// Angular error motions of X, Y and Z at the axis positions `points` (machine coordinates, mm): rotations
/// about X, Y and Z that are smooth random functions of the axis position, rad per draw, zero at position
/// zero.
pub fn angular_motion_patterns(plan: &Plan, points: &[Vector3<f64>]) -> Vec<(ErrorParameter, Vec<f64>)> {
    let mut patterns = Vec::new();
    for (axis, functions) in random_linear_axis_functions(plan, points, |spec| spec.angular_motion_urad * 1e-6) {
        for about in [Axis::A, Axis::B, Axis::C] {
            let error = ErrorParameter::new(about, axis, ErrorShape::Location).ok();
            patterns.extend(functions.iter().filter_map(|function| Some((error?, function.clone()))));
        }
    }
    patterns
}

/// Translational error motions of the rotary axes and the spindle (ISO 230-7) with a declared size.
/// `possible_orders`: orders for an axis that declares none. Order of the list: axis; harmonic, cosine before sine;
/// X, Y, Z.
pub fn rotary_error_motions(plan: &Plan, possible_orders: &[u32]) -> Vec<RotaryErrorMotion> {
    let rotary = plan.machine.axes.iter().filter(|(axis, _)| !axis.is_linear());
    let mut motions = Vec::new();
    for (axis, spec) in rotary.filter(|(_, spec)| spec.error_motion_um > 0.0) {
        let error_motion_sd_mm = spec.error_motion_um * 1e-3;
        let terms = harmonic_sd_by_order(error_motion_sd_mm, &spec.error_motion_orders, possible_orders);
        for (n, coefficient_sd_mm) in terms {
            for shape in [ErrorShape::Cos(n), ErrorShape::Sin(n)] {
                let errors = Axis::LINEAR.map(|along| ErrorParameter::new(along, *axis, shape));
                let errors = errors.into_iter().flatten();
                motions.extend(errors.map(|error| RotaryErrorMotion { error, coefficient_sd_mm }));
            }
        }
    }
    motions
}
