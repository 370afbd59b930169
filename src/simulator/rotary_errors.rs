//! Error motions of a rotary axis, drawn from the seed.

use std::f64::consts::TAU;

use super::random_draws::{RandomSource, draw_normal};
use super::rotary_motion::RotaryMotionMagnitudes;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm, InvalidErrorParameter};
use machine::{Axis, Position};

/// Error motions of a rotary axis, from one declaration. The machine's own (`draw`) are along X, Y and Z, with the
/// declared orders or 2 to 5: the mean belongs to the axis position, and order 1 is inseparable from the eccentricity
/// of the part. Those of `[[simulated.rotary_motion]]` (`from_declaration`) start at order 1 and are also about A and
/// B.
#[derive(Debug, Clone)]
pub(super) struct RotaryErrors {
    axis: Axis,
    /// Synchronous motions: error parameters, each with its harmonics of the axis angle.
    synchronous_motions: Vec<(ErrorParameter, Vec<OrderCosSin>)>,
    /// Asynchronous motions: their phases change with time, so that no two revolutions are alike, in either
    /// direction of rotation.
    asynchronous_motions: Vec<(ErrorParameter, Vec<OrderCosSin>)>,
}

/// Number of waves of an asynchronous motion.
const ASYNCHRONOUS_TERM_COUNT: u64 = 24;
/// Period of the slowest phase change, s; the phase of wave n changes n times as fast.
const SLOWEST_PHASE_PERIOD_S: f64 = 61.7;

/// Order, cosine and sine, mm or rad.
type OrderCosSin = (f64, f64, f64);

/// Parameters of one draw: terms of the given orders, whose sum has the given standard deviation.
struct HarmonicDraw<'a> {
    seed: u64,
    quantity: RandomSource,
    axis: Axis,
    /// Standard deviation of the sum at every angle, mm or rad.
    total_sigma: f64,
    /// Key of the random draw and order of each term.
    keys_and_orders: &'a [(u64, f64)],
}

impl HarmonicDraw<'_> {
    /// Terms of the error motion along or about the axis `component`.
    fn draw_terms(&self, component: Axis) -> Result<(ErrorParameter, Vec<OrderCosSin>), InvalidErrorParameter> {
        let Self { seed, quantity, axis, total_sigma: sigma, keys_and_orders: orders } = self;
        let term_sigma = sigma / (orders.len() as f64).sqrt();
        let term = |(key, order): &(u64, f64)| {
            let draw = |part| term_sigma * draw_normal(*seed, *quantity, &[*axis as u64, component as u64, *key, part]);
            (*order, draw(0), draw(1))
        };
        Ok((ErrorParameter::new(component, *axis, ErrorShape::Location)?, orders.iter().map(term).collect()))
    }
}

impl RotaryErrors {
    /// Draws motions with standard deviation `sigma_mm` in each direction at every angle.
    pub fn draw(seed: u64, axis: Axis, sigma_mm: f64, declared_orders: &[u32]) -> Result<Self, InvalidErrorParameter> {
        let orders = if declared_orders.is_empty() { &[2, 3, 4, 5] } else { declared_orders };
        let orders: Vec<_> = orders.iter().map(|n| (u64::from(*n), f64::from(*n))).collect();
        let draw = HarmonicDraw {
            seed,
            quantity: RandomSource::RotaryAxisHarmonics,
            axis,
            total_sigma: sigma_mm,
            keys_and_orders: &orders,
        };
        let motions = Axis::LINEAR.into_iter().map(|component| draw.draw_terms(component));
        Ok(Self { axis, synchronous_motions: motions.collect::<Result<_, _>>()?, asynchronous_motions: Vec::new() })
    }

    /// Draws the motions that one `[[simulated.rotary_motion]]` declares.
    pub fn from_declaration(seed: u64, motion: &RotaryMotionMagnitudes) -> Result<Self, InvalidErrorParameter> {
        const COMPONENTS: [Axis; 5] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B];
        let axis = motion.axis;
        let orders: Vec<_> = (0..).zip(motion.synchronous_orders()).collect();
        let motions = COMPONENTS.into_iter().map(|component| {
            let sigma = if component.is_linear() { motion.linear_um * 1e-3 } else { motion.angular_urad * 1e-6 };
            HarmonicDraw {
                seed,
                quantity: RandomSource::SynchronousRotaryMotion,
                axis,
                total_sigma: sigma,
                keys_and_orders: &orders,
            }
            .draw_terms(component)
        });
        let linear = Axis::LINEAR.into_iter().filter(|_| motion.asynchronous_um > 0.0);
        let asynchronous = linear.map(|component| {
            let quantity = RandomSource::AsynchronousRotaryMotion;
            // Orders without a common period.
            let order = |number| {
                let deviate = draw_normal(seed, quantity, &[axis as u64, component as u64, number, 2]);
                (number, number as f64 + 1.5 + 0.3 * deviate.tanh())
            };
            let orders: Vec<_> = (0..ASYNCHRONOUS_TERM_COUNT).map(order).collect();
            HarmonicDraw { seed, quantity, axis, total_sigma: motion.asynchronous_um * 1e-3, keys_and_orders: &orders }
                .draw_terms(component)
        });
        let asynchronous = asynchronous.collect::<Result<_, _>>()?;
        Ok(Self { axis, synchronous_motions: motions.collect::<Result<_, _>>()?, asynchronous_motions: asynchronous })
    }

    /// Synchronous error motion with all axes at `position`: the part that repeats in each revolution.
    pub fn synchronous_errors(&self, position: &Position) -> impl Iterator<Item = ErrorTerm> {
        let angle = position.get_or_zero(self.axis);
        self.synchronous_motions.iter().map(move |(parameter, terms)| {
            let value = terms.iter().map(|(n, c, s)| c * (n * angle).cos() + s * (n * angle).sin()).sum();
            ErrorTerm { parameter: *parameter, value }
        })
    }

    /// Asynchronous error motion at the time `t_s`.
    pub fn asynchronous_errors(&self, position: &Position, t_s: f64) -> impl Iterator<Item = ErrorTerm> {
        let angle = position.get_or_zero(self.axis);
        self.asynchronous_motions.iter().map(move |(parameter, terms)| {
            let value = (1..).zip(terms).map(|(number, (n, c, s))| {
                let (sin, cos) = (n * angle + TAU * f64::from(number) * t_s / SLOWEST_PHASE_PERIOD_S).sin_cos();
                c * cos + s * sin
            });
            ErrorTerm { parameter: *parameter, value: value.sum() }
        })
    }
}
