//! Error motions of a rotary axis, drawn from the seed.

use std::f64::consts::TAU;

use super::random_draws;
use super::rotary_motion::RotaryMotion;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm, ParameterError};
use machine::{Axis, Position};

/// Error motions of a rotary axis along X, Y and Z: harmonics of its angle, 2 to 5 unless declared. The mean
/// belongs to the axis position, and the first harmonic is inseparable from the eccentricity of what turns on the
/// axis.
#[derive(Debug, Clone)]
pub(super) struct RotaryErrors {
    axis: Axis,
    /// Parameter that displaces the axis, with its harmonics.
    motions: Vec<(ErrorParameter, Vec<HarmonicTerm>)>,
    /// Asynchronous motions: their phases change with time, so that no two revolutions are alike, in either
    /// direction of rotation.
    asynchronous: Vec<(ErrorParameter, Vec<HarmonicTerm>)>,
}

/// Number of waves of an asynchronous motion.
const ASYNCHRONOUS_TERM_COUNT: usize = 24;
/// Period of the slowest phase change, s; the phase of wave n changes n times as fast.
const PHASE_PERIOD_S: f64 = 61.7;

/// Order, cosine and sine, mm or rad.
type HarmonicTerm = (f64, f64, f64);

impl RotaryErrors {
    /// Draws motions with standard deviation `sigma_mm` in each direction at every angle.
    pub fn draw(seed: u64, axis: Axis, sigma_mm: f64, declared: &[u32]) -> Result<Self, ParameterError> {
        let orders = if declared.is_empty() { &[2, 3, 4, 5] } else { declared };
        let term_sigma = sigma_mm / (orders.len() as f64).sqrt();
        let along = |component: Axis| {
            let draw = |n: u32, part| {
                let key = [axis as u64, component as u64, u64::from(n), part];
                term_sigma * random_draws::draw_rotary_motion(seed, key)
            };
            let terms = orders.iter().map(|n| (f64::from(*n), draw(*n, 0), draw(*n, 1))).collect();
            Ok((ErrorParameter::new(component, axis, ErrorShape::Location)?, terms))
        };
        let motions: Result<_, ParameterError> = Axis::LINEAR.into_iter().map(along).collect();
        Ok(Self { axis, motions: motions?, asynchronous: Vec::new() })
    }

    /// Draws the motions of a declaration.
    pub fn from_declaration(seed: u64, motion: &RotaryMotion) -> Result<Self, ParameterError> {
        const COMPONENTS: [Axis; 5] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B];
        let axis = motion.axis;
        let along = |component: Axis| {
            let key = |number: usize, part| [axis as u64, component as u64, number as u64, part];
            let sigma = match component.is_linear() {
                true => motion.linear_um * 1e-3,
                false => motion.angular_urad * 1e-6,
            };
            let orders = motion.orders();
            let term_sigma = sigma / (orders.len().max(1) as f64).sqrt();
            let mut terms: Vec<HarmonicTerm> = Vec::new();
            for (number, order) in orders.iter().enumerate() {
                let draw = |part| term_sigma * random_draws::draw_declared_motion(seed, key(number, part));
                terms.push((*order, draw(0), draw(1)));
            }
            Ok((ErrorParameter::new(component, axis, ErrorShape::Location)?, terms))
        };
        let asynchronous = |component: Axis| {
            let term_sigma = motion.asynchronous_um * 1e-3 / (ASYNCHRONOUS_TERM_COUNT as f64).sqrt();
            let term = |number: usize| {
                let key = |part| [axis as u64, component as u64, number as u64, part];
                let draw = |part| random_draws::draw_asynchronous_motion(seed, key(part));
                // Orders without a common period.
                let order = number as f64 + 1.5 + 0.3 * draw(2).tanh();
                (order, term_sigma * draw(0), term_sigma * draw(1))
            };
            let terms = (0..ASYNCHRONOUS_TERM_COUNT).map(term).collect();
            Ok((ErrorParameter::new(component, axis, ErrorShape::Location)?, terms))
        };
        let motions: Result<_, ParameterError> = COMPONENTS.into_iter().map(along).collect();
        let linear = Axis::LINEAR.into_iter().filter(|_| motion.asynchronous_um > 0.0);
        let asynchronous: Result<_, ParameterError> = linear.map(asynchronous).collect();
        Ok(Self { axis, motions: motions?, asynchronous: asynchronous? })
    }

    /// Synchronous error motion with all axes at `position`: the part that repeats in each revolution.
    pub fn synchronous_errors(&self, position: &Position) -> impl Iterator<Item = ErrorTerm> {
        let angle = position.get_or_zero(self.axis);
        self.motions.iter().map(move |(parameter, terms)| {
            let value = terms.iter().map(|(n, c, s)| c * (n * angle).cos() + s * (n * angle).sin()).sum();
            ErrorTerm { parameter: *parameter, value }
        })
    }

    /// Asynchronous error motion at the time `t_s`.
    pub fn asynchronous_errors(&self, position: &Position, t_s: f64) -> impl Iterator<Item = ErrorTerm> {
        let angle = position.get_or_zero(self.axis);
        self.asynchronous.iter().map(move |(parameter, terms)| {
            let value = (1..).zip(terms).map(|(number, (n, c, s))| {
                let (sin, cos) = (n * angle + TAU * f64::from(number) * t_s / PHASE_PERIOD_S).sin_cos();
                c * cos + s * sin
            });
            ErrorTerm { parameter: *parameter, value: value.sum() }
        })
    }
}
