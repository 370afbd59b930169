//! Sources of uncertainty and their effects on the radii, mm (METHODS sections 1 and 6).

use nalgebra::Vector3;

use super::model::{Layout, Observation};
use super::observe::ObservedAxis;
use super::settings::Spindle;
use crate::identification::declared::{
    RotaryMotion, angular_motion_patterns, drift_mm_per_s, half_backlash_mm,
    linear_motion_patterns, lobing_patterns, repeatability_mm, resolution_mm, rotary_motions,
    stylus_offset_mm,
};
use crate::identification::{self, Effect, EvaluationType, InResiduals, UncertaintySource};
use machine::Axis;
use machine::kinematics::{ErrorParameter, Shape};
use machine::record::plan::Plan;

/// All sources, with the scatter of the touches first. `heights`: heights of the touches, machine frame, mm.
pub fn sources(
    plan: &Plan,
    layout: &Layout,
    seen: &[Observation],
    spindle: Spindle,
    seconds_per_unit: f64,
    heights: &[f64],
) -> Vec<UncertaintySource> {
    let normals: Vec<Vector3<f64>> = seen.iter().map(|s| layout.normal(s.phi)).collect();
    let repeatability = Effect::Each(vec![repeatability_mm(plan); seen.len()]);
    let repeatability = UncertaintySource::new("repeatability of a touch", repeatability);
    let resolution = Effect::Each(normals.iter().map(|n| resolution_mm(plan, *n)).collect());
    let resolution = UncertaintySource::new("resolution", resolution);
    let mut list = vec![
        UncertaintySource { evaluation: EvaluationType::A, ..repeatability },
        UncertaintySource { shape: identification::Shape::Rectangular, ..resolution },
        absent_in_residuals("stylus offset", stylus_offset(plan, &normals, spindle)),
        absent_in_residuals("probe lobing", lobing(plan, &normals, spindle)),
        absent_in_residuals("backlash", backlash(plan, &normals)),
        absent_in_residuals(
            "error motions of X, Y and Z",
            linear_axes(plan, seen, &normals, heights),
        ),
    ];
    let angular = angular_motions(plan, seen, &normals, heights);
    list.push(absent_in_residuals("angular error motions of X, Y and Z", angular));
    if layout.drift_order == 0 {
        let columns = drift(plan, seen, &normals, seconds_per_unit);
        list.push(absent_in_residuals("thermal drift", columns));
    }
    list.retain(|source| !source.is_zero());
    list
}

/// A normal source of joint draws that does not contribute to the expectation of χ².
fn absent_in_residuals(name: &str, columns: Vec<Vec<f64>>) -> UncertaintySource {
    UncertaintySource {
        in_residuals: InResiduals::Absent,
        is_in_weights: false,
        ..UncertaintySource::new(name, Effect::Joint(columns))
    }
}

/// Error motions of the measured axis: the uncertainty of the known ones, and the declared ones at orders that are
/// multiples of N. No grid of N angles separates these orders from the location of the axis (METHODS section 1). If
/// the declared motion has no orders, all of it counts. All other error motions are measured.
pub fn rotary_axis(
    plan: &Plan,
    layout: &Layout,
    seen: &[Observation],
    axis: &ObservedAxis<'_>,
) -> Vec<UncertaintySource> {
    let angles: Vec<f64> = seen.iter().map(|seen| axis.angle(&layout.design, seen)).collect();
    let by_component = |component| axis.radii_by_motion(layout, seen, component);
    let is_lost = |error: &ErrorParameter| match error.shape() {
        Shape::Cos(n) | Shape::Sin(n) => (n as usize).is_multiple_of(layout.design.n),
        _ => false,
    };
    let motions = rotary_motions(plan, &[layout.design.n as u32]);
    let declared = motions.into_iter().filter(|motion| {
        let RotaryMotion { error, .. } = motion;
        error.axis() == axis.axis.axis && is_lost(error) && !axis.known.has(error.component())
    });
    let column = |RotaryMotion { error, size_mm }| {
        let by = by_component(error.component());
        angles.iter().zip(by).map(|(angle, by)| size_mm * error.factor(*angle) * by).collect()
    };
    let name = format!("error motions of {}", axis.axis.axis);
    let mut list = vec![absent_in_residuals(&name, declared.map(column).collect())];
    list.extend(axis.known.sources(&angles, by_component));
    list.retain(|source| !source.is_zero());
    list
}

/// Offset of the stylus from its stated position. If the spindle follows the probe angle, it changes only R.
fn stylus_offset(plan: &Plan, normals: &[Vector3<f64>], spindle: Spindle) -> Vec<Vec<f64>> {
    let u = stylus_offset_mm(plan);
    match spindle {
        Spindle::Follow => vec![vec![u; normals.len()]],
        Spindle::Fixed => [0, 1].map(|k| normals.iter().map(|n| u * n[k]).collect()).into(),
    }
}

/// Direction-dependent pre-travel. If the spindle follows the probe angle, it changes only R.
fn lobing(plan: &Plan, normals: &[Vector3<f64>], spindle: Spindle) -> Vec<Vec<f64>> {
    match spindle {
        Spindle::Follow => vec![vec![plan.probe.lobing_um * 1e-3; normals.len()]],
        Spindle::Fixed => lobing_patterns(plan, normals),
    }
}

/// Drift of X, Y and the radius at the declared rates.
fn drift(
    plan: &Plan,
    seen: &[Observation],
    normals: &[Vector3<f64>],
    seconds_per_unit: f64,
) -> Vec<Vec<f64>> {
    let rate = drift_mm_per_s(plan) * seconds_per_unit;
    let column = |component: fn(&Vector3<f64>) -> f64| {
        seen.iter().zip(normals).map(|(s, n)| rate * s.time * component(n)).collect()
    };
    vec![column(|n| n.x), column(|n| n.y), column(|_| 1.0)]
}

/// Backlash: each axis lags behind in the direction of the touch, which is opposite to the ray.
fn backlash(plan: &Plan, normals: &[Vector3<f64>]) -> Vec<Vec<f64>> {
    let half = half_backlash_mm(plan);
    [0, 1].map(|k| normals.iter().map(|n| -half[k] * n[k].abs()).collect()).into()
}

/// Contact points relative to the axis at the mean height, where its location is reported.
fn points(seen: &[Observation], normals: &[Vector3<f64>], heights: &[f64]) -> Vec<Vector3<f64>> {
    let mean = heights.iter().sum::<f64>() / heights.len() as f64;
    let point = |(s, n): (&Observation, &Vector3<f64>)| {
        n * s.radius + Vector3::z() * (heights[s.height] - mean)
    };
    seen.iter().zip(normals).map(point).collect()
}

/// Angular error motions of X, Y and Z about the mean height. At this height they are included in the declared
/// straightness. A rotation about Z acts across the ray.
fn angular_motions(
    plan: &Plan,
    seen: &[Observation],
    normals: &[Vector3<f64>],
    heights: &[f64],
) -> Vec<Vec<f64>> {
    let points = points(seen, normals, heights);
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
fn linear_axes(
    plan: &Plan,
    seen: &[Observation],
    normals: &[Vector3<f64>],
    heights: &[f64],
) -> Vec<Vec<f64>> {
    let points = points(seen, normals, heights);
    let along_ray = |pattern: &[f64], k: usize| {
        pattern.iter().zip(normals).map(|(value, n)| -value * n[k]).collect::<Vec<f64>>()
    };
    let patterns = linear_motion_patterns(plan, &points);
    patterns.iter().flat_map(|pattern| [0, 1].map(|k| along_ray(pattern, k))).collect()
}

/// Steps in interruptions. The references are touched with the axis at 0. They measure a step, but not whether the
/// table moved, as the fit assumes, or the part on the table, which turns with the axis. All shares are equally
/// likely. `x`: the solution with its steps.
pub fn interruptions(layout: &Layout, seen: &[Observation], x: &[f64]) -> UncertaintySource {
    let column = |gap: usize, k: usize| {
        let step = x[layout.step(k, gap)] / 3f64.sqrt();
        let at = |s: &Observation| {
            let theta = layout.design.theta(s.c, s.phi);
            let turned = layout.normal(theta)[k] - layout.normal(s.phi)[k];
            step * layout.stepped(s, gap) * turned
        };
        seen.iter().map(at).collect()
    };
    let columns = (0..layout.gaps.len()).flat_map(|gap| [0, 1].map(|k| column(gap, k))).collect();
    let source = absent_in_residuals("what moved when interrupted", columns);
    UncertaintySource { shape: identification::Shape::Rectangular, ..source }
}
