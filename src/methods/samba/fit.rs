//! All measurements as one least-squares problem. Machine and stylus are common to all rows; the balls are
//! its blocks. Balls with a certified length between them share a block.

mod geometry_equations;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::geometry_model::{AffineFunctionOfXyz, GeometryModel, IndexationModel};
use estimation::nonlinear_least_squares::{NonlinearError, NonlinearSolution, minimise_squares};
use estimation::schur::BlockRows;
use machine::Position;
use machine::frame::unit_vector;

pub use geometry_equations::GeometryEquations;

/// Which ball is measured at which rotary position, and with which weight; without the measured centre.
#[derive(Debug, Clone, Copy)]
pub struct PlannedBallMeasurement {
    /// Index of the rotary position.
    pub rotary_position_index: usize,
    pub ball_index: usize,
    /// Whitening matrix W with W·Σ·Wᵀ = I, where Σ is the covariance of the measured centre, machine frame,
    /// mm².
    pub whitening: Matrix3<f64>,
}

/// A certified length between two balls.
#[derive(Debug, Clone, Copy)]
pub struct LengthConstraint {
    pub from_ball: usize,
    pub to_ball: usize,
    /// Standard uncertainty of the certified length.
    pub u_mm: f64,
}

/// Observed values, mm: the ball centres as axis positions, and the certified lengths.
#[derive(Debug, Clone)]
pub struct ObservedValues {
    /// X, Y and Z of the axes with the stylus ball at the centre of the measured ball, one for each measurement.
    pub centre_axes_mm: Vec<Vector3<f64>>,
    /// Certified lengths.
    pub lengths_mm: Vec<f64>,
}

/// All measurements as one least-squares problem. Unknowns: machine errors, free stylus coordinates, then the balls
/// in the order of the groups.
#[derive(Debug, Clone)]
pub struct GeometryProblem {
    model: GeometryModel,
    stated_stylus_mm: Vector3<f64>,
    rotary_positions: Vec<Position>,
    measurements: Vec<PlannedBallMeasurement>,
    certified_lengths: Vec<LengthConstraint>,
    groups: Vec<BallGroup>,
    /// Index of the first coordinate of each ball among the unknowns.
    ball_unknowns: Vec<usize>,
    /// Matrix of each measurement from the table frame to weighted residuals, for the machine without errors.
    whitening_matrices_from_table: Vec<Matrix3<f64>>,
    /// Index of the first row of each measurement, then of each length.
    first_rows: Vec<usize>,
}

/// Balls that share a block, with their measurements and lengths.
#[derive(Debug, Clone, Default)]
struct BallGroup {
    ball_indices: Vec<usize>,
    measurement_indices: Vec<usize>,
    length_indices: Vec<usize>,
}

impl GeometryProblem {
    /// Each of the `ball_count` balls must have a measurement. `stylus` is the stated one; coordinates that are not
    /// free keep their value.
    pub fn new(
        model: GeometryModel,
        positions: Vec<Position>,
        measurements: Vec<PlannedBallMeasurement>,
        certified_lengths: Vec<LengthConstraint>,
        ball_count: usize,
        stylus: Vector3<f64>,
    ) -> Self {
        let groups = group_balls(&measurements, &certified_lengths, ball_count);
        let (mut ball_unknowns, mut next) = (vec![0; ball_count], model.shared_unknown_count());
        for ball in groups.iter().flat_map(|group| &group.ball_indices) {
            ball_unknowns[*ball] = next;
            next += 3;
        }
        let (mut first_rows, mut row) = (vec![0; measurements.len() + certified_lengths.len()], 0);
        for group in &groups {
            for measurement in &group.measurement_indices {
                first_rows[*measurement] = row;
                row += 3;
            }
            for bar in &group.length_indices {
                first_rows[measurements.len() + bar] = row;
                row += 1;
            }
        }
        let zero = vec![0.0; model.parameters().len()];
        let inverse = |at: &Position| model.tip_function(at, &zero, Vector3::zeros()).inverse_linear_part();
        let machine_from_table: Vec<Matrix3<f64>> = positions.iter().map(inverse).collect();
        let weights = measurements.iter().map(|s| s.whitening * machine_from_table[s.rotary_position_index]).collect();
        Self {
            model,
            stated_stylus_mm: stylus,
            rotary_positions: positions,
            measurements,
            certified_lengths,
            groups,
            ball_unknowns,
            whitening_matrices_from_table: weights,
            first_rows,
        }
    }

    pub fn model(&self) -> &GeometryModel {
        &self.model
    }

    /// The same measurements with other unknown machine errors.
    #[cfg(test)]
    pub fn with_model(self, model: GeometryModel) -> Self {
        Self::new(
            model,
            self.rotary_positions,
            self.measurements,
            self.certified_lengths,
            self.ball_unknowns.len(),
            self.stated_stylus_mm,
        )
    }

    pub fn unknown_count(&self) -> usize {
        self.model.shared_unknown_count() + 3 * self.ball_unknowns.len()
    }

    pub fn row_count(&self) -> usize {
        3 * self.measurements.len() + self.certified_lengths.len()
    }

    /// Index of the ball's first coordinate among the unknowns: machine, tool, balls.
    pub fn ball_unknown_index(&self, ball: usize) -> usize {
        self.ball_unknowns[ball]
    }

    /// Index of the first of the three rows of a measurement.
    pub fn first_row_of_measurement(&self, measurement: usize) -> usize {
        self.first_rows[measurement]
    }

    pub fn row_of_length(&self, bar: usize) -> usize {
        self.first_rows[self.measurements.len() + bar]
    }

    /// Matrix from the table frame to the weighted residuals of a measurement.
    pub fn whitening_matrix_from_table(&self, measurement: usize) -> Matrix3<f64> {
        self.whitening_matrices_from_table[measurement]
    }

    /// Errors and stylus from the unknowns `x`; coordinates of the stylus that are not free have their stated value.
    fn errors_and_stylus<'x>(&self, x: &'x [f64]) -> (&'x [f64], Vector3<f64>) {
        let (errors, rest) = x.split_at(self.model.parameters().len());
        let mut stylus = self.stated_stylus_mm;
        for (k, value) in self.model.free_stylus_coordinates().iter().zip(rest) {
            stylus[*k] = *value;
        }
        (errors, stylus)
    }

    /// Start values: zero errors, the stated stylus, and the balls at their mean positions from the nominal
    /// machine.
    pub fn initial_values(&self, measured: &ObservedValues) -> Vec<f64> {
        let mut x = vec![0.0; self.unknown_count()];
        let first = self.model.parameters().len();
        for (i, k) in self.model.free_stylus_coordinates().iter().enumerate() {
            x[first + i] = self.stated_stylus_mm[*k];
        }
        let mut counts = vec![0.0; self.ball_unknowns.len()];
        for (measurement, tip) in self.measurements.iter().zip(self.centres_from_measured_axes(&x, measured)) {
            counts[measurement.ball_index] += 1.0;
            let first = self.ball_unknowns[measurement.ball_index];
            let mean = vector_at(&x, first) + (tip - vector_at(&x, first)) / counts[measurement.ball_index];
            set_vector(&mut x, first, mean);
        }
        x
    }

    /// The unknowns that minimise the weighted sum of squares.
    ///
    /// # Errors
    /// The measurements do not separate the unknowns; the iteration does not converge.
    pub fn solve(&self, measured: &ObservedValues, start: Vec<f64>) -> Result<NonlinearSolution, NonlinearError> {
        minimise_squares(start, |x| self.row_blocks(x, measured), |x| self.weighted_residuals(x, measured))
    }

    /// For each measurement, the ball centre on the table to which the measured axis positions lead if the machine
    /// has the errors in `x`; table frame, mm.
    pub fn centres_from_measured_axes(&self, x: &[f64], measured: &ObservedValues) -> Vec<Vector3<f64>> {
        let tip_functions = self.tip_functions(x);
        let value = |(of, xyz): (&PlannedBallMeasurement, &Vector3<f64>)| {
            tip_functions[of.rotary_position_index].value_at(*xyz)
        };
        self.measurements.iter().zip(&measured.centre_axes_mm).map(value).collect()
    }

    /// At each rotary position, the tip in the table frame as a function of X, Y and Z.
    fn tip_functions(&self, x: &[f64]) -> Vec<AffineFunctionOfXyz> {
        let (errors, tool) = self.errors_and_stylus(x);
        self.rotary_positions.iter().map(|position| self.model.tip_function(position, errors, tool)).collect()
    }

    /// For each rotary position, the matrix from a motion of X, Y, Z to the motion of the stylus relative to
    /// the workpiece if the machine has the errors in `x`, in the directions of the nominal axes.
    pub fn commanded_to_actual_motion_matrices(&self, x: &[f64]) -> Vec<Matrix3<f64>> {
        let (errors, tool) = self.errors_and_stylus(x);
        let zero = vec![0.0; errors.len()];
        let inverse = |at: &Position| self.model.tip_function(at, &zero, tool).inverse_linear_part();
        let nominal = self.rotary_positions.iter().map(inverse);
        nominal.zip(self.tip_functions(x)).map(|(nominal, tip)| nominal * tip.linear_part).collect()
    }

    /// Weighted residuals in the order of the rows. Of a measurement: fitted ball centre minus the centre from the
    /// measured axes; of a length: certified minus fitted.
    pub fn weighted_residuals(&self, x: &[f64], measured: &ObservedValues) -> Vec<f64> {
        let mut residuals = vec![0.0; self.row_count()];
        for (i, tip) in self.centres_from_measured_axes(x, measured).into_iter().enumerate() {
            let ball = vector_at(x, self.ball_unknowns[self.measurements[i].ball_index]);
            set_vector(&mut residuals, self.first_rows[i], self.whitening_matrices_from_table[i] * (ball - tip));
        }
        for (i, bar) in self.certified_lengths.iter().enumerate() {
            let vector = self.length_vector(x, bar).norm();
            residuals[self.row_of_length(i)] = (measured.lengths_mm[i] - vector) / bar.u_mm;
        }
        residuals
    }

    fn length_vector(&self, x: &[f64], bar: &LengthConstraint) -> Vector3<f64> {
        vector_at(x, self.ball_unknowns[bar.to_ball]) - vector_at(x, self.ball_unknowns[bar.from_ball])
    }

    /// The model linearised at `x`, group by group.
    pub fn row_blocks(&self, x: &[f64], measured: &ObservedValues) -> Vec<BlockRows> {
        let (errors, tool) = self.errors_and_stylus(x);
        let linearise = |at: &Position| self.model.linearise_at_indexation(at, errors, tool);
        let models: Vec<IndexationModel> = self.rotary_positions.par_iter().map(linearise).collect();
        let group_rows = |group: &BallGroup| {
            let count = 3 * group.measurement_indices.len() + group.length_indices.len();
            let mut rows = BlockRows::zeros(count, 3 * group.ball_indices.len(), self.model.shared_unknown_count());
            let first = self.ball_unknowns[group.ball_indices[0]];
            for (n, i) in group.measurement_indices.iter().enumerate() {
                let indexed = &models[self.measurements[*i].rotary_position_index];
                self.fill_ball_rows(&mut rows, 3 * n, first, *i, indexed, x, measured.centre_axes_mm[*i]);
            }
            for (n, i) in group.length_indices.iter().enumerate() {
                let row = 3 * group.measurement_indices.len() + n;
                self.fill_length_row(&mut rows, row, first, &self.certified_lengths[*i], x, measured.lengths_mm[*i]);
            }
            rows
        };
        self.groups.iter().map(group_rows).collect()
    }

    /// Fills the three rows of `measurement`, starting at `row`; the unknowns of the block start at
    /// `first`.
    #[allow(clippy::too_many_arguments)]
    fn fill_ball_rows(
        &self,
        rows: &mut BlockRows,
        row: usize,
        first: usize,
        measurement: usize,
        indexed: &IndexationModel,
        x: &[f64],
        xyz: Vector3<f64>,
    ) {
        let weight = self.whitening_matrices_from_table[measurement];
        let ball_unknown = self.ball_unknowns[self.measurements[measurement].ball_index];
        let value = weight * (vector_at(x, ball_unknown) - indexed.tip.value_at(xyz));
        (0..3).for_each(|k| rows.set_right_side(row + k, value[k]));
        let mut set = |j: usize, column: Vector3<f64>| {
            let weighted = weight * column;
            (0..3).for_each(|k| rows.set_common_coefficient(row + k, j, weighted[k]));
        };
        let errors = &indexed.error_derivative_functions;
        errors.iter().enumerate().for_each(|(j, derivative)| set(j, derivative.value_at(xyz)));
        for (j, coordinate) in self.model.free_stylus_coordinates().iter().enumerate() {
            set(errors.len() + j, indexed.stylus_derivatives.column(*coordinate).into_owned());
        }
        for j in 0..3 {
            let column = -weight.column(j);
            (0..3).for_each(|k| rows.set_own_coefficient(row + k, ball_unknown - first + j, column[k]));
        }
    }

    fn fill_length_row(
        &self,
        rows: &mut BlockRows,
        row: usize,
        first: usize,
        bar: &LengthConstraint,
        x: &[f64],
        length: f64,
    ) {
        let vector = self.length_vector(x, bar);
        let along = unit_vector(vector).unwrap_or_default() / bar.u_mm;
        rows.set_right_side(row, (length - vector.norm()) / bar.u_mm);
        for j in 0..3 {
            rows.set_own_coefficient(row, self.ball_unknowns[bar.to_ball] - first + j, along[j]);
            rows.set_own_coefficient(row, self.ball_unknowns[bar.from_ball] - first + j, -along[j]);
        }
    }

    /// The measurements without noise for the unknowns `x`. Only rows that are linearised at these measurements show
    /// the true null space. With nonzero residuals, a uniform shrinking would reduce the residuals and appear
    /// determined.
    pub fn noise_free_observations(&self, x: &[f64]) -> ObservedValues {
        let tip_functions = self.tip_functions(x);
        let xyz = self.measurements.iter().map(|measurement| {
            let tip = &tip_functions[measurement.rotary_position_index];
            let ball = vector_at(x, self.ball_unknowns[measurement.ball_index]);
            tip.inverse_linear_part() * (ball - tip.value_at(Vector3::zeros()))
        });
        let lengths = self.certified_lengths.iter().map(|bar| self.length_vector(x, bar).norm());
        ObservedValues { centre_axes_mm: xyz.collect(), lengths_mm: lengths.collect() }
    }
}

/// Groups of balls joined by lengths, in the order of the first ball of each group.
fn group_balls(
    measurements: &[PlannedBallMeasurement],
    certified_lengths: &[LengthConstraint],
    ball_count: usize,
) -> Vec<BallGroup> {
    let mut group_of: Vec<usize> = (0..ball_count).collect();
    for bar in certified_lengths {
        let [from, to] = [bar.from_ball, bar.to_ball].map(|ball| group_of[ball]);
        let (kept, merged) = (from.min(to), from.max(to));
        group_of.iter_mut().filter(|group| **group == merged).for_each(|group| *group = kept);
    }
    let mut groups = vec![BallGroup::default(); ball_count];
    (0..ball_count).for_each(|ball| groups[group_of[ball]].ball_indices.push(ball));
    for (i, measurement) in measurements.iter().enumerate() {
        groups[group_of[measurement.ball_index]].measurement_indices.push(i);
    }
    for (i, bar) in certified_lengths.iter().enumerate() {
        groups[group_of[bar.from_ball]].length_indices.push(i);
    }
    groups.retain(|group| !group.ball_indices.is_empty());
    groups
}

pub fn vector_at(x: &[f64], at: usize) -> Vector3<f64> {
    Vector3::new(x[at], x[at + 1], x[at + 2])
}

fn set_vector(x: &mut [f64], at: usize, value: Vector3<f64>) {
    x[at..at + 3].copy_from_slice(value.as_slice());
}
