//! Values of a function over one revolution, interpolated from the points of an estimate.

use machine::record::estimate::EstimatedFunction;

const REVOLUTION_DEG: f64 = 360.0;
/// Angle below which two points count as one, degrees.
const ANGLE_TOLERANCE_DEG: f64 = 1e-6;
/// Maximum angle between neighbouring points, degrees; a function with a larger gap is refused.
const MAX_POINT_GAP_DEG: f64 = 90.0;

/// One point: angle, degrees in 0 … 360; value and standard uncertainty in internal units.
#[derive(Debug, Clone, Copy)]
pub struct PeriodicPoint {
    pub angle_deg: f64,
    pub value: f64,
    pub u: f64,
}

/// Points by increasing angle, with mean zero over the revolution.
#[derive(Debug, Clone)]
pub struct PeriodicPoints(Vec<PeriodicPoint>);

impl PeriodicPoints {
    /// Merges points at one angle: the mean of their values, the largest of their u.
    ///
    /// # Errors
    /// A number is missing or not finite, the points exceed one revolution, or a gap exceeds 90°. The text is the end
    /// of a sentence about the function.
    pub fn new(function: &EstimatedFunction) -> Result<Self, String> {
        let EstimatedFunction { x, y, u, unit, .. } = function;
        let are_numbers = [x, y, u].iter().all(|list| list.iter().all(|value| value.is_finite()));
        if x.len() != y.len() || x.len() != u.len() || !are_numbers {
            return Err("has values of x, y or u that are missing or not numbers".to_owned());
        }
        let first = x.iter().copied().fold(f64::INFINITY, f64::min);
        let last = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if last - first > REVOLUTION_DEG + ANGLE_TOLERANCE_DEG {
            return Err(format!("covers more than one revolution ({first}° to {last}°)"));
        }
        let internal = 1.0 / unit.to_reported_value(1.0);
        let point = |i: usize| {
            let deg = x[i].rem_euclid(REVOLUTION_DEG);
            let deg = if REVOLUTION_DEG - deg < ANGLE_TOLERANCE_DEG { 0.0 } else { deg };
            PeriodicPoint { angle_deg: deg, value: y[i] * internal, u: u[i] * internal }
        };
        let points = Self(merge_equal_angles((0..x.len()).map(point).collect()));
        let gap = points.neighbour_pairs().map(|(one, next)| angle_to_next_deg(one, next)).fold(0.0, f64::max);
        if points.0.len() < 2 || gap > MAX_POINT_GAP_DEG {
            return Err(format!("has a gap of more than {MAX_POINT_GAP_DEG}° between two points"));
        }
        Ok(points.subtract_mean())
    }

    /// Periodic linear interpolation between neighbouring points.
    pub fn interpolate(&self, deg: f64) -> PeriodicPoint {
        let deg = deg.rem_euclid(REVOLUTION_DEG);
        let (count, after) = (self.0.len(), self.0.partition_point(|point| point.angle_deg <= deg));
        let (one, next) = (self.0[(after + count - 1) % count], self.0[after % count]);
        let share = (deg - one.angle_deg).rem_euclid(REVOLUTION_DEG) / angle_to_next_deg(one, next);
        let between = |from: f64, to: f64| from + share * (to - from);
        PeriodicPoint { angle_deg: deg, value: between(one.value, next.value), u: between(one.u, next.u) }
    }

    /// Pairs of neighbours, including the last point with the first.
    fn neighbour_pairs(&self) -> impl Iterator<Item = (PeriodicPoint, PeriodicPoint)> + '_ {
        let next = self.0.iter().cycle().skip(1);
        self.0.iter().zip(next).map(|(one, next)| (*one, *next))
    }

    fn subtract_mean(mut self) -> Self {
        let part = |(one, next)| angle_to_next_deg(one, next) * (one.value + next.value) / 2.0;
        let mean = self.neighbour_pairs().map(part).sum::<f64>() / REVOLUTION_DEG;
        self.0.iter_mut().for_each(|point| point.value -= mean);
        self
    }
}

/// Angle from a point to its neighbour, degrees; 0 if both are the same point.
fn angle_to_next_deg(one: PeriodicPoint, next: PeriodicPoint) -> f64 {
    (next.angle_deg - one.angle_deg).rem_euclid(REVOLUTION_DEG)
}

fn merge_equal_angles(mut points: Vec<PeriodicPoint>) -> Vec<PeriodicPoint> {
    points.sort_by(|one, other| one.angle_deg.total_cmp(&other.angle_deg));
    let same = |one: &PeriodicPoint, next: &PeriodicPoint| next.angle_deg - one.angle_deg < ANGLE_TOLERANCE_DEG;
    let mean = |group: &[PeriodicPoint]| PeriodicPoint {
        angle_deg: group[0].angle_deg,
        value: group.iter().map(|point| point.value).sum::<f64>() / group.len() as f64,
        u: group.iter().map(|point| point.u).fold(0.0, f64::max),
    };
    points.chunk_by(same).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::record::estimate::{FunctionFigureKind, Unit};

    fn function(x: &[f64], y: &[f64]) -> EstimatedFunction {
        EstimatedFunction {
            symbol: "EXC".to_owned(),
            argument: "C".to_owned(),
            argument_unit: "deg".to_owned(),
            x: x.to_vec(),
            unit: Unit::Um,
            y: y.to_vec(),
            u: x.iter().map(|deg| 0.1 + deg.abs() / 1000.0).collect(),
            figure: FunctionFigureKind::Polar,
            at_mm: None,
        }
    }

    /// A triangle wave of mean 1 with a closing point: 0, 1, 2, 1 at the quarters.
    #[test]
    fn interpolation_is_linear_periodic_and_of_zero_mean() {
        let closed = function(&[0.0, 90.0, 180.0, 270.0, 360.0], &[0.0, 1.0, 2.0, 1.0, 0.0]);
        let open = function(&[-90.0, 0.0, 90.0, 180.0], &[1.0, 0.0, 1.0, 2.0]);
        for points in [closed, open].map(|function| PeriodicPoints::new(&function).unwrap()) {
            for (deg, um) in [(0.0, -1.0), (45.0, -0.5), (315.0, -0.5), (-45.0, -0.5), (540.0, 1.0)] {
                let value = points.interpolate(deg).value;
                assert!((value - um * 1e-3).abs() < 1e-15, "{deg}: {value}");
            }
        }
    }

    #[test]
    fn points_at_one_angle_are_merged() {
        let twice = function(&[0.0, 0.0, 90.0, 180.0, 270.0], &[2.0, 4.0, 3.0, 3.0, 3.0]);
        let points = PeriodicPoints::new(&twice).unwrap();
        assert!(points.interpolate(0.0).value.abs() < 1e-15);
        assert!((points.interpolate(90.0).u - 0.19e-3).abs() < 1e-15);
    }

    #[test]
    fn points_beyond_one_revolution_or_with_wide_gaps_are_refused() {
        let reason = |x: &[f64]| PeriodicPoints::new(&function(x, &vec![0.0; x.len()])).unwrap_err();
        assert!(reason(&[0.0, 90.0, 180.0, 270.0, 450.0]).contains("more than one revolution"));
        assert!(reason(&[0.0, 90.0, 180.0]).contains("more than 90°"));
        assert!(reason(&[0.0]).contains("more than 90°") && reason(&[]).contains("more than 90°"));
        assert!(reason(&[0.0, 90.0, f64::NAN]).contains("missing or not numbers"));
    }
}
