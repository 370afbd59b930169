//! Sources of uncertainty, as changes of the observations of [`SensorEquations`] (METHODS section 6).

use nalgebra::Vector3;

use super::model::SensorEquations;
use super::observe::{CALIBRATION_STEP_LABEL, SensorMean, SphereDisplacement};
use crate::identification::azimuth_dependence::{DEFAULT_LOBING_ORDERS, azimuth_patterns};
use crate::identification::declared_sources::{
    backlash_lags_mm, drift_rate_sd_mm_per_s, linear_motion_patterns, linearity_patterns, resolution_u_mm,
};
use crate::identification::{
    DrawDistribution, EvaluationType, ObservationEffect, ObservationEquation, ResidualTreatment, UncertaintySource,
    block_covariances,
};
use machine::{Axis, Position};

/// Assumed standard deviation of one sample if none is declared, mm. The residuals rescale it.
const DEFAULT_SAMPLE_NOISE_STD_MM: f64 = 1e-4;
/// Lower bound of the standard uncertainty of an observation, mm. It limits the weight of the observation.
const OBSERVATION_STD_U_FLOOR_MM: f64 = 1e-6;

/// All sources at the solution `x`.
pub fn uncertainty_sources(equation: &SensorEquations<'_>, x: &[f64]) -> Vec<UncertaintySource> {
    let list = SourceBuilder { equation, x };
    let mut all = vec![
        list.noise_source(),
        list.resolution_source(),
        list.linearity_source(),
        list.sphere_form_source(),
        list.unweighted_joint_source("stylus offset", list.stylus_offset_columns()),
        list.unweighted_joint_source("backlash", list.backlash_columns()),
        list.unweighted_joint_source("error motions of X, Y and Z", list.linear_axis_error_columns()),
        list.unweighted_joint_source("thermal drift", list.drift_columns()),
    ];
    all.retain(|source| !source.is_zero());
    all
}

/// Standard uncertainty of each observation, mm, from the sources that are independent between observations, at the
/// initial values of the unknowns.
pub fn observation_standard_uncertainties(equation: &SensorEquations<'_>) -> Vec<f64> {
    let x = equation.initial_values();
    let list = SourceBuilder { equation, x: &x };
    let independent = [
        list.noise_source(),
        list.resolution_source(),
        list.unweighted_joint_source("stylus offset", list.stylus_offset_columns()),
    ];
    let independent = independent.map(|source| UncertaintySource { is_in_weights: true, ..source });
    let variances = block_covariances::<1>(&independent, equation.observation_count());
    variances.iter().map(|variance| variance[(0, 0)].sqrt().max(OBSERVATION_STD_U_FLOOR_MM)).collect()
}

struct SourceBuilder<'a> {
    equation: &'a SensorEquations<'a>,
    x: &'a [f64],
}

impl SourceBuilder<'_> {
    /// A source with the declared size, independent of the residuals, that does not enter the weights.
    fn unweighted_joint_source(&self, name: &str, columns: Vec<Vec<f64>>) -> UncertaintySource {
        UncertaintySource {
            residual_treatment: ResidualTreatment::InExpectedChi2,
            is_in_weights: false,
            ..UncertaintySource::new(name, ObservationEffect::Joint(columns))
        }
    }

    /// Change of the observations: of each mean, then of the sphere's position.
    fn observation_column(&self, of_mean: impl Fn(&SensorMean) -> f64, of_sphere: [f64; 2]) -> Vec<f64> {
        self.equation.means.iter().map(of_mean).chain(of_sphere).collect()
    }

    fn sensor_gradient(&self, mean: &SensorMean) -> Vector3<f64> {
        self.equation.sensor_gradient(self.x, mean.sensor_index)
    }

    fn noise_source(&self) -> UncertaintySource {
        let sensors = &self.equation.nest.sensors;
        let of_sample =
            |mean: &SensorMean| sensors[mean.sensor_index].noise_um.map_or(DEFAULT_SAMPLE_NOISE_STD_MM, |um| um * 1e-3);
        let each = self.observation_column(|mean| of_sample(mean) / (mean.sample_count as f64).sqrt(), [0.0; 2]);
        let noise = UncertaintySource::new("noise of the sensor", ObservationEffect::Independent(each));
        UncertaintySource { evaluation: EvaluationType::A, ..noise }
    }

    /// Resolution of the displayed positions: one draw for each point of the calibration and axis, and for the
    /// sphere's position.
    fn resolution_source(&self) -> UncertaintySource {
        let u = |axis: Axis| resolution_u_mm(self.equation.nest.plan, axis.nominal_direction());
        let moved: Vec<Vector3<f64>> = self.equation.means.iter().filter_map(calibration_displacement).collect();
        let mut columns = Vec::new();
        let mut points: Vec<Vector3<f64>> = Vec::new();
        for point in moved {
            if points.contains(&point) {
                continue;
            }
            points.push(point);
            for (k, axis) in Axis::LINEAR.into_iter().enumerate() {
                let of_mean = |mean: &SensorMean| match calibration_displacement(mean) == Some(point) {
                    true => self.sensor_gradient(mean)[k] * u(axis),
                    false => 0.0,
                };
                columns.push(self.observation_column(of_mean, [0.0; 2]));
            }
        }
        columns.push(self.observation_column(|_| 0.0, [u(Axis::X), 0.0]));
        columns.push(self.observation_column(|_| 0.0, [0.0, u(Axis::Y)]));
        let source = UncertaintySource::new("resolution of the axes", ObservationEffect::Joint(columns));
        UncertaintySource { draw_distribution: DrawDistribution::Rectangular, ..source }
    }

    /// Linearity error: a smooth random function of the reading of each sensor.
    fn linearity_source(&self) -> UncertaintySource {
        let mut columns = Vec::new();
        for (number, sensor) in self.equation.nest.sensors.iter().enumerate() {
            let means = &self.equation.means;
            let own = means.iter().filter(|mean| mean.sensor_index == number);
            let readings: Vec<f64> = own.map(|mean| mean.reading_mm).collect();
            for pattern in linearity_patterns(sensor, &readings) {
                let mut values = pattern.into_iter();
                columns.push(
                    means
                        .iter()
                        .map(|mean| match mean.sensor_index == number {
                            true => values.next().unwrap_or_default(),
                            false => 0.0,
                        })
                        .chain([0.0; 2])
                        .collect(),
                );
            }
        }
        self.unweighted_joint_source("linearity of the sensor", columns)
    }

    /// Form of the sphere. The sensors turn around the sphere, so the first harmonic of the form is a displacement of
    /// the sphere.
    fn sphere_form_source(&self) -> UncertaintySource {
        let form_sd_mm = self.equation.nest.settings.u_sphere_form_um * 1e-3;
        let normals = self.equation.means.iter().map(|mean| {
            let towards = mean.machine_from_table * self.sensor_gradient(mean);
            // The form is declared for the circle around the spindle's axis that the sensors measure.
            -Vector3::new(towards.x, towards.y, 0.0).normalize()
        });
        let patterns = azimuth_patterns(form_sd_mm, &DEFAULT_LOBING_ORDERS, &normals.collect::<Vec<_>>(), |_| true);
        let columns = patterns.into_iter().map(|pattern| pattern.into_iter().map(|by| -by).chain([0.0; 2]).collect());
        self.unweighted_joint_source("form of the sphere", columns.collect())
    }

    /// Offset of the sphere's centre from the spindle's axis.
    fn stylus_offset_columns(&self) -> Vec<Vec<f64>> {
        let u = self.equation.nest.plan.probe.u_stylus_offset_um * 1e-3;
        vec![self.observation_column(|_| 0.0, [u, 0.0]), self.observation_column(|_| 0.0, [0.0, u])]
    }

    /// Backlash. During the calibration the backlash follows the path. At the stops it is the same as at the end of the
    /// calibration.
    fn backlash_columns(&self) -> Vec<Vec<f64>> {
        let nest = self.equation.nest;
        let calibration = nest.plan.steps.iter().find(|step| step.label == CALIBRATION_STEP_LABEL);
        let path = calibration.and_then(|step| step.scan.as_ref()).map_or(&[][..], |scan| &scan.path);
        let xyz: Vec<Vector3<f64>> = path.iter().map(Position::xyz_or_zero).collect();
        let lags = backlash_lags_mm(nest.plan, &xyz);
        let at_stops = lags.last().copied().unwrap_or_default();
        let displacements: Vec<Vector3<f64>> = path.iter().map(|at| nest.sphere_displacement_at(at)).collect();
        // The mean of a point includes all visits of it.
        let mean_lag_change = |by: Vector3<f64>| -> Vector3<f64> {
            let visits = displacements.iter().zip(&lags).filter(|(position, _)| **position == by);
            let lag_changes: Vec<Vector3<f64>> = visits.map(|(_, lag)| lag - at_stops).collect();
            lag_changes.iter().sum::<Vector3<f64>>() / lag_changes.len().max(1) as f64
        };
        let column = |k: usize| {
            let of_mean = |mean: &SensorMean| match mean.displacement {
                SphereDisplacement::Known(by) => {
                    let along = Axis::LINEAR[k].nominal_direction() * mean_lag_change(by)[k];
                    self.sensor_gradient(mean).dot(&(mean.machine_from_table.inverse() * along))
                }
                SphereDisplacement::UnknownAtStop(_) => 0.0,
            };
            self.observation_column(of_mean, [0, 1].map(|axis| if axis == k { -at_stops[k] } else { 0.0 }))
        };
        [0, 1, 2].map(column).into()
    }

    /// Errors of the linear axes at the position of the sphere. They do not change over the short moves of the
    /// calibration.
    fn linear_axis_error_columns(&self) -> Vec<Vec<f64>> {
        let nest = self.equation.nest;
        let patterns = linear_motion_patterns(nest.plan, &[nest.origin.xyz_or_zero()]);
        let at_sphere = patterns.into_iter().filter_map(|pattern| pattern.first().copied());
        at_sphere
            .flat_map(|by| [[by, 0.0], [0.0, by]])
            .map(|of_sphere| self.observation_column(|_| 0.0, of_sphere))
            .collect()
    }

    /// Drift of the table relative to the spindle at the declared rate, zero at the mean time.
    fn drift_columns(&self) -> Vec<Vec<f64>> {
        let rate = drift_rate_sd_mm_per_s(self.equation.nest.plan);
        let means = self.equation.means;
        let mean_s = means.iter().map(|mean| mean.mean_time_in_run_s).sum::<f64>() / means.len().max(1) as f64;
        let column = |axis: Axis| {
            let of_mean = |mean: &SensorMean| {
                let along = mean.machine_from_table.inverse() * axis.nominal_direction();
                self.sensor_gradient(mean).dot(&along) * rate * (mean.mean_time_in_run_s - mean_s)
            };
            self.observation_column(of_mean, [0.0; 2])
        };
        Axis::LINEAR.map(column).into()
    }
}

/// Displacement of the sphere by the calibration. `None` at the origin and at the stops.
fn calibration_displacement(mean: &SensorMean) -> Option<Vector3<f64>> {
    match mean.displacement {
        SphereDisplacement::Known(by) if by != Vector3::zeros() => Some(by),
        _ => None,
    }
}
