//! The measurement equation and its unknowns (paper 1, section 2.3, with the errata of METHODS
//! section 1).
//!
//! A touch with table index c and probe index φ measures the radius (mm, along the ray at φ, ball centre, machine
//! frame)
//!
//! r = R + E(C)·n(φ) + W(φ+C) − E_r(φ) + drift,  n = (cos φ, sin φ),
//!
//! with E the displacement of the table (E_XC,total, E_YC,total), W the flank of the part, E_r the radial error of
//! the linear axes. R is the radius of the part plus the radius of the stylus ball.

use faer::Mat;
use nalgebra::Vector3;

use super::design::AngleGridDesign;
use machine::Axis;

/// One reading, reduced to the nearest grid angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadiusObservation {
    /// Id of the step of the reading.
    pub step_id: u32,
    /// Index of the nearest measuring height.
    pub height_index: usize,
    /// Grid index of the planned table angle, positive if the table turns clockwise seen from +Z (C by ISO 841).
    pub c_index: usize,
    /// Grid index of the probe angle φ, machine frame.
    pub phi_index: usize,
    /// Distance of the ball centre from the stated axis, along the ray, mm.
    pub along_ray_mm: f64,
    /// Position of the ball centre across the ray, counter-clockwise positive, mm.
    pub across_ray_mm: f64,
    /// Time of the reading on the clock of the run, s.
    pub time_s: f64,
    /// Time, scaled so that the measurement spans −1 … 1 without the interruptions.
    pub relative_time: f64,
}

/// Indices of the unknowns. Each height has its own R, E, E_r and W. The drift is common to all heights.
#[derive(Debug, Clone)]
pub struct UnknownsLayout {
    pub design: AngleGridDesign,
    pub height_count: usize,
    /// Highest power of time in the drift. 0: no drift is fitted.
    pub drift_order: usize,
    /// Times of the interruptions, on the scale of [`RadiusObservation::relative_time`]. A step is fitted at each, as
    /// the motion of the machine during an interruption is unknown.
    pub interruption_times: Vec<f64>,
}

/// The drifting quantities: the table relative to the spindle in X and Y, and the radius.
pub const DRIFTING_QUANTITIES: [&str; 3] = ["X", "Y", "radius"];

impl UnknownsLayout {
    fn unknowns_per_height(&self) -> usize {
        4 * self.design.angle_count + 1
    }

    pub fn unknown_count(&self) -> usize {
        self.height_count * self.unknowns_per_height()
            + DRIFTING_QUANTITIES.len() * (self.drift_order + self.interruption_times.len())
    }

    /// Index of R, the radius of the part plus that of the stylus ball, at a height.
    pub fn radius_index(&self, height: usize) -> usize {
        height * self.unknowns_per_height()
    }

    /// Index of the displacement of the table along X (E_XC,total) at a table angle.
    pub fn ex_index(&self, height: usize, c: usize) -> usize {
        self.radius_index(height) + 1 + c
    }

    /// Index of the displacement of the table along Y (E_YC,total) at a table angle.
    pub fn ey_index(&self, height: usize, c: usize) -> usize {
        self.ex_index(height, c) + self.design.angle_count
    }

    /// Index of E_r, the radial error of X and Y, at a probe angle.
    pub fn linear_axes_radial_error_index(&self, height: usize, phi: usize) -> usize {
        self.ey_index(height, phi) + self.design.angle_count
    }

    /// Index of W, the radial deviation of the flank, at a workpiece angle.
    pub fn flank_form_index(&self, height: usize, theta: usize) -> usize {
        self.linear_axes_radial_error_index(height, theta) + self.design.angle_count
    }

    /// Index of the drift of one quantity with this power of time, from 1 on.
    fn drift_index(&self, quantity: usize, power: usize) -> usize {
        self.height_count * self.unknowns_per_height() + quantity * self.drift_order + power - 1
    }

    /// Index of the step of one drifting quantity at an interruption.
    pub fn interruption_step_index(&self, quantity: usize, gap: usize) -> usize {
        let before = self.height_count * self.unknowns_per_height() + DRIFTING_QUANTITIES.len() * self.drift_order;
        before + DRIFTING_QUANTITIES.len() * gap + quantity
    }

    /// Function with a unit step at an interruption and the value zero at time zero: the results are valid for the
    /// middle of the measurement, as with drift.
    pub fn interruption_step_value(&self, observation: &RadiusObservation, gap: usize) -> f64 {
        let after = |time: f64| if time > self.interruption_times[gap] { 1.0 } else { 0.0 };
        after(observation.relative_time) - after(0.0)
    }

    /// Names of all unknowns. `rotary_axis`: the measured axis.
    pub fn unknown_names(&self, rotary_axis: Axis) -> Vec<String> {
        let mut names = vec![String::new(); self.unknown_count()];
        for height in 0..self.height_count {
            let at = if self.height_count > 1 { format!(" at height {height}") } else { String::new() };
            names[self.radius_index(height)] = format!("R{at}");
            for i in 0..self.design.angle_count {
                let deg = (self.design.grid_angle_rad(i).to_degrees() * 1e6).round() / 1e6;
                names[self.ex_index(height, i)] = format!("EX{rotary_axis}_total({deg}°){at}");
                names[self.ey_index(height, i)] = format!("EY{rotary_axis}_total({deg}°){at}");
                names[self.linear_axes_radial_error_index(height, i)] = format!("E_radial({deg}°){at}");
                names[self.flank_form_index(height, i)] = format!("W_radial({deg}°){at}");
            }
        }
        for (quantity, name) in DRIFTING_QUANTITIES.into_iter().enumerate() {
            for power in 1..=self.drift_order {
                names[self.drift_index(quantity, power)] = format!("drift of {name}, power {power}");
            }
            for gap in 0..self.interruption_times.len() {
                names[self.interruption_step_index(quantity, gap)] =
                    format!("step of {name}, interruption {}", gap + 1);
            }
        }
        names
    }

    /// Unit vector along the ray at a grid angle, machine frame.
    pub fn ray_direction(&self, index: usize) -> Vector3<f64> {
        let (sin, cos) = self.design.grid_angle_rad(index).sin_cos();
        Vector3::new(cos, sin, 0.0)
    }

    /// Rows × unknowns: the derivative of each radius by each unknown.
    pub fn design_matrix(&self, observations: &[RadiusObservation]) -> Mat<f64> {
        let mut a = Mat::zeros(observations.len(), self.unknown_count());
        for (row, observation) in observations.iter().enumerate() {
            let normal = self.ray_direction(observation.phi_index);
            let theta = self.design.theta_index(observation.c_index, observation.phi_index);
            a[(row, self.radius_index(observation.height_index))] = 1.0;
            a[(row, self.ex_index(observation.height_index, observation.c_index))] = normal.x;
            a[(row, self.ey_index(observation.height_index, observation.c_index))] = normal.y;
            a[(row, self.linear_axes_radial_error_index(observation.height_index, observation.phi_index))] = -1.0;
            a[(row, self.flank_form_index(observation.height_index, theta))] = 1.0;
            for (quantity, along) in [normal.x, normal.y, 1.0].into_iter().enumerate() {
                for power in 1..=self.drift_order {
                    a[(row, self.drift_index(quantity, power))] = observation.relative_time.powi(power as i32) * along;
                }
                for gap in 0..self.interruption_times.len() {
                    a[(row, self.interruption_step_index(quantity, gap))] =
                        self.interruption_step_value(observation, gap) * along;
                }
            }
        }
        a
    }

    /// Six gauge conditions per height, for the combinations of unknowns that the touches do not determine (paper 1,
    /// boundary conditions 1–3), as rows of C·x = 0.
    pub fn gauge_matrix(&self) -> Mat<f64> {
        let per_height = 6;
        let n = self.design.angle_count;
        let mut rows = Mat::zeros(per_height * self.height_count, self.unknown_count());
        for height in 0..self.height_count {
            let row = per_height * height;
            rows[(row, self.ex_index(height, 0))] = 1.0;
            rows[(row + 1, self.ey_index(height, 0))] = 1.0;
            rows[(row + 2, self.flank_form_index(height, 0))] = 1.0;
            rows[(row + 3, self.linear_axes_radial_error_index(height, 0))] = 1.0;
            if self.has_quarter_angles() {
                rows[(row + 4, self.linear_axes_radial_error_index(height, 0))] = 1.0;
                rows[(row + 4, self.linear_axes_radial_error_index(height, n / 2))] = -1.0;
                rows[(row + 5, self.linear_axes_radial_error_index(height, n / 4))] = 1.0;
                rows[(row + 5, self.linear_axes_radial_error_index(height, 3 * n / 4))] = -1.0;
            } else {
                for i in 0..n {
                    let (sin, cos) = self.design.grid_angle_rad(i).sin_cos();
                    rows[(row + 4, self.linear_axes_radial_error_index(height, i))] = cos;
                    rows[(row + 5, self.linear_axes_radial_error_index(height, i))] = sin;
                }
            }
        }
        rows
    }

    /// Whether the grid has 90°, 180° and 270°, where the paper fixes the machine's origin.
    fn has_quarter_angles(&self) -> bool {
        self.design.angle_count.is_multiple_of(4)
    }

    /// Texts on the gauge. `rotary_axis`: the measured axis.
    pub fn describe_gauge(&self, rotary_axis: Axis) -> Vec<String> {
        let origin = if self.has_quarter_angles() {
            "machine origin: E_radial(0°) = E_radial(180°) and E_radial(90°) = E_radial(-90°)"
        } else {
            "machine origin: E_radial has no first harmonic"
        };
        vec![
            format!(
                "EX{rotary_axis}_total(0°) = EY{rotary_axis}_total(0°) = 0: \
                displacements are relative to {rotary_axis} = 0"
            ),
            "W_radial(0°) = 0 and E_radial(0°) = 0: radius and common X/Y scale are part of R".to_owned(),
            origin.to_owned(),
        ]
    }
}
