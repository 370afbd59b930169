//! The least-squares sphere of points in space. The fit minimises the sum of the squared radial deviations.
//! The points are a few touches on a ball or the samples of a scan.

use super::radial_fit::{self, RadialError, RadialFit};

/// Least-squares sphere, in the unit of its points.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedSphere {
    pub centre: [f64; 3],
    pub radius: f64,
    /// Distance of each point from the centre less radius, positive outside.
    pub residuals: Vec<f64>,
    /// Covariance of x, y, z and radius for unit variance of a radial reading. It depends only on the directions of
    /// the readings. Multiplied by u² it is the covariance for the standard uncertainty u.
    pub unit_variance_covariance: [[f64; 4]; 4],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SphereError {
    #[error("a sphere needs four points, there are {0}; touch the ball at more places")]
    TooFewPoints(usize),
    #[error("the points lie in a plane or coincide; touch the ball at its pole as well")]
    Coplanar,
    #[error("a point or the radius of the sphere is not a finite number; check the input")]
    NotFinite,
    #[error("the sphere fit did not converge; the points do not resemble a sphere")]
    NotConverged,
}

/// Fits centre and radius to four points or more.
///
/// # Errors
/// Fewer points, points in one plane, or points that resemble no sphere.
pub fn fit_sphere(points: &[[f64; 3]]) -> Result<FittedSphere, SphereError> {
    let RadialFit { centre, radius, residuals, covariance } =
        radial_fit::fit_circle_or_sphere(points).map_err(|error| match error {
            RadialError::TooFewPoints(count) => SphereError::TooFewPoints(count),
            RadialError::CollinearOrCoplanar => SphereError::Coplanar,
            RadialError::NotFinite => SphereError::NotFinite,
            RadialError::NotConverged => SphereError::NotConverged,
        })?;
    let covariance = std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)]));
    Ok(FittedSphere { centre, radius, residuals, unit_variance_covariance: covariance })
}

impl FittedSphere {
    /// Covariance of the centre when each radial reading has the standard uncertainty `reading_std_u`.
    pub fn centre_covariance(&self, reading_std_u: f64) -> [[f64; 3]; 3] {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| reading_std_u * reading_std_u * self.unit_variance_covariance[i][j])
        })
    }

    /// Largest less smallest residual, unit of the points.
    pub fn form_deviation(&self) -> f64 {
        let of = |pick: fn(f64, f64) -> f64, from: f64| self.residuals.iter().copied().fold(from, pick);
        of(f64::max, f64::NEG_INFINITY) - of(f64::min, f64::INFINITY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four touches around the ball at `elevation` (rad) from its equator, and one at the pole.
    fn five_touches(centre: [f64; 3], radius: f64, elevation: f64) -> Vec<[f64; 3]> {
        let on = |azimuth: f64, elevation: f64| {
            let (s, c) = elevation.sin_cos();
            let n = [c * azimuth.to_radians().cos(), c * azimuth.to_radians().sin(), s];
            std::array::from_fn(|k| centre[k] + radius * n[k])
        };
        let round = [45.0, -135.0, -45.0, 135.0].map(|azimuth| on(azimuth, elevation));
        round.into_iter().chain([on(0.0, std::f64::consts::FRAC_PI_2)]).collect()
    }

    #[test]
    fn five_exact_touches_return_centre_and_radius() {
        for (centre, radius, elevation) in
            [([1e4, -3e3, 250.0], 15.0, 0.0), ([0.0, 0.0, 0.0], 1e-2, 0.5), ([1.0, 2.0, 3.0], 1e3, -0.2)]
        {
            let points = five_touches(centre, radius, elevation);
            let free = fit_sphere(&points).unwrap();
            let distance = |found: [f64; 3]| (0..3).map(|k| (found[k] - centre[k]).powi(2)).sum::<f64>().sqrt();
            let rounding = 4e-16 * (radius + centre[0].abs());
            assert!(distance(free.centre) < 20.0 * rounding, "{}", distance(free.centre));
            assert!((free.radius - radius).abs() < 20.0 * rounding);
        }
    }

    /// Touches on the equator and the pole, computed by hand: Σ u uᵀ = diag(2, 2, 1), Σu = (0, 0, 1). The radius is
    /// the mean of four touches, z is the pole less the radius.
    #[test]
    fn covariance_of_five_touches_equals_hand_calculation() {
        let points = five_touches([10.0, 20.0, 30.0], 12.5, 0.0);
        let free = fit_sphere(&points).unwrap();
        let expected = [[0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.25, -0.25], [0.0, 0.0, -0.25, 0.25]];
        for (found, expected) in free.unit_variance_covariance.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-12, "{:?}", free.unit_variance_covariance);
        }
        let centre = free.centre_covariance(0.002);
        for (i, expected) in [2e-6, 2e-6, 5e-6].into_iter().enumerate() {
            assert!((centre[i][i] - expected).abs() < 1e-15);
        }
    }

    #[test]
    fn points_that_define_no_sphere_are_refused() {
        let points = five_touches([5.0, 6.0, 7.0], 10.0, 0.3);
        assert_eq!(fit_sphere(&points[..3]), Err(SphereError::TooFewPoints(3)));
        assert_eq!(fit_sphere(&points[..4]), Err(SphereError::Coplanar));
        assert_eq!(fit_sphere(&[[1.0, 2.0, 3.0]; 5]), Err(SphereError::Coplanar));
        assert_eq!(fit_sphere(&[[f64::NAN; 3]; 5]), Err(SphereError::NotFinite));
    }
}
