//! The centre and the two circles of an error motion polar plot (ISO 230-7).

use nalgebra::{Matrix3, Vector3};

use super::PlotPoint;
use super::ticked_axis::value_bounds;

/// Centre about which the value of an error motion is taken (ISO 230-7).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::report) enum MotionCentre {
    /// Least-squares circle centre, for radial and tilt error motions: their first harmonic is an offset.
    LeastSquares,
    /// Polar chart centre, for axial error motion and angular positioning: their first harmonic is a motion.
    Chart,
}

impl MotionCentre {
    /// Centre for the error motion with this symbol, `EXC` to `ECC` of a rotary axis; `None` for any other
    /// function.
    pub(in crate::report) fn from_symbol(symbol: &str) -> Option<Self> {
        let &[b'E', component, axis] = symbol.as_bytes() else { return None };
        let along = match axis {
            b'A' => b'X',
            b'B' => b'Y',
            b'C' => b'Z',
            _ => return None,
        };
        match component {
            _ if component == along || component == axis => Some(Self::Chart),
            b'X' | b'Y' | b'Z' | b'A' | b'B' | b'C' => Some(Self::LeastSquares),
            _ => None,
        }
    }
}

/// Two concentric circles: the smallest that contains the curve, and the largest inside the curve. Error motions are
/// small against the radius at which a chart draws them. Therefore a circle about the centre (x, y) is the curve
/// radius + x·cos θ + y·sin θ (a limaçon), which does not depend on the radius that the chart chooses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::report) struct MotionCircles {
    /// Centre of the circles, from the centre of the chart, in the unit of the function.
    pub centre: [f64; 2],
    /// Radius of the mean circle about the same centre, less the radius of the zero circle; with the least-squares
    /// centre, the least-squares circle.
    pub mean: f64,
    /// Radius of the largest circle inside the curve, less the radius of the chart's zero circle; may be negative.
    pub inner: f64,
    /// Radius of the smallest circle that contains the curve, less the radius of the chart's zero circle.
    pub outer: f64,
}

impl MotionCircles {
    /// The circles of a curve; `None`: too few angles for the centre.
    pub(super) fn new(samples: &[PlotPoint], centre_kind: MotionCentre) -> Option<Self> {
        let [mean, cosine, sine] = least_squares_circle(samples)?;
        let centre = match centre_kind {
            MotionCentre::LeastSquares => [cosine, sine],
            MotionCentre::Chart => [0.0, 0.0],
        };
        let circles = Self { centre, mean, inner: 0.0, outer: 0.0 };
        let distances = samples.iter().map(|sample| sample.y - circles.centre_offset_at_angle(sample.x));
        let (inner, outer) = value_bounds(distances)?;
        Some(Self { inner, outer, ..circles })
    }

    /// The error motion value: outer minus inner radius.
    pub(in crate::report) fn value(&self) -> f64 {
        self.outer - self.inner
    }

    /// Difference at an angle between a circle about this centre and the same circle about the centre of the
    /// chart.
    pub(super) fn centre_offset_at_angle(&self, degrees: f64) -> f64 {
        let (sin, cos) = degrees.to_radians().sin_cos();
        self.centre[0] * cos + self.centre[1] * sin
    }
}

/// a, b and c of a + b·cos θ + c·sin θ by least squares: 1/N·Σ y, 2/N·Σ y·cos θ and 2/N·Σ y·sin θ at equal angles.
/// `None`: too few different angles.
pub(super) fn least_squares_circle(samples: &[PlotPoint]) -> Option<[f64; 3]> {
    let is_first_again = |sample: &&PlotPoint| {
        let turns = (sample.x - samples[0].x) / 360.0;
        turns > 0.0 && turns.fract() == 0.0
    };
    // A closed curve contains its first angle twice.
    let once = samples.len() - usize::from(samples.last().as_ref().is_some_and(is_first_again));
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for sample in &samples[..once] {
        let (sin, cos) = sample.x.to_radians().sin_cos();
        let row = Vector3::new(1.0, cos, sin);
        normal += row * row.transpose();
        right += row * sample.y;
    }
    // With only two different angles the matrix is singular except for rounding.
    let is_regular = normal.determinant() > 1e-9 * (once as f64).powi(3);
    let solution = is_regular.then(|| normal.try_inverse()).flatten()? * right;
    Some([solution.x, solution.y, solution.z])
}

#[cfg(test)]
mod tests {
    use super::super::tests::{is_inside_picture, sine_function, svg_coordinates};
    use super::super::{FunctionFigure, draw_function};
    use super::{MotionCentre, MotionCircles};
    use machine::record::estimate::{EstimatedFunction, FunctionFigureKind};

    fn motion(function: &EstimatedFunction) -> Option<(MotionCentre, MotionCircles)> {
        FunctionFigure::new(function, 0.0).error_motion_circles
    }

    /// A function over whole revolutions in steps of 5°.
    fn function_of_angle(symbol: &str, revolutions: u32, value: impl Fn(f64) -> f64) -> EstimatedFunction {
        let x: Vec<f64> = (0..=72 * revolutions).map(|n| f64::from(5 * n)).collect();
        let y: Vec<f64> = x.iter().map(|x| value(x.to_radians())).collect();
        let u = vec![0.0; x.len()];
        EstimatedFunction { symbol: symbol.to_owned(), x, y, u, ..sine_function(FunctionFigureKind::Polar, 1) }
    }

    /// 2 + 1.5·cos θ − 0.8·sin θ + 0.6·cos 3θ: a circle about (1.5, −0.8) and three lobes of ±0.6 on it.
    #[test]
    fn error_motion_value_is_relative_to_its_centre() {
        let lobes = |turn: f64| 1.5 * turn.cos() - 0.8 * turn.sin() + 0.6 * (3.0 * turn).cos() + 2.0;
        for symbol in ["EXC", "EAC", "EZA", "EXB"] {
            let (centre, circles) = motion(&function_of_angle(symbol, 1, lobes)).unwrap();
            assert_eq!(centre, MotionCentre::LeastSquares, "{symbol}");
            let known = [(circles.centre[0], 1.5), (circles.centre[1], -0.8), (circles.value(), 1.2)];
            for (found, expected) in known {
                assert!((found - expected).abs() < 1e-12, "{symbol}: {found}");
            }
        }
        // The first harmonic of an axial motion is a motion: 1.7·cos(θ + ..) alone has the range 3.4.
        for symbol in ["EZC", "ECC", "EXA", "EYB"] {
            let round = function_of_angle(symbol, 1, |turn| 1.5 * turn.cos() - 0.8 * turn.sin());
            let (centre, circles) = motion(&round).unwrap();
            assert_eq!((centre, circles.centre), (MotionCentre::Chart, [0.0; 2]));
            assert!((circles.value() - 3.4).abs() < 0.01, "{symbol}: {}", circles.value());
        }
        for symbol in ["W_form", "EXC_total", "EXX", "ESC", "R_1", "E"] {
            assert_eq!(motion(&function_of_angle(symbol, 1, lobes)), None, "{symbol}");
        }
        let mut unequal = function_of_angle("EXC", 1, lobes);
        (0..16).for_each(|_| {
            unequal.x.remove(12);
            unequal.y.remove(12);
        });
        let (_, circles) = motion(&EstimatedFunction { u: vec![0.0; 57], ..unequal }).unwrap();
        // At unequal angles the lobes are not orthogonal to the circle.
        assert!((circles.centre[0] - 1.5).abs() < 0.3 && circles.value() >= 1.2 - 1e-9);
        let one_angle = EstimatedFunction { x: vec![45.0; 8], ..sine_function(FunctionFigureKind::Polar, 8) };
        assert_eq!(motion(&EstimatedFunction { symbol: "EXC".to_owned(), ..one_angle }), None);
    }

    /// The scale rings of the chart are at −2, −1, 0, 1 and 2 µm, 60 picture units per µm. The least-squares centre of
    /// cos θ + 0.6·cos 3θ is at +1 µm, to the right.
    #[test]
    fn error_motion_circles_touch_the_curve() {
        let function = function_of_angle("EYC", 1, |turn| turn.cos() + 0.6 * (3.0 * turn).cos());
        let svg = draw_function(&function, 2.0).unwrap();
        let lines = |width: &str| -> Vec<Vec<f64>> {
            let of_width = |line: &&str| line.contains("stroke=\"#C2571A\"") && line.contains(width);
            svg.lines().filter(of_width).map(svg_coordinates).collect()
        };
        let circles = lines("stroke-width=\"2\"");
        let [inner, outer] = circles.as_slice() else { panic!("{}", circles.len()) };
        // At 0° the outer circle is at 0.6 + 1 µm, at 180° the inner one at −0.6 − 1 µm.
        assert_eq!(outer[..2], [450.0 + 240.0 + 96.0, 450.0]);
        assert_eq!(inner[120..122], [450.0 - 240.0 + 96.0, 450.0]);
        let centre = lines("stroke-width=\"4\"");
        assert_eq!(centre, [[492.0, 468.0, 528.0, 432.0], [492.0, 432.0, 528.0, 468.0]]);
        // The least-squares circle, in dashes: between the two others, 240 units about the centre at +1 µm.
        let dashes = lines("stroke-width=\"3\"");
        assert!(dashes.len() > 20, "{}", dashes.len());
        for point in dashes.iter().flat_map(|dash| dash.chunks(2)) {
            let (x, y) = (point[0] - 450.0, 450.0 - point[1]);
            assert!((x.hypot(y) - 240.0 - 60.0 * y.atan2(x).cos()).abs() <= 1.5, "{point:?}");
        }
        assert!(is_inside_picture(&svg));
    }

    /// Half a sine over each revolution: the curve continues over the second revolution and closes at the first
    /// angle.
    #[test]
    fn curve_of_two_revolutions_closes_after_the_second() {
        let svg = draw_function(&function_of_angle("EXC", 2, |turn| (turn / 2.0).sin()), 2.0).unwrap();
        let curve = svg.lines().find(|line| line.contains("#1F6FB2") && line.contains("stroke-width=\"4\"")).unwrap();
        let points = svg_coordinates(curve).len() / 2;
        // 144 steps of 5° in chords of at most 3°; the curve closes at 720°.
        assert_eq!(points, 144 * 2 + 1);
        assert!(is_inside_picture(&svg));
    }
}
