//! The least-squares circle of plane points (ISO 230-7: LSC): the sum of the squared radial
//! deviations is least.

/// Least-squares circle, in the unit of its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    pub centre: [f64; 2],
    pub radius: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CircleError {
    #[error("a circle needs three points, there are {0}; measure more positions")]
    TooFew(usize),
    #[error("the points lie on a line or coincide; spread them along the arc")]
    Collinear,
    #[error("a point of the circle is not a finite number; check the input")]
    NotFinite,
    #[error("the circle fit did not converge; the points do not resemble a circle")]
    NotConverged,
}

/// Sagitta over length below which points count as collinear, squared.
const FLATNESS: f64 = 1e-14;
const MAX_STEPS: usize = 5000;

/// Fits the circle: algebraic start (Kåsa 1976), then Gauss–Newton on the centre with the radius
/// eliminated (it is the mean distance), each step halved until the deviations shrink.
pub fn fit_circle(points: &[[f64; 2]]) -> Result<Circle, CircleError> {
    if points.len() < 3 {
        return Err(CircleError::TooFew(points.len()));
    }
    if points.iter().flatten().any(|coordinate| !coordinate.is_finite()) {
        return Err(CircleError::NotFinite);
    }
    let mut centre = algebraic_centre(points)?;
    let mut at = Radial::new(points, centre);
    for _ in 0..MAX_STEPS {
        let Some(mut step) = at.step() else { return Err(CircleError::NotConverged) };
        loop {
            let trial = [centre[0] + step[0], centre[1] + step[1]];
            let next = Radial::new(points, trial);
            let small = step[0].hypot(step[1]) <= 1e-13 * (at.radius + trial[0].hypot(trial[1]));
            if small {
                return Ok(Circle { centre, radius: at.radius });
            }
            // The slack is the rounding of the sum: near the minimum the step knows better.
            if next.squares <= at.squares * (1.0 + 1e-12) {
                (centre, at) = (trial, next);
                break;
            }
            step = step.map(|part| 0.5 * part);
        }
    }
    Err(CircleError::NotConverged)
}

/// Minimiser of Σ(|p − c|² − r²)², on points reduced to their mean.
fn algebraic_centre(points: &[[f64; 2]]) -> Result<[f64; 2], CircleError> {
    let mean = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64);
    let mut normal = Normal::default();
    for p in points {
        let [x, y] = [p[0] - mean[0], p[1] - mean[1]];
        normal.add([x, y], 0.5 * (x * x + y * y));
    }
    if normal.determinant() <= FLATNESS * (normal.xx + normal.yy).powi(2) {
        return Err(CircleError::Collinear);
    }
    let offset = normal.solve();
    Ok([mean[0] + offset[0], mean[1] + offset[1]])
}

/// Radial deviations about a centre and their normal equations.
struct Radial {
    radius: f64,
    squares: f64,
    normal: Normal,
}

impl Radial {
    fn new(points: &[[f64; 2]], centre: [f64; 2]) -> Self {
        let count = points.len() as f64;
        let polar: Vec<([f64; 2], f64)> = points
            .iter()
            .map(|p| {
                let (x, y) = (p[0] - centre[0], p[1] - centre[1]);
                let distance = x.hypot(y);
                // A point on the centre has no direction: it does not pull.
                let safe = if distance > 0.0 { distance } else { 1.0 };
                ([x / safe, y / safe], distance)
            })
            .collect();
        let radius = polar.iter().map(|(_, distance)| distance).sum::<f64>() / count;
        let mean = [0, 1].map(|k| polar.iter().map(|(unit, _)| unit[k]).sum::<f64>() / count);
        let mut normal = Normal::default();
        let mut squares = 0.0;
        for (unit, distance) in &polar {
            normal.add([unit[0] - mean[0], unit[1] - mean[1]], distance - radius);
            squares += (distance - radius).powi(2);
        }
        Self { radius, squares, normal }
    }

    fn step(&self) -> Option<[f64; 2]> {
        (self.normal.determinant() > 0.0).then(|| self.normal.solve())
    }
}

/// Normal equations of two unknowns.
#[derive(Default)]
struct Normal {
    xx: f64,
    xy: f64,
    yy: f64,
    right: [f64; 2],
}

impl Normal {
    fn add(&mut self, [x, y]: [f64; 2], value: f64) {
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
        self.right[0] += x * value;
        self.right[1] += y * value;
    }

    fn determinant(&self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    fn solve(&self) -> [f64; 2] {
        let [x, y] = self.right;
        let determinant = self.determinant();
        [(x * self.yy - y * self.xy) / determinant, (y * self.xx - x * self.xy) / determinant]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on_circle(centre: [f64; 2], radius: f64, angles: &[f64]) -> Vec<[f64; 2]> {
        angles
            .iter()
            .map(|a| [centre[0] + radius * a.cos(), centre[1] + radius * a.sin()])
            .collect()
    }

    #[test]
    fn regress_exact_points_give_the_circle_back() {
        for (centre, radius, angles) in [
            ([0.003, 0.0051], 0.0059, vec![0.0, 0.8, 1.6, 2.4, 3.2, 4.0, 4.8, 5.6]),
            ([250.0, -400.0], 12.0, vec![0.0, 2.0, 4.0]),
            ([0.0, 0.0], 100.0, vec![0.1, 0.15, 0.2, 0.25, 0.3]),
        ] {
            let found = fit_circle(&on_circle(centre, radius, &angles)).unwrap();
            let error = (found.centre[0] - centre[0]).hypot(found.centre[1] - centre[1]);
            assert!(error < 1e-10 * (radius + 400.0), "{error}");
            assert!((found.radius - radius).abs() < 1e-9 * (radius + 1.0));
        }
    }

    /// The minimum of the same sum, found on ever finer grids.
    #[test]
    fn regress_noisy_points_against_brute_force() {
        let points = [[1.0, 0.0], [0.1, 1.2], [-0.9, 0.1], [0.2, -1.3], [0.8, 0.5], [-0.5, -0.9]];
        let squares = |x: f64, y: f64| {
            let d: Vec<f64> = points.iter().map(|p| (p[0] - x).hypot(p[1] - y)).collect();
            let mean = d.iter().sum::<f64>() / d.len() as f64;
            d.iter().map(|d| (d - mean).powi(2)).sum::<f64>()
        };
        let (mut best, mut span) = ([0.0, 0.0], 1.0);
        while span > 1e-9 {
            let grid = (-10..=10).flat_map(|i| (-10..=10).map(move |j| (i, j)));
            let around = grid.map(|(i, j)| {
                [best[0] + span * f64::from(i) / 10.0, best[1] + span * f64::from(j) / 10.0]
            });
            let least = around.min_by(|a, b| squares(a[0], a[1]).total_cmp(&squares(b[0], b[1])));
            best = least.unwrap();
            span *= 0.3;
        }
        let found = fit_circle(&points).unwrap();
        // A minimum is known to the square root of the rounding of the sum.
        assert!((found.centre[0] - best[0]).hypot(found.centre[1] - best[1]) < 1e-7);
        assert!(squares(found.centre[0], found.centre[1]) <= squares(best[0], best[1]) + 1e-15);
    }

    #[test]
    fn regress_no_circle_is_refused() {
        assert_eq!(fit_circle(&[[0.0, 0.0], [1.0, 0.0]]), Err(CircleError::TooFew(2)));
        let line: Vec<[f64; 2]> =
            (0..7).map(|i| [1e3 + 0.1 * f64::from(i), 0.3 * f64::from(i)]).collect();
        assert_eq!(fit_circle(&line), Err(CircleError::Collinear));
        assert_eq!(fit_circle(&[[2.0, 2.0]; 5]), Err(CircleError::Collinear));
        assert_eq!(fit_circle(&[[f64::NAN, 0.0]; 3]), Err(CircleError::NotFinite));
    }
}
