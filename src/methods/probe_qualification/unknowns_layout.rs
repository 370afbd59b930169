//! The unknowns and the equation of one touch.
//!
//! The distance of the stylus centre in contact from the ball's centre is
//! r = n·(c + v·t) + R + h(k, n in the spindle's frame) + h(k, n in the machine's frame) − τ·(feed − measuring feed),
//! and for a fast touch another h(k, n in the spindle's frame) is added, with
//! h(k, n) = λ Σ (a_k cos kα + b_k sin kα), α the azimuth of n and λ = √(n_x² + n_y²).
//! c: centre of the ball; v: drift; R: both radii less pre-travel; τ: latch delay. The first h is the map of the probe,
//! the second the part that does not turn with the spindle: form of the ball, squareness and scale of X and Y.

use nalgebra::Vector3;

use super::observe::{MeasuredTouch, ObservedTouches};
use crate::identification::azimuth_dependence::azimuth_factor;

/// Selection and order of the unknowns.
#[derive(Debug, Clone)]
pub struct UnknownsLayout {
    /// Number of parts of the run between interruptions. The centre of the ball is a separate unknown in each part.
    segment_count: usize,
    /// Orders of the probe map: from 1 if the spindle orientations separate order 1 from the centre of the ball,
    /// otherwise from 2.
    pub map_orders: Vec<u32>,
    /// Orders of the part that does not turn with the spindle (form of the ball, squareness and scale of X and Y).
    /// Only orders that the spindle orientations separate from the map.
    pub spindle_independent_orders: Vec<u32>,
    /// Orders of the difference of the map at the fast feed. Empty without fast touches.
    pub fast_difference_orders: Vec<u32>,
}

/// Harmonic of the map: λ cos kα and λ sin kα, with α the azimuth of the unit vector `n` and λ = √(n_x² + n_y²).
pub fn harmonic_factors(order: u32, n: &Vector3<f64>) -> [f64; 2] {
    [0.0, 0.25].map(|quarter_turns| azimuth_factor(order, quarter_turns, n))
}

impl UnknownsLayout {
    /// Selects the unknowns. `highest_order`: highest order of the map.
    pub fn new(observed: &ObservedTouches, highest_order: u32) -> Self {
        let separable_orders: Vec<u32> =
            (1..=highest_order).filter(|k| is_separable_by_orientations(observed, *k)).collect();
        let first = if separable_orders.contains(&1) { 1 } else { 2 };
        let has_fast = observed.touches.iter().any(|touch| touch.is_fast);
        Self {
            segment_count: observed.touches.iter().map(|touch| touch.earlier_interruption_count + 1).max().unwrap_or(1),
            map_orders: (first..=highest_order).collect(),
            // Order 1 of the part that does not turn with the spindle is the centre of the ball.
            spindle_independent_orders: separable_orders.into_iter().filter(|k| *k > 1).collect(),
            fast_difference_orders: (1..=highest_order).filter(|_| has_fast).collect(),
        }
    }

    /// Whether the spindle orientations separate an order of the map from the part that does not turn.
    pub fn is_order_separable(&self, order: u32) -> bool {
        self.spindle_independent_orders.contains(&order) || order == 1 && self.map_orders.contains(&1)
    }

    /// Index of X of the drift of the ball. Y and Z are the next unknowns.
    fn first_drift_index(&self) -> usize {
        3 * self.segment_count
    }

    /// Index of R: both radii minus pre-travel, as a deviation from the stated radii.
    pub fn radius_index(&self) -> usize {
        self.first_drift_index() + 3
    }

    /// Index of the unknown for the cosine part of the order `map_orders[index]`. The sine part is the next unknown.
    pub fn map_cosine_index(&self, index: usize) -> usize {
        self.radius_index() + 1 + 2 * index
    }

    /// Index of the unknown for the cosine part of `spindle_independent_orders[0]`; sine part and further orders follow.
    fn first_ball_form_index(&self) -> usize {
        self.map_cosine_index(self.map_orders.len())
    }

    /// Index of the latch delay. Without fast touches there is no latch delay unknown, and this is the number of
    /// unknowns.
    pub fn latch_delay_index(&self) -> usize {
        self.first_ball_form_index() + 2 * self.spindle_independent_orders.len()
    }

    /// Index of the unknown for the cosine part of `fast_difference_orders[index]`. The sine part is the next unknown.
    pub fn fast_difference_cosine_index(&self, index: usize) -> usize {
        self.latch_delay_index() + 1 + 2 * index
    }

    pub fn unknown_count(&self) -> usize {
        if self.fast_difference_orders.is_empty() {
            self.latch_delay_index()
        } else {
            self.fast_difference_cosine_index(self.fast_difference_orders.len())
        }
    }

    /// Derivatives of the touch's distance by all unknowns.
    pub fn design_row(&self, observed: &ObservedTouches, touch: &MeasuredTouch) -> Vec<f64> {
        let mut row = vec![0.0; self.unknown_count()];
        let mut put = |first: usize, values: &[f64]| {
            row[first..first + values.len()].copy_from_slice(values);
        };
        put(3 * touch.earlier_interruption_count, touch.normal_in_machine.as_slice());
        put(self.first_drift_index(), (touch.normal_in_machine * observed.relative_time(touch)).as_slice());
        put(self.radius_index(), &[1.0]);
        for (index, order) in self.map_orders.iter().enumerate() {
            put(self.map_cosine_index(index), &harmonic_factors(*order, &touch.normal_in_spindle));
        }
        for (index, order) in self.spindle_independent_orders.iter().enumerate() {
            put(self.first_ball_form_index() + 2 * index, &harmonic_factors(*order, &touch.normal_in_machine));
        }
        if touch.is_fast {
            put(self.latch_delay_index(), &[-(observed.speeds_mm_s[1] - observed.speeds_mm_s[0])]);
            for (index, order) in self.fast_difference_orders.iter().enumerate() {
                put(self.fast_difference_cosine_index(index), &harmonic_factors(*order, &touch.normal_in_spindle));
            }
        }
        row
    }

    /// Description of an unknown for a refusal.
    pub fn unknown_description(&self, unknown: usize) -> String {
        let order = |orders: &[u32], from: usize| orders[(unknown - from) / 2];
        match unknown {
            _ if unknown < self.first_drift_index() => "the centre of the ball".to_owned(),
            _ if unknown < self.radius_index() => "the drift".to_owned(),
            _ if unknown == self.radius_index() => "the radius".to_owned(),
            _ if unknown < self.first_ball_form_index() => {
                format!("order {} of the map", order(&self.map_orders, self.map_cosine_index(0)))
            }
            _ if unknown < self.latch_delay_index() => {
                format!(
                    "order {} of the ball's form",
                    order(&self.spindle_independent_orders, self.first_ball_form_index())
                )
            }
            _ if unknown == self.latch_delay_index() => "the latch delay".to_owned(),
            _ => format!(
                "order {} at the fast feed",
                order(&self.fast_difference_orders, self.fast_difference_cosine_index(0))
            ),
        }
    }
}

/// Minimum phase difference of an order between two orientations, degrees, for the order to be separable.
const MIN_PHASE_DIFFERENCE_DEG: f64 = 20.0;

/// Whether there are two orientations of the spindle between which the phase of the harmonic `order` differs by at
/// least [`MIN_PHASE_DIFFERENCE_DEG`].
fn is_separable_by_orientations(observed: &ObservedTouches, order: u32) -> bool {
    let degrees = &observed.spindle_orientations_deg;
    let differs_in_phase = |a: f64, b: f64| {
        let turn = (f64::from(order) * (a - b)).rem_euclid(360.0);
        turn.min(360.0 - turn) >= MIN_PHASE_DIFFERENCE_DEG
    };
    degrees.iter().any(|a| degrees.iter().any(|b| differs_in_phase(*a, *b)))
}
