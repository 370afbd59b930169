//! The measurement equation and its unknowns (paper 1, section 2.3, with the errata of METHODS
//! section 1).
//!
//! A touch with table index c and probe index φ measures the radius (mm, along the ray at φ, ball centre, machine
//! frame)
//!
//! r = R + E(C)·n(φ) + W(φ+C) − E_r(φ) + drift,  n = (cos φ, sin φ),
//!
//! with E the displacement of the table (E_XC,total, E_YC,total), W the flank of the part, E_r the radial error of
//! the linear axes. R includes the radius of the ball.

use faer::Mat;
use nalgebra::Vector3;

use super::design::Design;
use machine::Axis;

/// One reading, reduced to the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Id of the step of the reading.
    pub step: u32,
    pub height: usize,
    pub c: usize,
    pub phi: usize,
    /// Position of the ball centre along the ray, mm.
    pub radius: f64,
    /// Position of the ball centre across the ray, counter-clockwise positive, mm.
    pub lateral: f64,
    /// Time, scaled so that the cycle spans −1 … 1 without the interruptions.
    pub time: f64,
}

/// Indices of the unknowns. Each height has its own R, E, E_r and W. The drift is common to all heights.
#[derive(Debug, Clone)]
pub struct Layout {
    pub design: Design,
    pub heights: usize,
    pub drift_order: usize,
    /// Times of the interruptions, as `Observation::time`. A step is fitted at each, as the motion of the machine
    /// during an interruption is unknown.
    pub gaps: Vec<f64>,
}

/// The drifting quantities: the table relative to the spindle in X and Y, and the radius.
pub const DRIFTING: [&str; 3] = ["X", "Y", "radius"];

impl Layout {
    fn block(&self) -> usize {
        4 * self.design.n + 1
    }

    pub fn unknowns(&self) -> usize {
        self.heights * self.block() + DRIFTING.len() * (self.drift_order + self.gaps.len())
    }

    pub fn radius(&self, height: usize) -> usize {
        height * self.block()
    }

    pub fn ex(&self, height: usize, c: usize) -> usize {
        self.radius(height) + 1 + c
    }

    pub fn ey(&self, height: usize, c: usize) -> usize {
        self.ex(height, c) + self.design.n
    }

    pub fn er(&self, height: usize, phi: usize) -> usize {
        self.ey(height, phi) + self.design.n
    }

    pub fn w(&self, height: usize, theta: usize) -> usize {
        self.er(height, theta) + self.design.n
    }

    fn drift(&self, what: usize, power: usize) -> usize {
        self.heights * self.block() + what * self.drift_order + power - 1
    }

    /// Index of the step of one drifting quantity at an interruption.
    pub fn step(&self, what: usize, gap: usize) -> usize {
        let before = self.heights * self.block() + DRIFTING.len() * self.drift_order;
        before + DRIFTING.len() * gap + what
    }

    /// Function with a unit step at an interruption and the value zero at time zero: the results are valid for the
    /// middle of the cycle, as with drift.
    pub fn stepped(&self, seen: &Observation, gap: usize) -> f64 {
        let after = |time: f64| if time > self.gaps[gap] { 1.0 } else { 0.0 };
        after(seen.time) - after(0.0)
    }

    /// Names of the unknowns. `axis`: the measured rotary axis.
    pub fn names(&self, axis: Axis) -> Vec<String> {
        let mut names = vec![String::new(); self.unknowns()];
        for height in 0..self.heights {
            let at = if self.heights > 1 { format!(" at height {height}") } else { String::new() };
            names[self.radius(height)] = format!("R{at}");
            for i in 0..self.design.n {
                let deg = (self.design.angle(i).to_degrees() * 1e6).round() / 1e6;
                names[self.ex(height, i)] = format!("EX{axis}_total({deg}°){at}");
                names[self.ey(height, i)] = format!("EY{axis}_total({deg}°){at}");
                names[self.er(height, i)] = format!("E_radial({deg}°){at}");
                names[self.w(height, i)] = format!("W_radial({deg}°){at}");
            }
        }
        for (what, name) in DRIFTING.into_iter().enumerate() {
            for power in 1..=self.drift_order {
                names[self.drift(what, power)] = format!("drift of {name}, power {power}");
            }
            for gap in 0..self.gaps.len() {
                names[self.step(what, gap)] = format!("step of {name}, interruption {}", gap + 1);
            }
        }
        names
    }

    /// Unit vector along the ray at a grid angle, machine frame.
    pub fn normal(&self, index: usize) -> Vector3<f64> {
        let (sin, cos) = self.design.angle(index).sin_cos();
        Vector3::new(cos, sin, 0.0)
    }

    /// Rows × unknowns: the derivative of each radius by each unknown.
    pub fn matrix(&self, observations: &[Observation]) -> Mat<f64> {
        let mut a = Mat::zeros(observations.len(), self.unknowns());
        for (row, seen) in observations.iter().enumerate() {
            let normal = self.normal(seen.phi);
            let theta = self.design.theta(seen.c, seen.phi);
            a[(row, self.radius(seen.height))] = 1.0;
            a[(row, self.ex(seen.height, seen.c))] = normal.x;
            a[(row, self.ey(seen.height, seen.c))] = normal.y;
            a[(row, self.er(seen.height, seen.phi))] = -1.0;
            a[(row, self.w(seen.height, theta))] = 1.0;
            for (what, along) in [normal.x, normal.y, 1.0].into_iter().enumerate() {
                for power in 1..=self.drift_order {
                    a[(row, self.drift(what, power))] = seen.time.powi(power as i32) * along;
                }
                for gap in 0..self.gaps.len() {
                    a[(row, self.step(what, gap))] = self.stepped(seen, gap) * along;
                }
            }
        }
        a
    }

    /// The six gauge conditions per height that the cycle does not determine (paper 1, boundary conditions 1–3), as
    /// rows of C·x = 0.
    pub fn gauge(&self) -> Mat<f64> {
        let per_height = 6;
        let n = self.design.n;
        let mut rows = Mat::zeros(per_height * self.heights, self.unknowns());
        for height in 0..self.heights {
            let row = per_height * height;
            rows[(row, self.ex(height, 0))] = 1.0;
            rows[(row + 1, self.ey(height, 0))] = 1.0;
            rows[(row + 2, self.w(height, 0))] = 1.0;
            rows[(row + 3, self.er(height, 0))] = 1.0;
            if self.has_quarters() {
                rows[(row + 4, self.er(height, 0))] = 1.0;
                rows[(row + 4, self.er(height, n / 2))] = -1.0;
                rows[(row + 5, self.er(height, n / 4))] = 1.0;
                rows[(row + 5, self.er(height, 3 * n / 4))] = -1.0;
            } else {
                for i in 0..n {
                    let (sin, cos) = self.design.angle(i).sin_cos();
                    rows[(row + 4, self.er(height, i))] = cos;
                    rows[(row + 5, self.er(height, i))] = sin;
                }
            }
        }
        rows
    }

    /// Whether the grid has 90°, 180° and 270°, where the paper fixes the machine's origin.
    fn has_quarters(&self) -> bool {
        self.design.n.is_multiple_of(4)
    }

    /// Texts on the gauge.
    pub fn gauge_in_words(&self, axis: Axis) -> Vec<String> {
        let origin = if self.has_quarters() {
            "machine origin: E_radial(0°) = E_radial(180°) and E_radial(90°) = E_radial(-90°)"
        } else {
            "machine origin: E_radial has no first harmonic"
        };
        vec![
            format!(
                "EX{axis}_total(0°) = EY{axis}_total(0°) = 0: displacements are relative to {axis} = 0"
            ),
            "W_radial(0°) = 0 and E_radial(0°) = 0: radius and common X/Y scale go into R"
                .to_owned(),
            origin.to_owned(),
        ]
    }
}
