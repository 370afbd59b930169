//! Sources of uncertainty and their effects on the radii, mm (METHODS sections 1 and 6).

use nalgebra::Vector3;

use super::model::{RadiusObservation, UnknownsLayout};
use super::settings::SpindleMode;
use super::setup::SelfCalibrationSetup;
use crate::identification::declared_sources::{
    RotaryErrorMotion, angular_motion_patterns, drift_rate_sd_mm_per_s, half_backlash_mm, linear_motion_patterns,
    lobing_patterns, repeatability_mm, resolution_u_mm, rotary_error_motions, stylus_offset_u_mm,
};
use crate::identification::{self, EvaluationType, ObservationEffect, ResidualTreatment, UncertaintySource};
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape};
use machine::record::plan::Plan;

/// Sources of probe and linear axes, with the scatter of the touches first, and of thermal drift if no drift is fitted.
/// The sources of the rotary axis and of interruptions are separate functions. `seconds_per_unit`: unit of the times of
/// the observations, s.
pub fn uncertainty_sources(
    setup: &SelfCalibrationSetup<'_>,
    layout: &UnknownsLayout,
    observations: &[RadiusObservation],
    seconds_per_unit: f64,
) -> Vec<UncertaintySource> {
    let touches = MeasuredTouches::new(setup, layout, observations);
    let MeasuredTouches { plan, normals, .. } = &touches;
    let repeatability = ObservationEffect::Independent(vec![repeatability_mm(plan); observations.len()]);
    let repeatability = UncertaintySource::new("repeatability of a touch", repeatability);
    let resolution = ObservationEffect::Independent(normals.iter().map(|n| resolution_u_mm(plan, *n)).collect());
    let resolution = UncertaintySource::new("resolution", resolution);
    let mut list = vec![
        UncertaintySource { evaluation: EvaluationType::A, ..repeatability },
        UncertaintySource { draw_distribution: identification::DrawDistribution::Rectangular, ..resolution },
        source_absent_in_residuals("stylus offset", touches.stylus_offset_columns(setup.settings.spindle)),
        source_absent_in_residuals("probe lobing", touches.lobing_columns(setup.settings.spindle)),
        source_absent_in_residuals("backlash", touches.backlash_columns()),
        source_absent_in_residuals("error motions of X, Y and Z", touches.linear_axis_error_columns()),
        source_absent_in_residuals("angular error motions of X, Y and Z", touches.angular_motion_columns()),
    ];
    if layout.drift_order == 0 {
        list.push(source_absent_in_residuals("thermal drift", touches.drift_columns(seconds_per_unit)));
    }
    list.retain(|source| !source.is_zero());
    list
}

/// A normal source of joint draws that does not contribute to the expectation of χ².
fn source_absent_in_residuals(name: &str, columns: Vec<Vec<f64>>) -> UncertaintySource {
    UncertaintySource::new_unweighted(name, columns, ResidualTreatment::ExcludedFromChi2)
}

/// Error motions of the measured axis: the uncertainty of the known error motions, and the declared error motions at
/// orders that are multiples of N. Such orders look like the location of the axis at N equally spaced angles (METHODS
/// section 1). If the declared motion has no orders, all of it counts. All other error motions are measured.
pub fn rotary_axis_sources(
    setup: &SelfCalibrationSetup<'_>,
    layout: &UnknownsLayout,
    observations: &[RadiusObservation],
) -> Vec<UncertaintySource> {
    let SelfCalibrationSetup { plan, axis, known_motions, .. } = setup;
    // Commanded angles of the observations within a revolution, rad.
    let commanded_angle =
        |observation: &RadiusObservation| layout.design.grid_angle_rad(observation.c_index) * axis.clockwise_sign;
    let angles: Vec<f64> = observations.iter().map(commanded_angle).collect();
    let by_component = |component| radius_derivatives_by_motion(setup, layout, observations, component);
    let is_lost = |error: &ErrorParameter| match error.shape() {
        ErrorShape::Cos(n) | ErrorShape::Sin(n) => (n as usize).is_multiple_of(layout.design.angle_count),
        _ => false,
    };
    let motions = rotary_error_motions(plan, &[layout.design.angle_count as u32]);
    let declared = motions.into_iter().filter(|motion| {
        let RotaryErrorMotion { error, .. } = motion;
        error.axis() == axis.axis && is_lost(error) && !known_motions.has_component(error.component())
    });
    let column = |RotaryErrorMotion { error, coefficient_sd_mm: size_mm }| {
        let by = by_component(error.component());
        angles.iter().zip(by).map(|(angle, by)| size_mm * error.shape_factor(*angle) * by).collect()
    };
    let name = format!("error motions of {}", axis.axis);
    let mut list = vec![source_absent_in_residuals(&name, declared.map(column).collect())];
    list.extend(known_motions.uncertainty_sources(&angles, by_component));
    list.retain(|source| !source.is_zero());
    list
}

/// Derivative of each radius by an error motion of the axis along or about `component`.
fn radius_derivatives_by_motion(
    setup: &SelfCalibrationSetup<'_>,
    layout: &UnknownsLayout,
    observations: &[RadiusObservation],
    component: Axis,
) -> Vec<f64> {
    let of_radius = |observation: &RadiusObservation| {
        let normal = layout.ray_direction(observation.phi_index);
        let across = Vector3::z().cross(&normal);
        let centre = setup.axis.axis_point_at_height(setup.heights_in_machine_mm[observation.height_index])
            + observation.along_ray_mm * normal
            + observation.across_ray_mm * across;
        setup.axis.radius_derivative_by_motion(component, centre, normal)
    };
    observations.iter().map(of_radius).collect()
}

/// The touches whose radii the sources change.
struct MeasuredTouches<'a> {
    plan: &'a Plan,
    observations: &'a [RadiusObservation],
    /// Directions of the rays.
    normals: Vec<Vector3<f64>>,
    /// Centres of the stylus ball in contact, relative to the axis at the mean height, where its location is
    /// reported.
    stylus_centres_mm: Vec<Vector3<f64>>,
}

impl<'a> MeasuredTouches<'a> {
    fn new(setup: &SelfCalibrationSetup<'a>, layout: &UnknownsLayout, observations: &'a [RadiusObservation]) -> Self {
        let SelfCalibrationSetup { plan, heights_in_machine_mm: heights, .. } = setup;
        let normals: Vec<Vector3<f64>> = observations.iter().map(|s| layout.ray_direction(s.phi_index)).collect();
        let mean = heights.iter().sum::<f64>() / heights.len() as f64;
        let point = |(s, n): (&RadiusObservation, &Vector3<f64>)| {
            n * s.along_ray_mm + Vector3::z() * (heights[s.height_index] - mean)
        };
        let points = observations.iter().zip(&normals).map(point).collect();
        Self { plan, observations, normals, stylus_centres_mm: points }
    }

    /// Offset of the stylus from its stated position, in X and in Y. If the spindle follows the probe angle, the
    /// offset changes only R.
    fn stylus_offset_columns(&self, spindle: SpindleMode) -> Vec<Vec<f64>> {
        let u = stylus_offset_u_mm(self.plan);
        match spindle {
            SpindleMode::Follow => vec![vec![u; self.normals.len()]],
            SpindleMode::Fixed => [0, 1].map(|k| self.normals.iter().map(|n| u * n[k]).collect()).into(),
        }
    }

    /// Direction-dependent pre-travel. If the spindle follows the probe angle, the pre-travel changes only R.
    fn lobing_columns(&self, spindle: SpindleMode) -> Vec<Vec<f64>> {
        match spindle {
            SpindleMode::Follow => vec![vec![self.plan.probe.lobing_um * 1e-3; self.normals.len()]],
            SpindleMode::Fixed => lobing_patterns(self.plan, &self.normals),
        }
    }

    /// Drift of X, Y and the radius at the declared rates.
    fn drift_columns(&self, seconds_per_unit: f64) -> Vec<Vec<f64>> {
        let rate = drift_rate_sd_mm_per_s(self.plan) * seconds_per_unit;
        let column = |component: fn(&Vector3<f64>) -> f64| {
            let touches = self.observations.iter().zip(&self.normals);
            touches.map(|(s, n)| rate * s.relative_time * component(n)).collect()
        };
        vec![column(|n| n.x), column(|n| n.y), column(|_| 1.0)]
    }

    /// Backlash: each axis lags behind in the direction of the touch, which is opposite to the ray.
    fn backlash_columns(&self) -> Vec<Vec<f64>> {
        let half = half_backlash_mm(self.plan);
        [0, 1].map(|k| self.normals.iter().map(|n| -half[k] * n[k].abs()).collect()).into()
    }

    /// Angular error motions of X, Y and Z about the mean height. At this height they are included in the declared
    /// straightness. A rotation about Z acts across the ray.
    fn angular_motion_columns(&self) -> Vec<Vec<f64>> {
        let column = |(error, angles): (ErrorParameter, Vec<f64>)| {
            let about = error.component().nominal_direction();
            let along = self.stylus_centres_mm.iter().zip(&self.normals).map(|(p, n)| about.cross(p).dot(n));
            along.zip(angles).map(|(along, angle)| along * angle).collect()
        };
        angular_motion_patterns(self.plan, &self.stylus_centres_mm).into_iter().map(column).collect()
    }

    /// Positioning and straightness errors of X, Y and Z along the ray. Those of Z are relative to the mean height.
    fn linear_axis_error_columns(&self) -> Vec<Vec<f64>> {
        let along_ray = |pattern: &[f64], k: usize| -> Vec<f64> {
            pattern.iter().zip(&self.normals).map(|(value, n)| -value * n[k]).collect()
        };
        let patterns = linear_motion_patterns(self.plan, &self.stylus_centres_mm);
        patterns.iter().flat_map(|pattern| [0, 1].map(|k| along_ray(pattern, k))).collect()
    }
}

/// Cause of the steps at interruptions. The references are touched with the axis at 0. They measure a step, but not its
/// cause: the table moved, as the fit assumes, or the part moved on the table and turns with the axis. All shares of
/// the two causes are equally likely. `x`: the solution, including the steps.
pub fn interruption_step_source(
    layout: &UnknownsLayout,
    observations: &[RadiusObservation],
    x: &[f64],
) -> UncertaintySource {
    let column = |gap: usize, k: usize| {
        let step = x[layout.interruption_step_index(k, gap)] / 3f64.sqrt();
        let at = |s: &RadiusObservation| {
            let theta = layout.design.theta_index(s.c_index, s.phi_index);
            let turned = layout.ray_direction(theta)[k] - layout.ray_direction(s.phi_index)[k];
            step * layout.interruption_step_value(s, gap) * turned
        };
        observations.iter().map(at).collect()
    };
    let columns = (0..layout.interruption_times.len()).flat_map(|gap| [0, 1].map(|k| column(gap, k))).collect();
    let source = source_absent_in_residuals("what moved when interrupted", columns);
    UncertaintySource { draw_distribution: identification::DrawDistribution::Rectangular, ..source }
}
