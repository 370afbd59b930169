//! Functions of an angle over a full turn: the closed curve, and the removal of an eccentricity.

use super::PlotPoint;
use super::error_motion::{MotionCentre, least_squares_circle};
use super::ticked_axis::value_bounds;
use machine::record::estimate::{EstimatedFunction, FunctionFigureKind};

const TURN_DEG: f64 = 360.0;
/// Maximum angle between neighbouring samples of a full turn. A longer chord would show a shape that was not measured.
const MAX_GAP_DEG: f64 = 90.0;
/// Maximum ratio of the gap between the last and the first angle to the largest gap between the others.
const MAX_RATIO_OF_LAST_GAP: f64 = 1.01;
/// An eccentricity above this ratio to the range of the remaining values is removed: it would hide the form.
const MIN_RATIO_OF_REMOVED_ECCENTRICITY: f64 = 2.0;
/// Smaller differences between angles are rounding errors, degrees.
const ANGLE_TOLERANCE_DEG: f64 = 1e-6;

/// Kind of the figure that shows the function. An error motion or a radial deviation over a full turn is polar, a polar
/// figure over a part of a turn becomes a curve.
pub(super) fn kind_by_data(function: &EstimatedFunction, samples: &[PlotPoint]) -> FunctionFigureKind {
    let is_full_turn = function.argument_unit == "deg" && closing_angle(samples).is_some();
    let is_radial = MotionCentre::from_symbol(&function.symbol).is_some() || function.symbol.starts_with("E_radial");
    match function.figure {
        FunctionFigureKind::Polar if !is_full_turn => FunctionFigureKind::Curve,
        FunctionFigureKind::Curve if is_full_turn && is_radial => FunctionFigureKind::Polar,
        kind => kind,
    }
}

/// Angle after the last sample at which the curve closes, degrees: the first angle plus whole turns. It is the last
/// angle itself if the samples are already closed. `None`: the samples do not cover full turns.
pub(super) fn closing_angle(samples: &[PlotPoint]) -> Option<f64> {
    let (first, last) = (samples.first()?.x, samples.last()?.x);
    let gaps = || samples.windows(2).map(|pair| pair[1].x - pair[0].x);
    let (smallest, largest) = value_bounds(gaps())?;
    let turns = ((last - first - ANGLE_TOLERANCE_DEG) / TURN_DEG).ceil();
    let last_gap = first + turns * TURN_DEG - last;
    let covers_turns = smallest >= 0.0
        && largest <= MAX_GAP_DEG + ANGLE_TOLERANCE_DEG
        && last_gap <= MAX_RATIO_OF_LAST_GAP * largest
        && turns >= 1.0;
    covers_turns.then_some(last + last_gap.max(0.0))
}

/// The samples of one curve, with the first one repeated a full turn later if they cover full turns of an angle.
pub(super) fn close_full_turn(samples: &[PlotPoint]) -> Vec<PlotPoint> {
    let mut closed = samples.to_vec();
    let end =
        closing_angle(samples).filter(|end| samples.last().is_some_and(|last| end - last.x > ANGLE_TOLERANCE_DEG));
    closed.extend(end.zip(samples.first()).map(|(x, first)| PlotPoint { x, ..*first }));
    closed
}

/// Circle that is subtracted from a function before drawing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::report) struct RemovedCircle {
    /// Mean value, in the unit of the function.
    pub mean: f64,
    /// Amplitude of the first harmonic, in the unit of the function.
    pub eccentricity: f64,
    /// Angle of the largest value of the first harmonic, 0° to 360°.
    pub direction_deg: f64,
}

/// The least-squares circle of a polar figure in which the eccentricity would hide the form. The first harmonic of an
/// axial or angular error motion is a motion and is kept.
pub(super) fn eccentricity_to_remove(function: &EstimatedFunction, samples: &[PlotPoint]) -> Option<RemovedCircle> {
    let is_motion = MotionCentre::from_symbol(&function.symbol) == Some(MotionCentre::Chart);
    let [mean, cosine, sine] = least_squares_circle(samples).filter(|_| !is_motion)?;
    let removed = RemovedCircle {
        mean,
        eccentricity: cosine.hypot(sine),
        direction_deg: sine.atan2(cosine).to_degrees().rem_euclid(TURN_DEG),
    };
    let (low, high) = value_bounds(samples.iter().map(|sample| sample.y - removed.value_at(sample.x)))?;
    (removed.eccentricity > MIN_RATIO_OF_REMOVED_ECCENTRICITY * (high - low)).then_some(removed)
}

impl RemovedCircle {
    /// Value that is subtracted at this angle: mean plus first harmonic.
    pub(super) fn value_at(&self, degrees: f64) -> f64 {
        self.mean + self.eccentricity * (degrees - self.direction_deg).to_radians().cos()
    }
}

#[cfg(test)]
mod tests {
    use estimation::circle::fit_circle;

    use super::super::tests::{attribute_values, sine_function};
    use super::super::{FunctionFigure, draw_function};
    use super::*;

    fn function_at(symbol: &str, degrees: &[f64], value: impl Fn(f64) -> f64) -> EstimatedFunction {
        let y = degrees.iter().map(|degrees| value(degrees.to_radians())).collect();
        let u = vec![0.0; degrees.len()];
        EstimatedFunction {
            symbol: symbol.to_owned(),
            x: degrees.to_vec(),
            y,
            u,
            ..sine_function(FunctionFigureKind::Curve, 1)
        }
    }

    fn steps(from: i32, to: i32, step: usize) -> Vec<f64> {
        (from..=to).step_by(step).map(f64::from).collect()
    }

    #[test]
    fn error_motion_over_a_full_turn_is_polar() {
        let unequal = [0.0, 40.0, 95.0, 130.0, 180.0, 222.0, 270.0, 310.0];
        let kind =
            |symbol: &str, degrees: &[f64]| FunctionFigure::new(&function_at(symbol, degrees, f64::sin), 2.0).kind;
        let full = [steps(0, 315, 45), steps(0, 360, 5), steps(-180, 150, 30), steps(0, 715, 5), unequal.to_vec()];
        for degrees in full {
            for symbol in ["EXC", "EZC", "EAB", "E_radial_XY"] {
                assert_eq!(kind(symbol, &degrees), FunctionFigureKind::Polar, "{symbol} {degrees:?}");
            }
            assert_eq!(kind("EXC_total", &degrees), FunctionFigureKind::Curve);
        }
        // A tilting axis, a part of a turn, few angles, and two turns over the same angles.
        let twice = [steps(0, 315, 45), steps(0, 315, 45)].concat();
        for degrees in [steps(-90, 90, 30), steps(0, 270, 45), vec![0.0, 120.0, 240.0], twice] {
            assert_eq!(kind("EXC", &degrees), FunctionFigureKind::Curve, "{degrees:?}");
            let polar = EstimatedFunction { figure: FunctionFigureKind::Polar, ..function_at("W", &degrees, f64::sin) };
            assert_eq!(FunctionFigure::new(&polar, 2.0).kind, FunctionFigureKind::Curve);
        }
        let in_mm =
            EstimatedFunction { argument_unit: "mm".to_owned(), ..function_at("EXC", &steps(0, 315, 45), f64::sin) };
        assert_eq!(FunctionFigure::new(&in_mm, 2.0).kind, FunctionFigureKind::Curve);
    }

    /// The last point is at 360° with the value of 0°, in a curve and in a polar figure; a tilting axis stays open.
    #[test]
    fn full_turn_is_closed() {
        let line = |symbol: &str, degrees: &[f64]| -> Vec<(f64, f64)> {
            let svg = draw_function(&function_at(symbol, degrees, |turn| 3.0 * (2.0 * turn).cos() + turn.sin()), 2.0)
                .unwrap();
            let line =
                svg.lines().find(|line| line.contains("#1F6FB2") && line.contains("stroke-width=\"4\"")).unwrap();
            let pair =
                |pair: &str| pair.split_once(',').map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap())).unwrap();
            attribute_values(line, "points")[0].split_whitespace().map(pair).collect()
        };
        for degrees in [steps(0, 315, 45), steps(0, 360, 45)] {
            let closed = line("EXC_total", &degrees);
            assert_eq!(closed.len(), 9);
            assert_eq!(closed[8].1, closed[0].1);
            assert!((closed[8].0 - closed[0].0 - 8.0 * (closed[1].0 - closed[0].0)).abs() <= 4.0, "{closed:?}");
            let polar = line("EXC", &degrees);
            assert_eq!(polar.first(), polar.last());
        }
        let open = line("EXC_total", &steps(-90, 90, 30));
        assert_eq!(open.len(), 7);
    }

    /// A circle of 1 m about (60, −80) µm with lobes of ±2 µm, at unequal angles. The geometric fit of a circle to the
    /// points themselves gives the same centre as the fit of a harmonic to the radii.
    #[test]
    fn removed_eccentricity_is_the_centre_of_the_circle() {
        const RADIUS_UM: f64 = 1e6;
        let degrees = [0.0, 30.0, 75.0, 110.0, 140.0, 185.0, 230.0, 250.0, 290.0, 335.0];
        let deviation = |turn: f64| 60.0 * turn.cos() - 80.0 * turn.sin() + 2.0 * (3.0 * turn).cos() - 850.0;
        let function =
            EstimatedFunction { figure: FunctionFigureKind::Polar, ..function_at("W_radial", &degrees, deviation) };
        let points: Vec<[f64; 2]> = degrees
            .iter()
            .map(|degrees: &f64| {
                let (turn, radius) = (degrees.to_radians(), RADIUS_UM + deviation(degrees.to_radians()));
                [radius * turn.cos(), radius * turn.sin()]
            })
            .collect();
        let fitted = fit_circle(&points).unwrap();
        let [x, y] = fitted.centre;
        let figure = FunctionFigure::new(&function, 2.0);
        let removed = figure.removed_circle.unwrap();
        assert!((removed.eccentricity - x.hypot(y)).abs() < 0.02, "{removed:?} {fitted:?}");
        assert!(
            (removed.direction_deg - y.atan2(x).to_degrees().rem_euclid(360.0)).abs() < 0.02,
            "{removed:?} {fitted:?}"
        );
        assert!((removed.mean - (fitted.radius - RADIUS_UM)).abs() < 0.02, "{removed:?} {fitted:?}");
        // The rest is the distance of the points from that circle: the lobes, as far as the angles separate them.
        for (sample, [px, py]) in figure.samples.iter().zip(points) {
            let distance = (px - x).hypot(py - y) - fitted.radius;
            assert!((sample.y - distance).abs() < 0.02, "{} {distance}", sample.y);
            assert!(sample.y.abs() < 4.0);
        }
    }

    #[test]
    fn motion_and_small_eccentricity_are_kept() {
        let removed = |symbol: &str, eccentricity: f64| {
            let value = |turn: f64| eccentricity * turn.cos() + (2.0 * turn).cos();
            let figure = FunctionFigureKind::Polar;
            let function = EstimatedFunction { figure, ..function_at(symbol, &steps(0, 350, 10), value) };
            FunctionFigure::new(&function, 2.0).removed_circle.is_some()
        };
        // The rest has the range 2: above twice this amplitude it would be hidden.
        assert_eq!([3.9, 4.1].map(|amplitude| removed("W_radial", amplitude)), [false, true]);
        assert_eq!([3.9, 4.1].map(|amplitude| removed("EXC", amplitude)), [false, true]);
        // Axial and angular positioning error motion: the first harmonic is a motion.
        assert_eq!(["EZC", "ECC"].map(|symbol| removed(symbol, 100.0)), [false, false]);
    }
}
