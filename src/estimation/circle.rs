//! Fit of the least-squares circle to plane points (ISO 230-7: LSC): it minimises the sum of the squared radial
//! deviations.

use super::radial_fit::{self, RadialError, RadialFit};

/// Least-squares circle, in the unit of its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    pub centre: [f64; 2],
    pub radius: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CircleError {
    /// Contains the number of points.
    #[error("a circle needs three points, there are {0}; measure more positions")]
    TooFewPoints(usize),
    /// The points are on one line or coincide.
    #[error("the points lie on a line or coincide; spread them along the arc")]
    Collinear,
    #[error("a point of the circle is not a finite number; check the input")]
    NotFinite,
    #[error("the circle fit did not converge; the points do not resemble a circle")]
    NotConverged,
}

/// Fits the circle to three points or more.
///
/// # Errors
/// Fewer points, points on one line, or points that resemble no circle.
pub fn fit_circle(points: &[[f64; 2]]) -> Result<Circle, CircleError> {
    let RadialFit { centre, radius, .. } = radial_fit::fit_circle_or_sphere(points).map_err(|error| match error {
        RadialError::TooFewPoints(count) => CircleError::TooFewPoints(count),
        RadialError::CollinearOrCoplanar => CircleError::Collinear,
        RadialError::NotFinite => CircleError::NotFinite,
        RadialError::NotConverged => CircleError::NotConverged,
    })?;
    Ok(Circle { centre, radius })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points_on_circle(centre: [f64; 2], radius: f64, angles: &[f64]) -> Vec<[f64; 2]> {
        angles.iter().map(|a| [centre[0] + radius * a.cos(), centre[1] + radius * a.sin()]).collect()
    }

    #[test]
    fn circle_is_recovered_from_exact_points() {
        for (centre, radius, angles) in [
            ([0.003, 0.0051], 0.0059, vec![0.0, 0.8, 1.6, 2.4, 3.2, 4.0, 4.8, 5.6]),
            ([250.0, -400.0], 12.0, vec![0.0, 2.0, 4.0]),
            ([0.0, 0.0], 100.0, vec![0.1, 0.15, 0.2, 0.25, 0.3]),
        ] {
            let found = fit_circle(&points_on_circle(centre, radius, &angles)).unwrap();
            let error = (found.centre[0] - centre[0]).hypot(found.centre[1] - centre[1]);
            assert!(error < 1e-10 * (radius + 400.0), "{error}");
            assert!((found.radius - radius).abs() < 1e-9 * (radius + 1.0));
        }
    }

    /// The reference is the minimum of the sum of squares, found by search on successively finer grids.
    #[test]
    fn fit_of_noisy_points_agrees_with_grid_search() {
        let points = [[1.0, 0.0], [0.1, 1.2], [-0.9, 0.1], [0.2, -1.3], [0.8, 0.5], [-0.5, -0.9]];
        let squares = |x: f64, y: f64| {
            let d: Vec<f64> = points.iter().map(|p| (p[0] - x).hypot(p[1] - y)).collect();
            let mean = d.iter().sum::<f64>() / d.len() as f64;
            d.iter().map(|d| (d - mean).powi(2)).sum::<f64>()
        };
        let (mut best, mut span) = ([0.0, 0.0], 1.0);
        while span > 1e-9 {
            let grid = (-10..=10).flat_map(|i| (-10..=10).map(move |j| (i, j)));
            let around =
                grid.map(|(i, j)| [best[0] + span * f64::from(i) / 10.0, best[1] + span * f64::from(j) / 10.0]);
            let least = around.min_by(|a, b| squares(a[0], a[1]).total_cmp(&squares(b[0], b[1])));
            best = least.unwrap();
            span *= 0.3;
        }
        let found = fit_circle(&points).unwrap();
        // The position of a minimum is determined only to the square root of the rounding error of the sum.
        assert!((found.centre[0] - best[0]).hypot(found.centre[1] - best[1]) < 1e-7);
        assert!(squares(found.centre[0], found.centre[1]) <= squares(best[0], best[1]) + 1e-15);
    }

    #[test]
    fn points_without_a_circle_are_refused() {
        assert_eq!(fit_circle(&[[0.0, 0.0], [1.0, 0.0]]), Err(CircleError::TooFewPoints(2)));
        let line: Vec<[f64; 2]> = (0..7).map(|i| [1e3 + 0.1 * f64::from(i), 0.3 * f64::from(i)]).collect();
        assert_eq!(fit_circle(&line), Err(CircleError::Collinear));
        assert_eq!(fit_circle(&[[2.0, 2.0]; 5]), Err(CircleError::Collinear));
        assert_eq!(fit_circle(&[[f64::NAN, 0.0]; 3]), Err(CircleError::NotFinite));
    }
}
