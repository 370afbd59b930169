//! Observation equations of the sensors: the reading as a function of the sphere's displacement.
//!
//! Unknowns, in this order: for each sensor its reading at the origin (mm) and its gradient (mm/mm, table frame);
//! the curvature of the surface that the sensors measure (1/mm: that of the sphere, or 0 for flat tips); the
//! sphere's centre in X and Y relative to the nominal axis (mm); for each interruption a step of the sphere (mm,
//! machine frame); for each stop except the first the displacement of the sphere relative to the sensor nest (mm, table
//! frame). At the first stop it is zero.

use estimation::schur::BlockRows;
use nalgebra::Vector3;

use super::observe::{ObservedMeans, SensorMean, SphereDisplacement};
use super::sensor_nest::SensorNest;
use crate::MethodRefusal;
use crate::identification::ObservationEquation;
use machine::record::sensor::Sensor;

/// Number of unknowns of a sensor.
const UNKNOWNS_PER_SENSOR: usize = 4;
/// Minimum cosine between the measured and the declared direction of a sensor: 20°.
const MIN_DIRECTION_COSINE: f64 = 0.94;
/// Maximum deviation of a sensor's gain from 1.
const MAX_GAIN_ERROR: f64 = 0.2;

/// Indices of the unknowns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnknownIndices {
    pub sensor_count: usize,
    /// Number of interruptions that have means before and after them.
    pub interruption_count: usize,
    /// Number of stops of the revolution. 0: none has been measured.
    pub stop_count: usize,
}

impl UnknownIndices {
    pub fn unknown_count(&self) -> usize {
        self.interruption_displacement_index(self.interruption_count) + 3 * self.stop_count.saturating_sub(1)
    }

    /// Index of the sensor's reading at the origin.
    pub fn sensor_offset_index(&self, sensor: usize) -> usize {
        UNKNOWNS_PER_SENSOR * sensor
    }

    /// Index of X of the sensor's gradient: change of its reading by a displacement of the sphere, mm/mm, table
    /// frame.
    pub fn sensor_gradient_index(&self, sensor: usize) -> usize {
        self.sensor_offset_index(sensor) + 1
    }

    /// Index of the curvature of the measured surface, 1/mm: one unknown for all sensors.
    pub fn curvature_index(&self) -> usize {
        UNKNOWNS_PER_SENSOR * self.sensor_count
    }

    /// Index of X of the sphere's centre relative to the nominal axis. Y is the next unknown.
    pub fn sphere_position_index(&self) -> usize {
        self.curvature_index() + 1
    }

    /// Index of X of the displacement at an interruption. Y and Z are the next unknowns.
    pub fn interruption_displacement_index(&self, interruption: usize) -> usize {
        self.sphere_position_index() + 2 + 3 * interruption
    }

    /// Index of X of the displacement at a stop; Y and Z are the next unknowns. `None` for the first stop, where the
    /// displacement is zero.
    pub fn stop_displacement_index(&self, stop: usize) -> Option<usize> {
        Some(self.interruption_displacement_index(self.interruption_count) + 3 * stop.checked_sub(1)?)
    }

    pub fn vector_at(x: &[f64], first: usize) -> Vector3<f64> {
        Vector3::from_column_slice(&x[first..first + 3])
    }

    pub fn unknown_names(&self, sensors: &[&str]) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for name in sensors {
            names.extend(["offset", "X", "Y", "Z"].map(|part| format!("{name} {part}")));
        }
        names.extend(["curvature", "sphere X", "sphere Y"].map(str::to_owned));
        let vectors = (1..=self.interruption_count).map(|number| format!("step {number}"));
        let stops = (1..self.stop_count).map(|stop| format!("stop {stop}"));
        for name in vectors.chain(stops) {
            names.extend(["X", "Y", "Z"].map(|axis| format!("{name} {axis}")));
        }
        names
    }
}

/// Observation equations of all means of the sensors, with the weights of the fit.
pub struct SensorEquations<'a> {
    pub nest: &'a SensorNest<'a>,
    pub means: &'a [SensorMean],
    pub unknowns: UnknownIndices,
    /// Standard uncertainty of each mean, then of the sphere's position in X and Y, mm. All 1 in unweighted equations.
    pub observation_std_u_mm: Vec<f64>,
}

impl<'a> SensorEquations<'a> {
    /// The equation with unit weights.
    pub fn unweighted(nest: &'a SensorNest<'a>, observed: &'a ObservedMeans) -> Self {
        let means = observed.means.as_slice();
        let is_stop = |mean: &SensorMean| matches!(mean.displacement, SphereDisplacement::UnknownAtStop(_));
        let stops = if means.iter().any(is_stop) { nest.settings.positions } else { 0 };
        let interruptions = means.iter().map(|mean| mean.earlier_interruption_count).max().unwrap_or(0);
        let unknowns =
            UnknownIndices { sensor_count: nest.sensors.len(), interruption_count: interruptions, stop_count: stops };
        Self { nest, means, unknowns, observation_std_u_mm: vec![1.0; means.len() + 2] }
    }

    /// Initial values: the sensors as the plan declares them, with the sphere on the axis of each.
    pub fn initial_values(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.unknowns.unknown_count()];
        for (number, sensor) in self.nest.sensors.iter().enumerate() {
            x[self.unknowns.sensor_gradient_index(number)..][..3].copy_from_slice(&sensor.direction);
        }
        x[self.unknowns.curvature_index()] = 1.0 / self.nest.plan.probe.ball_radius_mm;
        let first = self.unknowns.sphere_position_index();
        x[first..first + 2].copy_from_slice(self.nest.sphere_offset_from_axis_mm.xy().as_slice());
        x
    }

    pub fn sensor_gradient(&self, x: &[f64], sensor: usize) -> Vector3<f64> {
        UnknownIndices::vector_at(x, self.unknowns.sensor_gradient_index(sensor))
    }

    /// Displacement of the sphere relative to the nest at a mean, from its place at the origin, table frame, mm.
    fn sphere_displacement(&self, mean: &SensorMean, x: &[f64]) -> Vector3<f64> {
        let own = match mean.displacement {
            SphereDisplacement::Known(displacement) => displacement,
            SphereDisplacement::UnknownAtStop(stop) => {
                let first = self.unknowns.stop_displacement_index(stop);
                first.map_or(Vector3::zeros(), |first| UnknownIndices::vector_at(x, first))
            }
        };
        let displacements = (0..mean.earlier_interruption_count)
            .map(|i| UnknownIndices::vector_at(x, self.unknowns.interruption_displacement_index(i)));
        own + mean.machine_from_table.inverse() * displacements.sum::<Vector3<f64>>()
    }

    /// Reading of a sensor: z + g·w + κ(|w|² − (n·w)²)/2 with n along g. The last term is the effect of the
    /// sphere's curvature across the sensor's direction.
    fn predicted_reading(&self, mean: &SensorMean, x: &[f64]) -> f64 {
        let w = self.sphere_displacement(mean, x);
        let gradient = self.sensor_gradient(x, mean.sensor_index);
        let across = w - gradient * (gradient.dot(&w) / gradient.norm_squared());
        x[self.unknowns.sensor_offset_index(mean.sensor_index)]
            + gradient.dot(&w)
            + x[self.unknowns.curvature_index()] / 2.0 * across.norm_squared()
    }

    /// Derivatives of a reading that are not always zero: index of the unknown, and derivative.
    pub fn reading_derivatives(&self, mean: &SensorMean, x: &[f64]) -> Vec<(usize, f64)> {
        let unknowns = &self.unknowns;
        let w = self.sphere_displacement(mean, x);
        let gradient = self.sensor_gradient(x, mean.sensor_index);
        let along = gradient.dot(&w) / gradient.norm_squared();
        let across = w - gradient * along;
        let curvature = x[unknowns.curvature_index()];
        let by_gradient = w - across * (curvature * along);
        let by_displacement = gradient + across * curvature;
        let mut slopes = vec![
            (unknowns.sensor_offset_index(mean.sensor_index), 1.0),
            (unknowns.curvature_index(), across.norm_squared() / 2.0),
        ];
        let mut add = |first: usize, by: Vector3<f64>| slopes.extend((first..).zip(by.iter().copied()));
        add(unknowns.sensor_gradient_index(mean.sensor_index), by_gradient);
        if let SphereDisplacement::UnknownAtStop(stop) = mean.displacement
            && let Some(first) = unknowns.stop_displacement_index(stop)
        {
            add(first, by_displacement);
        }
        (0..mean.earlier_interruption_count)
            .for_each(|i| add(unknowns.interruption_displacement_index(i), mean.machine_from_table * by_displacement));
        slopes
    }

    /// Displayed minus fitted position of the sphere in X and Y.
    fn sphere_position_residuals(&self, x: &[f64]) -> [f64; 2] {
        let first = self.unknowns.sphere_position_index();
        [0, 1].map(|k| self.nest.sphere_offset_from_axis_mm[k] - x[first + k])
    }

    /// Weighted residuals and their derivatives at `x`, as one block in which all unknowns are common.
    pub fn row_blocks(&self, x: &[f64]) -> Vec<BlockRows> {
        let residuals = self.weighted_residuals(x, &vec![0.0; self.observation_count()]);
        let mut rows = BlockRows::zeros(residuals.len(), 0, self.unknowns.unknown_count());
        residuals.into_iter().enumerate().for_each(|(row, value)| rows.set_right_side(row, value));
        for (row, (mean, sigma)) in self.means.iter().zip(&self.observation_std_u_mm).enumerate() {
            for (unknown, slope) in self.reading_derivatives(mean, x) {
                rows.set_common_coefficient(row, unknown, slope / sigma);
            }
        }
        for k in 0..2 {
            let row = self.means.len() + k;
            rows.set_common_coefficient(
                row,
                self.unknowns.sphere_position_index() + k,
                1.0 / self.observation_std_u_mm[row],
            );
        }
        vec![rows]
    }

    /// # Errors
    /// A sensor has another direction or gain than declared.
    pub fn check_sensor_directions_and_gains(&self, x: &[f64]) -> Result<(), MethodRefusal> {
        for (number, sensor) in self.nest.sensors.iter().enumerate() {
            let gradient = self.sensor_gradient(x, number);
            let cosine = |sensor: &Sensor| gradient.normalize().dot(&Vector3::from(sensor.direction));
            if cosine(sensor) < MIN_DIRECTION_COSINE {
                let swapped = self.nest.sensors.iter().find(|other| cosine(other) >= MIN_DIRECTION_COSINE);
                return Err(refuse_direction(&sensor.name, gradient, swapped.map(|s| s.name.as_str())));
            }
            MethodRefusal::require(
                (gradient.norm() - 1.0).abs() <= MAX_GAIN_ERROR,
                format!(
                    "the reading of sensor {} changes by {:.2} mm if the sphere moves by 1 mm along its direction",
                    sensor.name,
                    gradient.norm()
                ),
                "correct the scale of the sensor in [[sensor]], and start a new run",
            )?;
        }
        Ok(())
    }
}

/// `matching_sensor`: another sensor whose declared direction is the measured one; the cables may be exchanged.
fn refuse_direction(name: &str, gradient: Vector3<f64>, matching_sensor: Option<&str>) -> MethodRefusal {
    let [i, j, k]: [f64; 3] = gradient.into();
    let reason = format!(
        "sensor {name} measures displacements along [{i:.2}, {j:.2}, {k:.2}], not along its \
         declared direction"
    );
    match matching_sensor {
        Some(other) => MethodRefusal::new(
            format!("{reason}, but along the direction of {other}"),
            format!("exchange the cables of {name} and {other}, or their addresses in [[sensor]]"),
        ),
        None => MethodRefusal::new(
            reason,
            "correct the direction of the sensor in [[sensor]], or check that the sensor measures the sphere; then \
             start a new run",
        ),
    }
}

/// Observations: the means, then the displayed position of the sphere in X and Y relative to the nominal axis.
impl ObservationEquation for SensorEquations<'_> {
    fn observation_count(&self) -> usize {
        self.means.len() + 2
    }

    fn weighted_residuals(&self, x: &[f64], change: &[f64]) -> Vec<f64> {
        let of_means = self.means.iter().map(|mean| mean.reading_mm - self.predicted_reading(mean, x));
        let rows: Vec<f64> =
            of_means.chain(self.sphere_position_residuals(x)).zip(change).map(|(r, change)| r + change).collect();
        self.weighted_residual_change(&rows)
    }

    fn weighted_residual_change(&self, change: &[f64]) -> Vec<f64> {
        change.iter().zip(&self.observation_std_u_mm).map(|(change, sigma)| change / sigma).collect()
    }
}
