//! Comparison of the functions of two estimates, relative to a common reference point.

use serde::Serialize;

use super::parameter_difference::normalized_error;
use machine::record::estimate::{Estimate, EstimatedFunction, FunctionFigureKind, Unit};

/// Difference of one function between two estimates, second minus first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FunctionDifference {
    pub symbol: String,
    /// Name of the argument, such as an axis.
    pub argument: String,
    pub argument_unit: String,
    pub unit: Unit,
    /// Argument of the reference point. Functions of an angle are compared after their value at this argument is
    /// subtracted; `null`: the functions are compared without this subtraction.
    pub gauge_at: Option<f64>,
    /// Arguments, without that of the reference point, where the difference is zero by definition.
    pub x: Vec<f64>,
    /// Second minus first at each argument; with a reference point, minus the same difference there.
    pub by: Vec<f64>,
    /// Expanded uncertainty of `by`.
    #[serde(rename = "U")]
    pub expanded: Vec<f64>,
    /// Normalized error |by|/U (ISO 13528): the results agree up to 1.
    #[serde(rename = "E_n")]
    pub normalized_errors: Vec<f64>,
}

impl FunctionDifference {
    /// Index of the largest E_n.
    pub fn worst_point_index(&self) -> Option<usize> {
        (0..self.normalized_errors.len())
            .max_by(|i, j| self.normalized_errors[*i].total_cmp(&self.normalized_errors[*j]))
    }

    /// Number of points that agree (E_n up to 1).
    pub fn agreeing_point_count(&self) -> usize {
        self.normalized_errors.iter().filter(|e_n| **e_n <= 1.0).count()
    }

    fn push_point(&mut self, [one, other]: [FunctionPoint; 2], gauge: Option<[FunctionPoint; 2]>, k: f64) {
        let of_gauge = gauge.map(|[one, other]| (other.value - one.value, one.u.hypot(other.u)));
        let (shift, u_shift) = of_gauge.unwrap_or((0.0, 0.0));
        let by = other.value - one.value - shift;
        let expanded = k * one.u.hypot(other.u).hypot(u_shift);
        self.x.push(one.argument);
        self.by.push(by);
        self.expanded.push(expanded);
        self.normalized_errors.push(normalized_error(by, expanded));
    }
}

/// Differences of all comparable functions that both results have, in the order of the first, with the coverage
/// factor `k`. Results state u of each point without covariance. The u of both functions, at the point and at the
/// reference point, therefore count as independent and are added in quadrature.
pub fn function_differences(first: &Estimate, second: &Estimate, k: f64) -> Vec<FunctionDifference> {
    let pairs = first.functions.iter().filter_map(|one| {
        let same = |other: &&EstimatedFunction| is_comparable(one, other);
        Some((one, second.functions.iter().find(same)?))
    });
    pairs.filter_map(|(one, other)| function_difference(one, other, k)).collect()
}

/// Whether symbol, units and kind of figure match (curve and polar figure count as equal; histograms never match), and
/// both functions state an uncertainty, unlike residuals.
fn is_comparable(one: &EstimatedFunction, other: &EstimatedFunction) -> bool {
    let is_stated = |function: &EstimatedFunction| function.u.iter().any(|u| *u > 0.0);
    let of = |f: &EstimatedFunction| (f.symbol.clone(), f.argument_unit.clone(), f.unit);
    let is_drawn_alike = one.figure == other.figure || (is_curve(one) && is_curve(other));
    of(one) == of(other)
        && is_drawn_alike
        && one.figure != FunctionFigureKind::Histogram
        && is_stated(one)
        && is_stated(other)
}

/// Whether the points of the function are those of a curve.
fn is_curve(function: &EstimatedFunction) -> bool {
    matches!(function.figure, FunctionFigureKind::Curve | FunctionFigureKind::Polar)
}

/// One point of a function.
#[derive(Debug, Clone, Copy)]
struct FunctionPoint {
    argument: f64,
    value: f64,
    u: f64,
}

/// Finite points of a function, by increasing argument.
struct FunctionPoints(Vec<FunctionPoint>);

impl FunctionPoints {
    fn from_function(function: &EstimatedFunction) -> Self {
        let values = function.x.iter().zip(&function.y).zip(&function.u);
        let points = values.map(|((x, y), u)| FunctionPoint { argument: *x, value: *y, u: *u });
        let finite = |p: &FunctionPoint| p.argument.is_finite() && p.value.is_finite() && p.u.is_finite();
        let mut points: Vec<FunctionPoint> = points.filter(finite).collect();
        points.sort_by(|one, other| one.argument.total_cmp(&other.argument));
        Self(points)
    }

    /// Linear interpolation between the points; `None` outside of them.
    fn interpolate(&self, argument: f64) -> Option<FunctionPoint> {
        let next = self.0.partition_point(|point| point.argument < argument);
        let after = *self.0.get(next)?;
        if after.argument == argument {
            return Some(after);
        }
        let before = self.0[next.checked_sub(1)?];
        let share = (argument - before.argument) / (after.argument - before.argument);
        let between = |from: f64, to: f64| from + share * (to - from);
        let value = between(before.value, after.value);
        Some(FunctionPoint { argument, value, u: between(before.u, after.u) })
    }

    /// Value of the function at `argument`, if this is the argument of one of its points.
    fn point_at(&self, argument: f64) -> Option<FunctionPoint> {
        self.interpolate(argument).filter(|_| self.0.iter().any(|point| point.argument == argument))
    }
}

/// Difference of one function. `None`: the functions have no common argument besides that of the reference point.
fn function_difference(one: &EstimatedFunction, other: &EstimatedFunction, k: f64) -> Option<FunctionDifference> {
    let is_continuous = is_curve(one);
    let points = [one, other].map(FunctionPoints::from_function);
    let at = |x: f64| match is_continuous {
        true => Some([points[0].interpolate(x)?, points[1].interpolate(x)?]),
        false => Some([points[0].point_at(x)?, points[1].point_at(x)?]),
    };
    // The arguments of the function with fewer points, within the range of both.
    let common = |of: &FunctionPoints| -> Vec<[FunctionPoint; 2]> {
        let mut x: Vec<f64> = of.0.iter().map(|point| point.argument).collect();
        x.dedup();
        x.into_iter().filter_map(at).collect()
    };
    let (of_first, of_second) = (common(&points[0]), common(&points[1]));
    let pairs = if of_second.len() < of_first.len() { of_second } else { of_first };
    let first = *pairs.first()?;
    let gauge = (one.argument_unit == "deg").then(|| at(0.0).unwrap_or(first));
    let gauge_at = gauge.map(|[point, _]| point.argument);
    let mut found = FunctionDifference {
        symbol: one.symbol.clone(),
        argument: one.argument.clone(),
        argument_unit: one.argument_unit.clone(),
        unit: one.unit,
        gauge_at,
        x: Vec::new(),
        by: Vec::new(),
        expanded: Vec::new(),
        normalized_errors: Vec::new(),
    };
    for pair in pairs.into_iter().filter(|[point, _]| Some(point.argument) != gauge_at) {
        found.push_point(pair, gauge, k);
    }
    (!found.x.is_empty()).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn function(x: &[f64], y: &[f64], u: f64) -> EstimatedFunction {
        EstimatedFunction {
            symbol: "EXC".to_owned(),
            argument: "C".to_owned(),
            argument_unit: "deg".to_owned(),
            x: x.to_vec(),
            unit: Unit::Um,
            y: y.to_vec(),
            u: vec![u; x.len()],
            figure: FunctionFigureKind::Polar,
            at_mm: None,
        }
    }

    fn assert_near(found: &[f64], expected: &[f64]) {
        assert_eq!(found.len(), expected.len(), "{found:?}");
        let is_near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-12;
        assert!(found.iter().zip(expected).all(is_near), "{found:?} {expected:?}");
    }

    /// The second function has fewer points and an offset of 5 µm. At 90° the first is 1.5, which is 0.5 above its
    /// value at 0°; the second is 3 above its value at 0°. U = 2·√(2·0.3² + 2·0.4²) = √2.
    #[test]
    fn functions_are_compared_from_their_value_at_zero() {
        let one = function(&[0.0, 60.0, 120.0, 180.0, 240.0], &[1.0, 1.0, 2.0, 2.0, 0.0], 0.3);
        let other = function(&[-90.0, 0.0, 90.0, 180.0, 270.0], &[9.0, 6.0, 9.0, 7.0, 9.0], 0.4);
        let found = function_difference(&one, &other, 2.0).unwrap();
        assert_eq!((found.gauge_at, &found.x[..]), (Some(0.0), &[90.0, 180.0][..]));
        assert_near(&found.by, &[2.5, 0.0]);
        assert_near(&found.expanded, &[2f64.sqrt(); 2]);
        assert_near(&found.normalized_errors, &[2.5 / 2f64.sqrt(), 0.0]);
        assert_eq!((found.worst_point_index(), found.agreeing_point_count()), (Some(0), 1));
        let back = function_difference(&other, &one, 2.0).unwrap();
        assert_near(&back.by, &[-2.5, 0.0]);
    }

    /// If 0° is not within the range of both functions, the reference point is the first common angle.
    #[test]
    fn reference_point_is_within_both_functions() {
        let one = function(&[30.0, 60.0, 90.0], &[1.0, 2.0, 4.0], 0.1);
        let other = function(&[45.0, 60.0, 90.0], &[0.0, 0.0, 0.0], 0.1);
        let found = function_difference(&one, &other, 2.0).unwrap();
        // The common arguments, taken from the function with fewer points, are 60° and 90°.
        assert_eq!((found.gauge_at, &found.x[..]), (Some(60.0), &[90.0][..]));
        assert_near(&found.by, &[-2.0]);
        assert_eq!(function_difference(&one, &function(&[100.0, 120.0], &[0.0, 0.0], 0.1), 2.0), None);
    }

    /// Functions of orders or balls are not interpolated and have no reference point.
    #[test]
    fn spectrum_points_are_compared_without_interpolation() {
        let points = |x: &[f64], y: &[f64]| EstimatedFunction {
            argument_unit: String::new(),
            figure: FunctionFigureKind::Spectrum,
            ..function(x, y, 0.5)
        };
        let one = points(&[0.5, 1.0, 2.0, 4.0], &[1.0, 1.0, 2.0, 9.0]);
        let other = points(&[1.0, 2.0, 3.0], &[2.0, 2.0, 9.0]);
        let found = function_difference(&one, &other, 2.0).unwrap();
        assert_eq!((found.gauge_at, &found.x[..]), (None, &[1.0, 2.0][..]));
        assert_near(&found.by, &[1.0, 0.0]);
        assert_near(&found.expanded, &[2f64.sqrt(); 2]);
        let histogram = EstimatedFunction { figure: FunctionFigureKind::Histogram, ..one.clone() };
        assert!(!is_comparable(&histogram, &histogram.clone()) && is_comparable(&one, &other));
        let drawn = |figure| EstimatedFunction { figure, ..one.clone() };
        let [curve, polar] = [FunctionFigureKind::Curve, FunctionFigureKind::Polar].map(drawn);
        assert!(is_comparable(&curve, &polar) && !is_comparable(&curve, &one));
        let residuals = EstimatedFunction { u: vec![0.0; one.x.len()], ..one.clone() };
        assert!(!is_comparable(&residuals, &residuals.clone()));
    }
}
