//! The second-order terms of the measurement equation (METHODS section 1): what a radius lacks
//! because the ball meets the part beside the ray. Everything that does not depend on the unknowns
//! is worked out once, for the sake of the Monte Carlo trials.

use super::algebra::dot;
use super::model::{Layout, Observation};
use super::outputs::scale_and_squareness;
use estimation::trigonometric::Trigonometric;

pub struct Bend {
    places: Vec<Place>,
    heights: Vec<Height>,
}

/// Where one observation stands.
struct Place {
    height: usize,
    sin: f64,
    cos: f64,
    ex: usize,
    ey: usize,
    theta: usize,
    lateral: f64,
}

/// Linear forms over the unknowns.
struct Height {
    radius: usize,
    /// First unknown of W.
    flank: usize,
    /// Row i: the derivative of W at grid angle i, by the values of W, 1/rad.
    slope: Vec<Vec<f64>>,
    /// For R = 1 mm.
    scale_difference: Vec<f64>,
    squareness: Vec<f64>,
}

impl Bend {
    pub fn new(layout: &Layout, observations: &[Observation]) -> Self {
        let places = observations.iter().map(|seen| Place::new(layout, seen)).collect();
        let heights = (0..layout.heights).map(|height| Height::new(layout, height)).collect();
        Self { places, heights }
    }

    /// τW′/L + τ²/2L for every observation, τ = (E − E_lin)·t − lateral, L = R, mm.
    pub fn terms(&self, x: &[f64]) -> Vec<f64> {
        let heights: Vec<HeightTerms> = self.heights.iter().map(|height| height.at(x)).collect();
        self.places
            .iter()
            .map(|place| {
                let terms = &heights[place.height];
                let (sin, cos) = (place.sin, place.cos);
                // E_lin·t from scale difference and squareness.
                let linear_axes = terms.squareness * sin * sin + terms.scale_difference * sin * cos;
                let tau = -x[place.ex] * sin + x[place.ey] * cos - linear_axes - place.lateral;
                tau * (terms.slope[place.theta] + tau / 2.0) / terms.radius
            })
            .collect()
    }
}

impl Place {
    fn new(layout: &Layout, seen: &Observation) -> Self {
        let (sin, cos) = layout.design.angle(seen.phi).sin_cos();
        Self {
            height: seen.height,
            sin,
            cos,
            ex: layout.ex(seen.height, seen.c),
            ey: layout.ey(seen.height, seen.c),
            theta: layout.design.theta(seen.c, seen.phi),
            lateral: seen.lateral,
        }
    }
}

/// What the terms need to know of one height at one solution, mm.
struct HeightTerms {
    radius: f64,
    slope: Vec<f64>,
    /// Over the radius L.
    scale_difference: f64,
    squareness: f64,
}

impl Height {
    fn new(layout: &Layout, height: usize) -> Self {
        let n = layout.design.n;
        let mut slope = vec![vec![0.0; n]; n];
        for j in 0..n {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            let interpolant = Trigonometric::new(&unit);
            for (i, row) in slope.iter_mut().enumerate() {
                row[j] = interpolant.derivative(layout.design.angle(i));
            }
        }
        let (scale_difference, squareness) = scale_and_squareness(layout, height, 1.0);
        let (radius, flank) = (layout.radius(height), layout.w(height, 0));
        Self { radius, flank, slope, scale_difference, squareness }
    }

    fn at(&self, x: &[f64]) -> HeightTerms {
        let flank = &x[self.flank..];
        HeightTerms {
            radius: x[self.radius],
            slope: self.slope.iter().map(|row| dot(row, flank)).collect(),
            // The forms hold 1/L, the deviations L: they cancel.
            scale_difference: dot(&self.scale_difference, x),
            squareness: dot(&self.squareness, x),
        }
    }
}
