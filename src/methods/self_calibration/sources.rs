//! Sources of uncertainty and their effects on the radii, mm (METHODS sections 1 and 6).

use nalgebra::Vector3;

use super::model::{Observation, UnknownsLayout};
use super::observe::ObservedAxis;
use super::settings::SpindleMode;
use crate::identification::declared::{
    RotaryErrorMotion, angular_motion_patterns, drift_mm_per_s, half_backlash_mm, linear_motion_patterns,
    lobing_patterns, repeatability_mm, resolution_u_mm, rotary_error_motions, stylus_offset_u_mm,
};
use crate::identification::{self, Effect, EvaluationType, ResidualTreatment, UncertaintySource};
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape};
use machine::record::plan::Plan;

/// All sources, with the scatter of the touches first. `heights`: heights of the touches, machine frame, mm.
pub fn uncertainty_sources(
    plan: &Plan,
    layout: &UnknownsLayout,
    observations: &[Observation],
    spindle: SpindleMode,
    seconds_per_unit: f64,
    heights: &[f64],
) -> Vec<UncertaintySource> {
    let normals: Vec<Vector3<f64>> = observations.iter().map(|s| layout.normal(s.phi_index)).collect();
    let repeatability = Effect::Independent(vec![repeatability_mm(plan); observations.len()]);
    let repeatability = UncertaintySource::new("repeatability of a touch", repeatability);
    let resolution = Effect::Independent(normals.iter().map(|n| resolution_u_mm(plan, *n)).collect());
    let resolution = UncertaintySource::new("resolution", resolution);
    let mut list = vec![
        UncertaintySource { evaluation: EvaluationType::A, ..repeatability },
        UncertaintySource { shape: identification::DrawDistribution::Rectangular, ..resolution },
        source_absent_in_residuals("stylus offset", stylus_offset_columns(plan, &normals, spindle)),
        source_absent_in_residuals("probe lobing", lobing_columns(plan, &normals, spindle)),
        source_absent_in_residuals("backlash", backlash_columns(plan, &normals)),
        source_absent_in_residuals(
            "error motions of X, Y and Z",
            linear_axis_columns(plan, observations, &normals, heights),
        ),
    ];
    let angular = angular_motion_columns(plan, observations, &normals, heights);
    list.push(source_absent_in_residuals("angular error motions of X, Y and Z", angular));
    if layout.drift_order == 0 {
        let columns = drift_columns(plan, observations, &normals, seconds_per_unit);
        list.push(source_absent_in_residuals("thermal drift", columns));
    }
    list.retain(|source| !source.is_zero());
    list
}

/// A normal source of joint draws that does not contribute to the expectation of χ².
fn source_absent_in_residuals(name: &str, columns: Vec<Vec<f64>>) -> UncertaintySource {
    UncertaintySource {
        in_residuals: ResidualTreatment::Absent,
        is_in_weights: false,
        ..UncertaintySource::new(name, Effect::Joint(columns))
    }
}

/// Error motions of the measured axis: the uncertainty of the known ones, and the declared ones at orders that are
/// multiples of N. No grid of N angles separates these orders from the location of the axis (METHODS section 1). If
/// the declared motion has no orders, all of it counts. All other error motions are measured.
pub fn rotary_axis_sources(
    plan: &Plan,
    layout: &UnknownsLayout,
    observations: &[Observation],
    axis: &ObservedAxis<'_>,
) -> Vec<UncertaintySource> {
    let angles: Vec<f64> =
        observations.iter().map(|observations| axis.commanded_angle(&layout.design, observations)).collect();
    let by_component = |component| axis.radii_by_motion(layout, observations, component);
    let is_lost = |error: &ErrorParameter| match error.shape() {
        ErrorShape::Cos(n) | ErrorShape::Sin(n) => (n as usize).is_multiple_of(layout.design.position_count),
        _ => false,
    };
    let motions = rotary_error_motions(plan, &[layout.design.position_count as u32]);
    let declared = motions.into_iter().filter(|motion| {
        let RotaryErrorMotion { error, .. } = motion;
        error.axis() == axis.axis.axis && is_lost(error) && !axis.known_motions.has_component(error.component())
    });
    let column = |RotaryErrorMotion { error, size_mm }| {
        let by = by_component(error.component());
        angles.iter().zip(by).map(|(angle, by)| size_mm * error.factor(*angle) * by).collect()
    };
    let name = format!("error motions of {}", axis.axis.axis);
    let mut list = vec![source_absent_in_residuals(&name, declared.map(column).collect())];
    list.extend(axis.known_motions.sources(&angles, by_component));
    list.retain(|source| !source.is_zero());
    list
}

/// Offset of the stylus from its stated position. If the spindle follows the probe angle, it changes only R.
fn stylus_offset_columns(plan: &Plan, normals: &[Vector3<f64>], spindle: SpindleMode) -> Vec<Vec<f64>> {
    let u = stylus_offset_u_mm(plan);
    match spindle {
        SpindleMode::Follow => vec![vec![u; normals.len()]],
        SpindleMode::Fixed => [0, 1].map(|k| normals.iter().map(|n| u * n[k]).collect()).into(),
    }
}

/// Direction-dependent pre-travel. If the spindle follows the probe angle, it changes only R.
fn lobing_columns(plan: &Plan, normals: &[Vector3<f64>], spindle: SpindleMode) -> Vec<Vec<f64>> {
    match spindle {
        SpindleMode::Follow => vec![vec![plan.probe.lobing_um * 1e-3; normals.len()]],
        SpindleMode::Fixed => lobing_patterns(plan, normals),
    }
}

/// Drift of X, Y and the radius at the declared rates.
fn drift_columns(
    plan: &Plan,
    observations: &[Observation],
    normals: &[Vector3<f64>],
    seconds_per_unit: f64,
) -> Vec<Vec<f64>> {
    let rate = drift_mm_per_s(plan) * seconds_per_unit;
    let column = |component: fn(&Vector3<f64>) -> f64| {
        observations.iter().zip(normals).map(|(s, n)| rate * s.relative_time * component(n)).collect()
    };
    vec![column(|n| n.x), column(|n| n.y), column(|_| 1.0)]
}

/// Backlash: each axis lags behind in the direction of the touch, which is opposite to the ray.
fn backlash_columns(plan: &Plan, normals: &[Vector3<f64>]) -> Vec<Vec<f64>> {
    let half = half_backlash_mm(plan);
    [0, 1].map(|k| normals.iter().map(|n| -half[k] * n[k].abs()).collect()).into()
}

/// Contact points relative to the axis at the mean height, where its location is reported.
fn contact_points(observations: &[Observation], normals: &[Vector3<f64>], heights: &[f64]) -> Vec<Vector3<f64>> {
    let mean = heights.iter().sum::<f64>() / heights.len() as f64;
    let point = |(s, n): (&Observation, &Vector3<f64>)| n * s.radius_mm + Vector3::z() * (heights[s.height] - mean);
    observations.iter().zip(normals).map(point).collect()
}

/// Angular error motions of X, Y and Z about the mean height. At this height they are included in the declared
/// straightness. A rotation about Z acts across the ray.
fn angular_motion_columns(
    plan: &Plan,
    observations: &[Observation],
    normals: &[Vector3<f64>],
    heights: &[f64],
) -> Vec<Vec<f64>> {
    let points = contact_points(observations, normals, heights);
    let patterns = angular_motion_patterns(plan, &points);
    let column = |(error, angles): &(ErrorParameter, Vec<f64>)| {
        let about = match error.component() {
            Axis::A => Vector3::x(),
            Axis::B => Vector3::y(),
            _ => Vector3::z(),
        };
        let along = points.iter().zip(normals).map(|(p, n)| about.cross(p).dot(n));
        along.zip(angles).map(|(along, angle)| along * angle).collect()
    };
    patterns.iter().map(column).collect()
}

/// Positioning and straightness errors of X, Y and Z along the ray. Those of Z are relative to the mean height.
fn linear_axis_columns(
    plan: &Plan,
    observations: &[Observation],
    normals: &[Vector3<f64>],
    heights: &[f64],
) -> Vec<Vec<f64>> {
    let points = contact_points(observations, normals, heights);
    let along_ray =
        |pattern: &[f64], k: usize| pattern.iter().zip(normals).map(|(value, n)| -value * n[k]).collect::<Vec<f64>>();
    let patterns = linear_motion_patterns(plan, &points);
    patterns.iter().flat_map(|pattern| [0, 1].map(|k| along_ray(pattern, k))).collect()
}

/// Steps in interruptions. The references are touched with the axis at 0. They measure a step, but not whether the
/// table moved, as the fit assumes, or the part on the table, which turns with the axis. All shares are equally
/// likely. `x`: the solution with its steps.
pub fn interruption_source(layout: &UnknownsLayout, observations: &[Observation], x: &[f64]) -> UncertaintySource {
    let column = |gap: usize, k: usize| {
        let step = x[layout.step_index(k, gap)] / 3f64.sqrt();
        let at = |s: &Observation| {
            let theta = layout.design.theta_index(s.c_index, s.phi_index);
            let turned = layout.normal(theta)[k] - layout.normal(s.phi_index)[k];
            step * layout.step_function(s, gap) * turned
        };
        observations.iter().map(at).collect()
    };
    let columns = (0..layout.gaps.len()).flat_map(|gap| [0, 1].map(|k| column(gap, k))).collect();
    let source = source_absent_in_residuals("what moved when interrupted", columns);
    UncertaintySource { shape: identification::DrawDistribution::Rectangular, ..source }
}
