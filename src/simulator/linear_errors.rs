//! Errors of the linear axes as functions of position: positioning, straightness, squareness, rotations.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use rand_distr::Distribution;

use super::random_draws::{RandomSource, draw_normal, standard_normals};
use estimation::random;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm};
use machine::{Axis, Position};

/// A random function of position with covariance σ²·exp(−Δ²/2ℓ²) (a sum of cosines of random frequency and
/// phase), shifted to be zero at position zero.
#[derive(Debug, Clone, PartialEq, Default)]
struct RandomFunction {
    /// Amplitude of each cosine, in the unit of the function: mm or rad.
    wave_amplitude: f64,
    /// (angular frequency per mm, phase in rad).
    frequencies_and_phases: Vec<(f64, f64)>,
    /// Value of the sum of cosines, amplitude included, at position zero; it is subtracted from the function.
    unshifted_value_at_zero: f64,
    /// Distance between two tabulated positions.
    knot_pitch_mm: f64,
    /// Value, and derivative times knot pitch, at multiples of the knot pitch, where the function has been tabulated.
    /// Cubic Hermite interpolation between them is within 1e-6 σ of the sum of cosines.
    knot_values_and_slopes: Vec<[f64; 2]>,
}

impl RandomFunction {
    const WAVE_COUNT: usize = 64;
    /// Maximum number of knots on either side of zero: more than a metre at the shortest correlation length,
    /// whatever the axis limits. Beyond the last knot, the sum of cosines is evaluated.
    const MAX_KNOTS_PER_SIDE: f64 = 20_000.0;

    fn draw(seed: u64, key: &[u64], sigma: f64, correlation_length: f64) -> Self {
        if sigma == 0.0 {
            return Self::default();
        }
        let frequencies = standard_normals(seed, RandomSource::LinearAxisErrors, key).take(Self::WAVE_COUNT);
        let phase_key: Vec<u64> =
            [RandomSource::LinearAxisErrors as u64].iter().chain(key).chain(&[1]).copied().collect();
        let phases = rand_distr::StandardUniform.sample_iter(random::seeded_stream(seed, &phase_key));
        let waves = frequencies.zip(phases).map(|(w, p): (_, f64)| (w / correlation_length, TAU * p)).collect();
        let amplitude = sigma * (2.0 / Self::WAVE_COUNT as f64).sqrt();
        let knot_pitch = correlation_length / 10.0;
        let mut function = Self {
            wave_amplitude: amplitude,
            frequencies_and_phases: waves,
            knot_pitch_mm: knot_pitch,
            ..Self::default()
        };
        function.unshifted_value_at_zero = function.value_at(0.0);
        function
    }

    /// The same function, tabulated within `reach` of zero, mm.
    fn tabulated_within(mut self, reach: f64) -> Self {
        if !self.frequencies_and_phases.is_empty() {
            let half = (reach / self.knot_pitch_mm).ceil().min(Self::MAX_KNOTS_PER_SIDE) as i64;
            let knot = |i: i64| {
                let x = i as f64 * self.knot_pitch_mm;
                let slope: f64 = self.frequencies_and_phases.iter().map(|(w, p)| -w * (w * x + p).sin()).sum();
                [self.untabulated_value_at(x), self.wave_amplitude * slope * self.knot_pitch_mm]
            };
            self.knot_values_and_slopes = (-half..=half).map(knot).collect();
        }
        self
    }

    /// Value at the position `x`, mm; from the table where there is one.
    fn value_at(&self, x: f64) -> f64 {
        if self.frequencies_and_phases.is_empty() {
            return 0.0;
        }
        let knot_coordinate = x / self.knot_pitch_mm + (self.knot_values_and_slopes.len() / 2) as f64;
        let i = knot_coordinate.floor();
        let piece = (i >= 0.0).then(|| self.knot_values_and_slopes.get(i as usize..)?.get(..2)).flatten();
        let Some(&[[a, slope_a], [b, slope_b]]) = piece else { return self.untabulated_value_at(x) };
        let right_weight = knot_coordinate - i;
        let left_weight = 1.0 - right_weight;
        left_weight * left_weight * ((1.0 + 2.0 * right_weight) * a + right_weight * slope_a)
            + right_weight * right_weight * ((1.0 + 2.0 * left_weight) * b - left_weight * slope_b)
    }

    /// The function without the table.
    fn untabulated_value_at(&self, x: f64) -> f64 {
        let sum: f64 = self.frequencies_and_phases.iter().map(|(w, phase)| (w * x + phase).cos()).sum();
        self.wave_amplitude * sum - self.unshifted_value_at_zero
    }
}

/// Positioning, straightness and squareness of X, Y and Z.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LinearErrors {
    /// Error motions of each axis along X, Y and Z, mm, as functions of the position of this axis.
    motions_by_axis_and_direction: [[RandomFunction; 3]; 3],
    /// Squareness errors, rad: displacement of X per motion along Y, of X along Z, of Y along Z; positive values move
    /// the axis in its positive direction.
    squareness_rad: Vector3<f64>,
}

impl LinearErrors {
    /// Draws the error motions. `sigma_and_length`: standard deviation and correlation length of each axis, mm.
    pub fn draw(seed: u64, sigma_and_length: [[f64; 2]; 3]) -> Self {
        let draw = |axis: usize, direction: usize| {
            let [sigma, length] = sigma_and_length[axis];
            RandomFunction::draw(seed, &[axis as u64, direction as u64], sigma, length)
        };
        let along = |axis| std::array::from_fn(|direction| draw(axis, direction));
        Self { motions_by_axis_and_direction: std::array::from_fn(along), squareness_rad: Vector3::zeros() }
    }

    /// Adds a squareness error of standard deviation `sigma_rad` for each pair of axes.
    pub fn with_squareness_errors(self, seed: u64, sigma_rad: f64) -> Self {
        let draw = |pair| sigma_rad * draw_normal(seed, RandomSource::Squareness, &[pair]);
        Self { squareness_rad: Vector3::new(draw(0), draw(1), draw(2)), ..self }
    }

    /// The same functions, tabulated within these distances of zero on X, Y and Z, mm.
    pub fn tabulated_within(self, reach: [f64; 3]) -> Self {
        let mut reach = reach.into_iter();
        Self {
            motions_by_axis_and_direction: self.motions_by_axis_and_direction.map(|along| {
                let reach = reach.next().unwrap_or_default();
                along.map(|function| function.tabulated_within(reach))
            }),
            ..self
        }
    }

    /// True minus commanded position, machine frame, mm.
    pub fn deviation_at(&self, command: [f64; 3]) -> Vector3<f64> {
        let of_axis = |(along, q): (&[RandomFunction; 3], f64)| {
            Vector3::from(along.each_ref().map(|function| function.value_at(q)))
        };
        let motions: Vector3<f64> = self.motions_by_axis_and_direction.iter().zip(command).map(of_axis).sum();
        let ([_, y, z], squareness_rad) = (command, self.squareness_rad);
        motions + Vector3::new(squareness_rad.x * y + squareness_rad.y * z, squareness_rad.z * z, 0.0)
    }
}

/// Rotations of each of X, Y and Z about X, Y and Z.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct LinearAxisRotationErrors {
    /// Rotations that are not zero, rad, as functions of the position of their linear axis, mm.
    rotation_functions: Vec<(ErrorParameter, RandomFunction)>,
}

impl LinearAxisRotationErrors {
    /// Draws the rotations. `sigma_and_length`: standard deviation, rad, and correlation length, mm, of each axis.
    pub fn draw(seed: u64, sigma_and_length: [[f64; 2]; 3]) -> Self {
        let mut functions = Vec::new();
        for (number, (axis, [sigma, length])) in Axis::LINEAR.into_iter().zip(sigma_and_length).enumerate() {
            for (about, component) in [Axis::A, Axis::B, Axis::C].into_iter().zip(3_u64..) {
                let Ok(error) = ErrorParameter::new(about, axis, ErrorShape::Location) else {
                    continue;
                };
                let key = [number as u64, component];
                functions.push((error, RandomFunction::draw(seed, &key, sigma, length)));
            }
        }
        functions.retain(|(_, function)| !function.frequencies_and_phases.is_empty());
        Self { rotation_functions: functions }
    }

    /// Whether no linear axis has rotations.
    pub fn is_empty(&self) -> bool {
        self.rotation_functions.is_empty()
    }

    /// Error terms with the axes at these positions.
    pub fn error_terms_at(&self, axes: &Position) -> impl Iterator<Item = ErrorTerm> {
        self.rotation_functions.iter().map(|(parameter, function)| ErrorTerm {
            parameter: *parameter,
            value: function.value_at(axes.get_or_zero(parameter.axis())),
        })
    }
}
