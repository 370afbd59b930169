//! The true artefact: a prism over a closed, star-shaped profile that is not quite round.

use std::f64::consts::PI;

use nalgebra::{Rotation3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::nearest_surface::NearestSurface;

/// `cos·cos(nψ) + sin·sin(nψ)`, µm: part of a radius or of the height of a face; ψ counter-clockwise about the
/// artefact's axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FormHarmonic {
    /// Order: undulations per revolution.
    pub n: u32,
    #[serde(default)]
    pub cos_um: f64,
    #[serde(default)]
    pub sin_um: f64,
}

/// A cylinder whose profile is not quite round, in the table frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TrueCylinder {
    /// Centre of the lower end.
    axis_foot: Vector3<f64>,
    /// Columns: the x, y and axis directions of the artefact.
    pub frame: Rotation3<f64>,
    height: f64,
    profile: RadiusProfile,
}

impl TrueCylinder {
    /// `axis` must not be zero. The x direction of the artefact is the table's X, rotated by the shortest
    /// rotation that takes Z to `axis`.
    pub fn new(foot: Vector3<f64>, axis: Vector3<f64>, height: f64, profile: RadiusProfile) -> Self {
        let upside_down = || Rotation3::from_axis_angle(&Vector3::y_axis(), PI);
        let frame = Rotation3::rotation_between(&Vector3::z(), &axis).unwrap_or_else(upside_down);
        Self { axis_foot: foot, frame, height, profile }
    }

    /// The solid turned counter-clockwise about its own axis by `angle`, rad.
    pub fn rotated_about_axis(self, angle: f64) -> Self {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        Self { frame: self.frame * turn, ..self }
    }

    /// Lower bound of the distance between `point` (table frame) and the solid.
    pub fn distance_lower_bound(&self, point: Vector3<f64>) -> f64 {
        let local_point = self.frame.inverse() * (point - self.axis_foot);
        (local_point.z - self.height / 2.0).abs() - self.height / 2.0
    }

    /// Surface nearest to `point`, both in the table frame; `growth` is added to the radius.
    pub fn nearest(&self, point: Vector3<f64>, growth: f64) -> NearestSurface {
        let local_point = self.frame.inverse() * (point - self.axis_foot);
        let (across, outward) = self.profile.signed_distance_and_normal(local_point.xy(), growth);
        let along = (local_point.z - self.height / 2.0).abs() - self.height / 2.0;
        let end = Vector3::z() * (local_point.z - self.height / 2.0).signum();
        let nearest = NearestSurface::from_prism_side_and_end(across, outward.push(0.0), along, end);
        NearestSurface { outward_normal: self.frame * nearest.outward_normal, ..nearest }
    }
}

/// Radius over the angle ψ: `radius + Σ cos·cos nψ + sin·sin nψ`, mm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RadiusProfile {
    /// Mean radius, mm.
    radius: f64,
    /// (order, cosine, sine), mm, by increasing order.
    order_cos_sin_terms: Vec<(u32, f64, f64)>,
    /// Upper bound of the deviation of the radius from its mean, mm.
    max_deviation_bound: f64,
}

impl RadiusProfile {
    pub fn new(radius: f64, form: impl IntoIterator<Item = FormHarmonic>) -> Self {
        let mut terms: Vec<_> = form.into_iter().map(|h| (h.n, h.cos_um * 1e-3, h.sin_um * 1e-3)).collect();
        terms.sort_by_key(|(order, ..)| *order);
        let amplitude = terms.iter().map(|(_, c, s)| c.hypot(*s)).sum();
        Self { radius, order_cos_sin_terms: terms, max_deviation_bound: amplitude }
    }

    /// Lower bound of the radius, mm; a profile is valid only if it is positive.
    pub fn min_radius_bound(&self) -> f64 {
        self.radius - self.max_deviation_bound
    }

    /// Radius and its first two derivatives by ψ, mm.
    fn radius_and_derivatives(&self, psi: f64) -> [f64; 3] {
        let (mut sums, mut order) = ([self.radius, 0.0, 0.0], 0);
        let (sin_psi, cos_psi) = psi.sin_cos();
        // Cosine and sine of order·psi, by the addition theorem: calls of `sin` would dominate the computing time.
        let (mut cos, mut sin) = (1.0, 0.0);
        for (n, c, s) in &self.order_cos_sin_terms {
            while order < *n {
                (cos, sin) = (cos * cos_psi - sin * sin_psi, sin * cos_psi + cos * sin_psi);
                order += 1;
            }
            let (n, value) = (f64::from(*n), c * cos + s * sin);
            sums = [sums[0] + value, sums[1] + n * (s * cos - c * sin), sums[2] - n * n * value];
        }
        sums
    }

    /// Signed distance of `point` from the profile grown by `growth`, and the outward normal.
    fn signed_distance_and_normal(&self, point: Vector2<f64>, growth: f64) -> (f64, Vector2<f64>) {
        let (rho, angle) = (point.norm(), point.y.atan2(point.x));
        let [r, ..] = self.radius_and_derivatives(angle);
        let psi =
            if self.order_cos_sin_terms.is_empty() { angle } else { self.nearest_point_angle(rho, angle, growth) };
        let [r_foot, slope, _] = self.radius_and_derivatives(psi);
        let (sin, cos) = psi.sin_cos();
        let (radial, round) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        let gap = point - radial * (r_foot + growth);
        let side = if rho < r + growth { -1.0 } else { 1.0 };
        let normal = (radial * (r_foot + growth) - round * slope).normalize();
        (side * gap.norm(), normal)
    }

    /// Angle of the profile's nearest point. It lies in a window about the angle of `point`; the best sample of
    /// the window starts Newton's iteration.
    fn nearest_point_angle(&self, rho: f64, angle: f64, growth: f64) -> f64 {
        let distance2 = |psi: f64| {
            let r = self.radius_and_derivatives(psi)[0] + growth;
            (rho - r).powi(2) + 4.0 * rho * r * ((psi - angle) / 2.0).sin().powi(2)
        };
        let window = self.search_half_width_rad(rho, distance2(angle).sqrt(), growth);
        let order = self.order_cos_sin_terms.last().map_or(1.0, |(order, ..)| f64::from(*order).max(1.0));
        let samples = (window * order * 4.0 / PI).ceil().max(1.0) as i32;
        let best = (-samples..=samples)
            .map(|i| angle + window * f64::from(i) / f64::from(samples))
            .min_by(|a, b| distance2(*a).total_cmp(&distance2(*b)))
            .unwrap_or(angle);
        self.refine_nearest_point_angle(rho, angle, growth, best)
    }

    /// Half-width of the window, rad. A profile point outside of it is farther away than the profile point at
    /// the same angle, whose distance is `straight`.
    fn search_half_width_rad(&self, rho: f64, straight: f64, growth: f64) -> f64 {
        let chord = 4.0 * rho * (self.min_radius_bound() + growth);
        let sine2 = 4.0 * self.max_deviation_bound * straight / chord;
        if sine2 < 1.0 { 2.0 * sine2.sqrt().asin() } else { PI }
    }

    /// Newton's iteration on the derivative of half the squared distance.
    fn refine_nearest_point_angle(&self, rho: f64, angle: f64, growth: f64, start: f64) -> f64 {
        let mut psi = start;
        for _ in 0..30 {
            let [r, d, dd] = self.radius_and_derivatives(psi);
            let r = r + growth;
            let (sin, cos) = (psi - angle).sin_cos();
            let slope = r * d - rho * (d * cos - r * sin);
            let bend = d * d + r * dd - rho * (dd * cos - 2.0 * d * sin - r * cos);
            let step = slope / if bend > 0.0 { bend } else { rho * r };
            psi -= step;
            if step.abs() < 1e-14 {
                break;
            }
        }
        psi
    }
}
