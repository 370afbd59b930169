//! The unknowns of the equations, their order, and the gauge.

use faer::Mat;
use nalgebra::Vector3;

use super::angle_basis::AngleBasis;
use machine::Axis;

/// The six error motions in their order: X, Y, Z in mm; A, B, C in rad.
pub const MOTION_COMPONENTS: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

/// A direction at a ball as a function of its outward radial direction.
pub type DirectionAtBall = fn(&Vector3<f64>) -> Vector3<f64>;

/// A stop of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableStop {
    /// Commanded angle, not wrapped, rad.
    pub angle: f64,
    /// +1 if the command rises towards the stop, −1 if it falls.
    pub approach_sign: f64,
}

/// The unknowns and their order: error motions (component by component, function by function), reversal (one
/// per component), drift (order by order, X, Y, Z), steps at interruptions (X, Y, Z each), measuring
/// positions (X, Y, Z each), balls (X, Y, Z each).
#[derive(Debug, Clone)]
pub struct UnknownsLayout {
    pub angle_basis: AngleBasis,
    /// Whether the difference between rising and falling approach is an unknown of each error motion.
    pub has_reversal: bool,
    /// Order of the drift polynomial in relative time; 0: no drift unknowns.
    pub drift_order: usize,
    /// Number of fitted steps at interruptions, after which the table may be displaced: interruptions with
    /// measurements before and after them; 0 with a value for each stop.
    pub interruption_count: usize,
    /// Number of measuring positions.
    pub measuring_position_count: usize,
    /// Outward radial direction of each ball, table frame.
    pub radial_directions: Vec<Vector3<f64>>,
    /// Sense of rotation of the table about +Z for a rising command: +1 right-handed, −1 as in ISO 841.
    pub turn_sign: f64,
}

impl UnknownsLayout {
    /// Index of the coefficient of a basis function. `component`: index in [`MOTION_COMPONENTS`].
    pub fn motion_unknown_index(&self, component: usize, function: usize) -> usize {
        component * self.angle_basis.function_count() + function
    }

    /// Index of the value of an error motion at rising minus that at falling commands. Only valid if `has_reversal`.
    pub fn reversal_unknown_index(&self, component: usize) -> usize {
        MOTION_COMPONENTS.len() * self.angle_basis.function_count() + component
    }

    fn first_drift_unknown_index(&self) -> usize {
        let reversal = if self.has_reversal { MOTION_COMPONENTS.len() } else { 0 };
        MOTION_COMPONENTS.len() * self.angle_basis.function_count() + reversal
    }

    /// Index of the unknown for a drift coefficient; `order` starts at 1.
    pub fn drift_unknown_index(&self, order: usize, linear_axis: usize) -> usize {
        self.first_drift_unknown_index() + 3 * (order - 1) + linear_axis
    }

    /// Index of the unknown for the table's step at an interruption; interruptions are counted from 0.
    pub fn interruption_step_unknown_index(&self, interruption: usize, linear_axis: usize) -> usize {
        self.first_drift_unknown_index() + 3 * (self.drift_order + interruption) + linear_axis
    }

    pub fn measuring_position_unknown_index(&self, measuring_position: usize, linear_axis: usize) -> usize {
        self.interruption_step_unknown_index(self.interruption_count + measuring_position, linear_axis)
    }

    pub fn ball_unknown_index(&self, ball: usize, linear_axis: usize) -> usize {
        self.measuring_position_unknown_index(self.measuring_position_count, 0) + 3 * ball + linear_axis
    }

    pub fn unknown_count(&self) -> usize {
        self.ball_unknown_index(self.radial_directions.len(), 0)
    }

    /// Names of all unknowns. `rotary_axis`: the measured axis.
    pub fn unknown_names(&self, rotary_axis: Axis) -> Vec<String> {
        let function_suffixes = self.angle_basis.function_suffixes();
        let motions = MOTION_COMPONENTS.iter().flat_map(|component| {
            function_suffixes.iter().map(move |suffix| format!("E{component}{rotary_axis}_{suffix}"))
        });
        let mut names: Vec<String> = motions.collect();
        if self.has_reversal {
            names.extend(MOTION_COMPONENTS.map(|component| format!("E{component}{rotary_axis}_reversal")));
        }
        let along = |name: String| Axis::LINEAR.map(|axis| format!("{name} {axis}"));
        names.extend((1..=self.drift_order).flat_map(|order| along(format!("drift {order}"))));
        names.extend((1..=self.interruption_count).flat_map(|gap| along(format!("step {gap}"))));
        names.extend((1..=self.measuring_position_count).flat_map(|number| along(format!("position {number}"))));
        names.extend((1..=self.radial_directions.len()).flat_map(|ball| along(format!("ball {ball}"))));
        names
    }

    /// The gauge as rows C·x = 0 (METHODS section 5: thirteen rigid and scale combinations):
    /// - with a value for each stop, the mean of each error motion (a Fourier basis has no constant);
    /// - the co-rotating first order of (X, Y) and of (A, B): eccentricity and tilt of the plate;
    /// - the mean height, rotation and radius of the plate, which the measuring positions absorb.
    pub fn gauge_rows(&self, stops: &[TableStop]) -> Mat<f64> {
        let mut rows = Vec::new();
        if matches!(self.angle_basis, AngleBasis::ValuePerStop(_)) {
            rows.extend((0..MOTION_COMPONENTS.len()).map(|k| self.weighted_motion_sum_row(stops, k, |_| 1.0)));
        }
        let turn = self.turn_sign;
        for [x, y] in [[0, 1], [3, 4]] {
            let cos = |component| self.weighted_motion_sum_row(stops, component, f64::cos);
            let sin = |component| self.weighted_motion_sum_row(stops, component, f64::sin);
            rows.push(add_scaled_row(&cos(x), &sin(y), turn));
            rows.push(add_scaled_row(&cos(y), &sin(x), -turn));
        }
        let directions: [DirectionAtBall; 3] =
            [|_| Vector3::z(), |radial| Vector3::z().cross(radial), |radial| *radial];
        rows.extend(directions.map(|direction| self.ball_gauge_row(direction)));
        Mat::from_fn(rows.len(), self.unknown_count(), |i, j| rows[i][j])
    }

    /// Coefficients of the unknowns in Σ of an error motion times a weight of the angle, over the stops.
    fn weighted_motion_sum_row(&self, stops: &[TableStop], component: usize, weight: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut row = vec![0.0; self.unknown_count()];
        for (i, stop) in stops.iter().enumerate() {
            let values = self.angle_basis.function_values(stop.angle, i);
            for (function, value) in values.iter().enumerate() {
                row[self.motion_unknown_index(component, function)] += weight(stop.angle) * value;
            }
        }
        row
    }

    /// Coefficients of the unknowns in the sum over the balls of their displacements along `direction`.
    fn ball_gauge_row(&self, direction: DirectionAtBall) -> Vec<f64> {
        let mut row = vec![0.0; self.unknown_count()];
        for (ball, radial) in self.radial_directions.iter().enumerate() {
            let along = direction(radial);
            (0..3).for_each(|axis| row[self.ball_unknown_index(ball, axis)] = along[axis]);
        }
        row
    }
}

fn add_scaled_row(one: &[f64], other: &[f64], factor: f64) -> Vec<f64> {
    one.iter().zip(other).map(|(one, other)| one + factor * other).collect()
}
