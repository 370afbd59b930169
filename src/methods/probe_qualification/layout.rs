//! The unknowns and the equation of one touch.
//!
//! The distance of the stylus centre in contact from the ball's centre is
//! r = n·(c + v·t) + R + h(k, n in the spindle's frame) + h(k, n in the machine's frame) − τ·(feed − measuring feed),
//! and for a fast touch another h(k, n in the spindle's frame) is added, with
//! h(k, n) = λ Σ (a_k cos kα + b_k sin kα), α the azimuth of n and λ = √(n_x² + n_y²).
//! c: centre of the ball; v: drift; R: both radii less pre-travel; τ: latch delay. The first h is the map of the probe,
//! the second the part that does not turn with the spindle: form of the ball, squareness and scale of X and Y.

use nalgebra::Vector3;

use super::observe::{Observed, Touch};
use crate::identification::azimuth::azimuth_factor;

/// Selection of the unknowns.
#[derive(Debug, Clone)]
pub struct Layout {
    segments: usize,
    /// Orders of the probe map.
    pub map: Vec<u32>,
    /// Orders of the part that does not turn with the spindle.
    pub still: Vec<u32>,
    /// Orders of the difference of the map at the fast feed. Empty without fast touches.
    pub fast: Vec<u32>,
}

/// Harmonic of the map: λ cos kα and λ sin kα.
pub fn harmonic(order: u32, n: &Vector3<f64>) -> [f64; 2] {
    [0.0, 0.25].map(|quarter_turns| azimuth_factor(order, quarter_turns, n))
}

impl Layout {
    /// Selects the unknowns. `last`: highest order of the map.
    pub fn new(observed: &Observed, last: u32) -> Self {
        let turned: Vec<u32> = (1..=last).filter(|k| is_turned(observed, *k)).collect();
        let first = if turned.contains(&1) { 1 } else { 2 };
        let has_fast = observed.touches.iter().any(|touch| touch.is_fast);
        Self {
            segments: observed.touches.iter().map(|touch| touch.segment + 1).max().unwrap_or(1),
            map: (first..=last).collect(),
            // The first order that does not turn with the spindle is the centre of the ball.
            still: turned.into_iter().filter(|k| *k > 1).collect(),
            fast: (1..=last).filter(|_| has_fast).collect(),
        }
    }

    /// Whether the spindle orientations separate an order of the map from the part that does not turn.
    pub fn separates(&self, order: u32) -> bool {
        self.still.contains(&order) || order == 1 && self.map.contains(&1)
    }

    fn drift(&self) -> usize {
        3 * self.segments
    }

    /// Index of R: both radii less pre-travel.
    pub fn radius(&self) -> usize {
        self.drift() + 3
    }

    /// Index of the cosine part of the map's order with the number `index`. The sine part is the next unknown.
    pub fn map(&self, index: usize) -> usize {
        self.radius() + 1 + 2 * index
    }

    fn still(&self) -> usize {
        self.map(self.map.len())
    }

    /// Index of the latch delay. Without fast touches there is none.
    pub fn delay(&self) -> usize {
        self.still() + 2 * self.still.len()
    }

    /// Index as for [`Layout::map`], for the difference at the fast feed.
    pub fn fast(&self, index: usize) -> usize {
        self.delay() + 1 + 2 * index
    }

    pub fn unknowns(&self) -> usize {
        if self.fast.is_empty() { self.delay() } else { self.fast(self.fast.len()) }
    }

    /// Derivatives of the touch's distance by all unknowns.
    pub fn row(&self, observed: &Observed, touch: &Touch) -> Vec<f64> {
        let mut row = vec![0.0; self.unknowns()];
        let mut put = |first: usize, values: &[f64]| {
            row[first..first + values.len()].copy_from_slice(values);
        };
        put(3 * touch.segment, touch.normal.as_slice());
        put(self.drift(), (touch.normal * observed.time(touch)).as_slice());
        put(self.radius(), &[1.0]);
        for (index, order) in self.map.iter().enumerate() {
            put(self.map(index), &harmonic(*order, &touch.in_spindle));
        }
        for (index, order) in self.still.iter().enumerate() {
            put(self.still() + 2 * index, &harmonic(*order, &touch.normal));
        }
        if touch.is_fast {
            put(self.delay(), &[-(observed.speeds[1] - observed.speeds[0])]);
            for (index, order) in self.fast.iter().enumerate() {
                put(self.fast(index), &harmonic(*order, &touch.in_spindle));
            }
        }
        row
    }

    /// Description of an unknown for a refusal.
    pub fn name(&self, unknown: usize) -> String {
        let order = |orders: &[u32], from: usize| orders[(unknown - from) / 2];
        match unknown {
            _ if unknown < self.drift() => "the centre of the ball".to_owned(),
            _ if unknown < self.radius() => "the drift".to_owned(),
            _ if unknown == self.radius() => "the radius".to_owned(),
            _ if unknown < self.still() => {
                format!("order {} of the map", order(&self.map, self.map(0)))
            }
            _ if unknown < self.delay() => {
                format!("order {} of the ball's form", order(&self.still, self.still()))
            }
            _ if unknown == self.delay() => "the latch delay".to_owned(),
            _ => format!("order {} at the fast feed", order(&self.fast, self.fast(0))),
        }
    }
}

/// Minimum phase difference of an order between two orientations, degrees, for the order to be separable.
const LEAST_TURN_DEG: f64 = 20.0;

/// Whether any two orientations rotate this order by a sufficient phase.
fn is_turned(observed: &Observed, order: u32) -> bool {
    let degrees = &observed.orientations_deg;
    let turned = |a: f64, b: f64| {
        let turn = (f64::from(order) * (a - b)).rem_euclid(360.0);
        turn.min(360.0 - turn) >= LEAST_TURN_DEG
    };
    degrees.iter().any(|a| degrees.iter().any(|b| turned(*a, *b)))
}
