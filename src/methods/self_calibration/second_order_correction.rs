//! The second-order terms of the measurement equation (METHODS section 1): the reduction of a radius because the
//! ball contacts the part off the ray. The coefficients do not depend on the unknowns. Many trials are evaluated
//! at once.

use faer::Mat;
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use super::model::{RadiusObservation, UnknownsLayout};
use super::outputs::scale_and_squareness_coefficients;
use estimation::trigonometric_interpolation::TrigonometricInterpolant;

/// Coefficients of the second-order terms of all observations, independent of the unknowns.
pub struct SecondOrderCorrection {
    pub contacts: Vec<ObservationContact>,
    pub heights: Vec<LinearFormsAtHeight>,
}

/// Contact of one observation.
pub struct ObservationContact {
    pub height_index: usize,
    /// Outward unit vector along the ray, machine frame.
    pub normal: Vector3<f64>,
    /// Indices of the unknowns E_x and E_y.
    pub ex_index: usize,
    pub ey_index: usize,
    /// Grid angle on the part.
    pub theta_index: usize,
    /// Measured position of the ball centre across the ray, counter-clockwise positive, mm.
    pub across_ray_mm: f64,
}

/// Linear forms over the unknowns at one height.
pub struct LinearFormsAtHeight {
    /// Index of R.
    pub radius_index: usize,
    /// Unknowns × forms: the derivative of W at each grid angle, 1/rad, then scale difference and squareness for R
    /// = 1 mm.
    pub forms: Mat<f64>,
}

impl SecondOrderCorrection {
    pub fn new(layout: &UnknownsLayout, observations: &[RadiusObservation]) -> Self {
        let contacts = observations.iter().map(|observation| ObservationContact::new(layout, observation)).collect();
        let heights = (0..layout.height_count).map(|height| LinearFormsAtHeight::new(layout, height)).collect();
        Self { contacts, heights }
    }

    /// Adds τW′/L + τ²/2L, τ = (E − E_lin)·t − lateral, L = R, to `radii` (trials × observations, mm) at
    /// the unknowns `x` (trials × unknowns).
    pub fn add_second_order_terms(&self, x: &Mat<f64>, radii: &mut Mat<f64>) {
        let heights: Vec<TrialValuesAtHeight> = self.heights.iter().map(|height| height.evaluate_trials(x)).collect();
        for (i, contact) in self.contacts.iter().enumerate() {
            contact.add_second_order_terms(x, &heights[contact.height_index], radii.col_as_slice_mut(i));
        }
    }
}

/// Values that all contacts of a height share, one entry per trial.
struct TrialValuesAtHeight {
    /// Values of the forms, trials × forms.
    forms: Mat<f64>,
    /// 1/R, 1/mm.
    inverse_radius_per_mm: Vec<f64>,
    simd: Arch,
}

impl ObservationContact {
    fn new(layout: &UnknownsLayout, observation: &RadiusObservation) -> Self {
        Self {
            height_index: observation.height_index,
            normal: layout.ray_direction(observation.phi_index),
            ex_index: layout.ex_index(observation.height_index, observation.c_index),
            ey_index: layout.ey_index(observation.height_index, observation.c_index),
            theta_index: layout.design.theta_index(observation.c_index, observation.phi_index),
            across_ray_mm: observation.across_ray_mm,
        }
    }

    fn add_second_order_terms(&self, x: &Mat<f64>, shared: &TrialValuesAtHeight, radii: &mut [f64]) {
        let form = |j: usize| shared.forms.col_as_slice(j);
        let scale_index = shared.forms.ncols() - 2;
        shared.simd.dispatch(SecondOrderTerms {
            contact_normal_x: self.normal.x,
            contact_normal_y: self.normal.y,
            across_ray_mm: self.across_ray_mm,
            table_displacement_x_mm: x.col_as_slice(self.ex_index),
            table_displacement_y_mm: x.col_as_slice(self.ey_index),
            form_slope: form(self.theta_index),
            scale_difference: form(scale_index),
            squareness: form(scale_index + 1),
            inverse_radius_per_mm: &shared.inverse_radius_per_mm,
            radii,
        });
    }
}

/// The terms of one contact in all trials. This is a struct instead of a closure, because only a struct is inlined with
/// the wide SIMD registers enabled.
struct SecondOrderTerms<'a> {
    contact_normal_x: f64,
    contact_normal_y: f64,
    across_ray_mm: f64,
    /// E_x, the displacement of the table along X at the table angle of the touch, one value per trial.
    table_displacement_x_mm: &'a [f64],
    /// E_y, one value per trial.
    table_displacement_y_mm: &'a [f64],
    /// W′, mm/rad.
    form_slope: &'a [f64],
    /// Scale difference of X and Y for R = 1 mm, that is multiplied by R.
    scale_difference: &'a [f64],
    /// Squareness of X and Y for R = 1 mm, that is multiplied by R.
    squareness: &'a [f64],
    inverse_radius_per_mm: &'a [f64],
    /// Radius of the observation in each trial, mm: the terms are added.
    radii: &'a mut [f64],
}

impl WithSimd for SecondOrderTerms<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { contact_normal_x: cos, contact_normal_y: sin, across_ray_mm: lateral_mm, radii, .. } = self;
        let (squared, mixed) = (sin * sin, sin * cos);
        let trials = radii.len();
        let (ex, ey) = (&self.table_displacement_x_mm[..trials], &self.table_displacement_y_mm[..trials]);
        let form_slope = &self.form_slope[..trials];
        let (scale_difference, squareness) = (&self.scale_difference[..trials], &self.squareness[..trials]);
        let inverse_radius_per_mm = &self.inverse_radius_per_mm[..trials];
        for trial in 0..trials {
            // E_lin·t. The factor 1/L of the forms and the factor L of the deviations cancel.
            let linear_axes = squareness[trial] * squared + scale_difference[trial] * mixed;
            let tau = ey[trial] * cos - ex[trial] * sin - linear_axes - lateral_mm;
            radii[trial] += tau * (form_slope[trial] + tau / 2.0) * inverse_radius_per_mm[trial];
        }
    }
}

impl LinearFormsAtHeight {
    fn new(layout: &UnknownsLayout, height: usize) -> Self {
        let n = layout.design.angle_count;
        let mut forms = Mat::zeros(layout.unknown_count(), n + 2);
        for j in 0..n {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            let interpolant = TrigonometricInterpolant::new(&unit);
            for i in 0..n {
                forms[(layout.flank_form_index(height, j), i)] =
                    interpolant.derivative(layout.design.grid_angle_rad(i));
            }
        }
        let (scale_difference, squareness) = scale_and_squareness_coefficients(layout, height, 1.0);
        forms.col_as_slice_mut(n).copy_from_slice(&scale_difference);
        forms.col_as_slice_mut(n + 1).copy_from_slice(&squareness);
        Self { radius_index: layout.radius_index(height), forms }
    }

    fn evaluate_trials(&self, x: &Mat<f64>) -> TrialValuesAtHeight {
        let inverse_radius_per_mm = x.col_as_slice(self.radius_index).iter().map(|radius| 1.0 / radius).collect();
        TrialValuesAtHeight { forms: x * &self.forms, inverse_radius_per_mm, simd: Arch::new() }
    }
}
