//! Orthonormalisation of matrix columns, one after the other (modified Gram–Schmidt).

use faer::Mat;
use pulp::{Arch, Simd, WithSimd};

use super::linear_least_squares::RANK_THRESHOLD;

/// Number of partial sums of a dot product. They are added in a fixed order: the result is the same with and without
/// vector registers.
const LANE_COUNT: usize = 8;

/// A matrix stored column by column.
#[derive(Debug, Clone)]
pub(super) struct ColumnMatrix {
    row_count: usize,
    column_count: usize,
    values: Vec<f64>,
}

impl ColumnMatrix {
    pub fn zeros(rows: usize, count: usize) -> Self {
        Self { row_count: rows, column_count: count, values: vec![0.0; rows * count] }
    }

    pub fn row_count(&self) -> usize {
        self.row_count
    }

    pub fn column_count(&self) -> usize {
        self.column_count
    }

    pub fn set(&mut self, row: usize, column: usize, value: f64) {
        self.values[column * self.row_count + row] = value;
    }

    pub fn column(&self, column: usize) -> &[f64] {
        &self.values[column * self.row_count..][..self.row_count]
    }

    pub fn column_mut(&mut self, column: usize) -> &mut [f64] {
        &mut self.values[column * self.row_count..][..self.row_count]
    }

    /// Appends `added_count` rows of zeros.
    pub fn append_zero_rows(&mut self, added_count: usize) {
        let mut larger = Self::zeros(self.row_count + added_count, self.column_count);
        for j in 0..self.column_count {
            larger.column_mut(j)[..self.row_count].copy_from_slice(self.column(j));
        }
        *self = larger;
    }

    pub fn truncate_columns(&mut self, count: usize) {
        self.values.truncate(count * self.row_count);
        self.column_count = count;
    }

    /// Makes the first `pivots` columns orthonormal and subtracts their components from all other columns. Returns R
    /// (pivots × columns), and whether one of the first `pivots` columns is a linear combination of those before it;
    /// such a column becomes zero.
    pub fn orthonormalise_leading_columns(&mut self, pivots: usize) -> (Mat<f64>, bool) {
        Arch::new().dispatch(OrthonormaliseColumns { columns: self, pivots })
    }

    /// Subtracts from `y` its components along the orthonormal columns, one after the other. Returns the
    /// components.
    pub fn subtract_projections(&self, y: &mut [f64]) -> Vec<f64> {
        Arch::new().dispatch(SubtractProjections { columns: self, y })
    }

    /// Sum of the squares of each row.
    pub fn row_square_sums(&self) -> Vec<f64> {
        let mut sums = vec![0.0; self.row_count];
        for column in (0..self.column_count).map(|j| self.column(j)) {
            sums.iter_mut().zip(column).for_each(|(sum, value)| *sum += value * value);
        }
        sums
    }
}

/// Vectorised body of [`ColumnMatrix::orthonormalise_leading_columns`].
struct OrthonormaliseColumns<'a> {
    columns: &'a mut ColumnMatrix,
    pivots: usize,
}

impl WithSimd for OrthonormaliseColumns<'_> {
    type Output = (Mat<f64>, bool);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { columns: ColumnMatrix { row_count: rows, column_count: count, values }, pivots } = self;
        let (rows, count) = (*rows, *count);
        let mut r = Mat::zeros(pivots, count);
        let mut is_rank_deficient = false;
        let whole: Vec<f64> =
            (0..pivots).map(|j| dot_product(&values[j * rows..][..rows], &values[j * rows..][..rows])).collect();
        for pivot in 0..pivots {
            let (done, others) = values.split_at_mut((pivot + 1) * rows);
            let column = &mut done[pivot * rows..];
            let length = dot_product(column, column).sqrt();
            let is_independent = length > RANK_THRESHOLD * whole[pivot].sqrt();
            is_rank_deficient |= !is_independent;
            r[(pivot, pivot)] = length;
            let scale = if is_independent { 1.0 / length } else { 0.0 };
            column.iter_mut().for_each(|value| *value *= scale);
            for other in 0..count - pivot - 1 {
                let other_column = &mut others[other * rows..][..rows];
                let share = dot_product(column, other_column);
                subtract_multiple(other_column, column, share);
                r[(pivot, pivot + 1 + other)] = share;
            }
        }
        (r, is_rank_deficient)
    }
}

/// Vectorised body of [`ColumnMatrix::subtract_projections`].
struct SubtractProjections<'a> {
    columns: &'a ColumnMatrix,
    y: &'a mut [f64],
}

impl WithSimd for SubtractProjections<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { columns, y } = self;
        let mut shares = Vec::with_capacity(columns.column_count);
        for j in 0..columns.column_count {
            let column = columns.column(j);
            let share = dot_product(column, y);
            subtract_multiple(y, column, share);
            shares.push(share);
        }
        shares
    }
}

#[inline(always)]
fn dot_product(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; LANE_COUNT];
    let (mut left, mut right) = (a.chunks_exact(LANE_COUNT), b.chunks_exact(LANE_COUNT));
    for (a, b) in (&mut left).zip(&mut right) {
        for ((lane, a), b) in lanes.iter_mut().zip(a).zip(b) {
            *lane += a * b;
        }
    }
    let rest: f64 = left.remainder().iter().zip(right.remainder()).map(|(a, b)| a * b).sum();
    lanes.iter().sum::<f64>() + rest
}

#[inline(always)]
fn subtract_multiple(y: &mut [f64], column: &[f64], factor: f64) {
    y.iter_mut().zip(column).for_each(|(y, value)| *y -= factor * value);
}
