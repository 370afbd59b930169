//! Weighted least squares with most unknowns in small blocks that are coupled only through a few common unknowns,
//! for example many points in space measured by one machine. Each block is eliminated on its own, and the remainder
//! of its rows determines the common unknowns. This is the Schur complement computed on the rows (orthogonal, by
//! modified Gram–Schmidt) and not on the normal equations, so the condition is not squared. The right-hand side is
//! processed as one more column, which makes the solution as accurate as with Householder reflections (Björck, BIT
//! 7, 1967, 1–21).
//!
//! Order of the unknowns: the common ones, then block after block. Order of the rows: block after block. A dense
//! problem is one block without own unknowns.

use faer::Mat;

use super::gram_schmidt::ColumnMatrix;
use super::linear_least_squares::{LinearError, RANK_THRESHOLD, RankAnalysis, analyse_rank};

/// Rows of one block, with the block's own unknowns and the common unknowns of all blocks. Each row is divided by its
/// standard uncertainty.
#[derive(Debug, Clone)]
pub struct BlockRows {
    own_unknown_count: usize,
    /// Columns: own unknowns, common unknowns, right-hand side.
    columns: ColumnMatrix,
}

impl BlockRows {
    /// Creates `row_count` rows of zeros for `own_count` unknowns of the block and `common_count` common unknowns.
    pub fn zeros(row_count: usize, own_count: usize, common_count: usize) -> Self {
        Self { own_unknown_count: own_count, columns: ColumnMatrix::zeros(row_count, own_count + common_count + 1) }
    }

    pub fn set_own_coefficient(&mut self, row: usize, unknown: usize, value: f64) {
        self.columns.set(row, unknown, value);
    }

    pub fn set_common_coefficient(&mut self, row: usize, unknown: usize, value: f64) {
        self.columns.set(row, self.own_unknown_count + unknown, value);
    }

    /// Sets the right-hand side of a row: measured, or measured less model.
    pub fn set_right_side(&mut self, row: usize, value: f64) {
        self.columns.set(row, self.columns.column_count() - 1, value);
    }
}

/// Adds one damping row for each unknown, weight·unknown = 0 (Levenberg 1944). `weights`: common unknowns first, then
/// block after block. The damping rows of a block's own unknowns follow its rows; those of the common unknowns are
/// one more block at the end.
pub(super) fn add_damping_rows(mut blocks: Vec<BlockRows>, weights: &[f64]) -> Vec<BlockRows> {
    let common = weights.len() - blocks.iter().map(|rows| rows.own_unknown_count).sum::<usize>();
    let (of_common, mut weights) = weights.split_at(common);
    for rows in &mut blocks {
        let (own_part, after) = weights.split_at(rows.own_unknown_count);
        let first = rows.columns.row_count();
        rows.columns.append_zero_rows(rows.own_unknown_count);
        own_part.iter().enumerate().for_each(|(j, weight)| rows.set_own_coefficient(first + j, j, *weight));
        weights = after;
    }
    let mut last = BlockRows::zeros(common, 0, common);
    of_common.iter().enumerate().for_each(|(j, weight)| last.set_common_coefficient(j, j, *weight));
    blocks.push(last);
    blocks
}

/// Factorisation A = Q·R in blocks of rows with own and common unknowns, from which solution, covariance and rank are
/// computed.
#[derive(Debug, Clone)]
pub struct BlockFactorisation {
    blocks: Vec<FactorBlock>,
    /// Orthonormal columns of the common unknowns over all rows, orthogonal to the blocks.
    common_columns: ColumnMatrix,
    /// R of the common unknowns: common × common, upper triangle.
    common_triangle: Mat<f64>,
    is_rank_deficient: bool,
}

/// Factorisation of the rows that share own unknowns.
#[derive(Debug, Clone)]
struct FactorBlock {
    /// Orthonormal columns of the own unknowns over the rows of this block.
    orthonormal_columns: ColumnMatrix,
    /// R of the own unknowns: own × own, upper triangle.
    own_triangle: Mat<f64>,
    /// Part of R that couples own and common unknowns: own × common.
    coupling: Mat<f64>,
}

/// Factorises the rows of all blocks. Returns the factorisation and the coordinates of the right-hand side along the
/// orthonormal columns, those of the common unknowns first. All blocks have the same common unknowns.
pub fn factorise_and_project_right_side(blocks: Vec<BlockRows>) -> (BlockFactorisation, Vec<f64>) {
    let common = blocks.first().map_or(0, |rows| rows.columns.column_count() - rows.own_unknown_count - 1);
    let total = blocks.iter().map(|rows| rows.columns.row_count()).sum();
    let mut rest = ColumnMatrix::zeros(total, common + 1);
    let (mut factored, mut coordinates) = (Vec::with_capacity(blocks.len()), Vec::new());
    let (mut is_rank_deficient, mut first) = (false, 0);
    for BlockRows { own_unknown_count: own_count, mut columns } in blocks {
        let (r, is_dependent) = columns.orthonormalise_leading_columns(own_count);
        is_rank_deficient |= is_dependent;
        for j in 0..=common {
            rest.column_mut(j)[first..][..columns.row_count()].copy_from_slice(columns.column(own_count + j));
        }
        first += columns.row_count();
        coordinates.extend((0..own_count).map(|i| r[(i, own_count + common)]));
        columns.truncate_columns(own_count);
        factored.push(FactorBlock {
            orthonormal_columns: columns,
            own_triangle: r.get(.., ..own_count).to_owned(),
            coupling: r.get(.., own_count..own_count + common).to_owned(),
        });
    }
    let (r, is_dependent) = rest.orthonormalise_leading_columns(common);
    let of_common: Vec<f64> = (0..common).map(|i| r[(i, common)]).collect();
    coordinates.splice(0..0, of_common);
    rest.truncate_columns(common);
    let common_triangle = r.get(.., ..common).to_owned();
    is_rank_deficient |= is_dependent;
    (BlockFactorisation { blocks: factored, common_columns: rest, common_triangle, is_rank_deficient }, coordinates)
}

impl BlockFactorisation {
    pub fn unknown_count(&self) -> usize {
        self.common_columns.column_count()
            + self.blocks.iter().map(|block| block.orthonormal_columns.column_count()).sum::<usize>()
    }

    /// Computes the least-squares solution for the values `y` of all rows, divided by their standard uncertainties as
    /// the rows are. The common unknowns come first; an unknown whose pivot in R is 0 is set to 0.
    pub fn solve(&self, y: &[f64]) -> Vec<f64> {
        self.unknowns_from_coordinates(&self.subtract_projections(&mut y.to_vec()))
    }

    /// Computes the least-squares solution of damped rows (see [`add_damping_rows`]). `y` holds the values without the
    /// damping rows.
    pub(super) fn solve_damped(&self, y: &[f64]) -> Vec<f64> {
        let (mut extended, mut rest) = (Vec::new(), y);
        for block in &self.blocks {
            let more = block.orthonormal_columns.column_count();
            let (own_part, after) = rest.split_at(rest.len().min(block.orthonormal_columns.row_count() - more));
            extended.extend_from_slice(own_part);
            extended.resize(extended.len() + more, 0.0);
            rest = after;
        }
        extended.resize(self.common_columns.row_count(), 0.0);
        self.solve(&extended)
    }

    /// Part of `y` (values as for [`solve`](Self::solve)) that the unknowns do not explain: (I − H)·y.
    pub fn residuals(&self, y: &[f64]) -> Vec<f64> {
        let mut rest = y.to_vec();
        self.subtract_projections(&mut rest);
        rest
    }

    /// Computes [`solve`](Self::solve) and [`residuals`](Self::residuals) for the values `y` of all rows in one
    /// pass over the rows.
    pub fn solution_and_residuals(&self, mut y: Vec<f64>) -> (Vec<f64>, Vec<f64>) {
        let coordinates = self.subtract_projections(&mut y);
        (self.unknowns_from_coordinates(&coordinates), y)
    }

    /// Computes Qᵀ·y, the common unknowns first, and replaces `y` by its remainder.
    pub(super) fn subtract_projections(&self, y: &mut [f64]) -> Vec<f64> {
        let mut own = Vec::with_capacity(self.unknown_count());
        let mut rest = &mut *y;
        for block in &self.blocks {
            let (rows, after) = rest.split_at_mut(block.orthonormal_columns.row_count());
            own.extend(block.orthonormal_columns.subtract_projections(rows));
            rest = after;
        }
        let mut all = self.common_columns.subtract_projections(y);
        all.extend(own);
        all
    }

    /// Computes R⁻¹·coordinates.
    pub(super) fn unknowns_from_coordinates(&self, coordinates: &[f64]) -> Vec<f64> {
        let (common, mut own) = coordinates.split_at(self.common_columns.column_count());
        let mut x = back_substitute(&self.common_triangle, common.to_vec());
        let count = x.len();
        for block in &self.blocks {
            let (own_part, after) = own.split_at(block.own_triangle.nrows());
            let reduced = own_part
                .iter()
                .enumerate()
                .map(|(i, z)| z - (0..count).map(|j| block.coupling[(i, j)] * x[j]).sum::<f64>());
            let solved = back_substitute(&block.own_triangle, reduced.collect());
            x.extend(solved);
            own = after;
        }
        x
    }

    /// R as a square matrix. It has the same rank, singular values and null space as the matrix of all rows.
    fn r_factor(&self) -> Mat<f64> {
        let (common, all) = (self.common_columns.column_count(), self.unknown_count());
        let mut square = Mat::zeros(all, all);
        square.get_mut(..common, ..common).copy_from(&self.common_triangle);
        let mut first = common;
        for FactorBlock { own_triangle: triangle, coupling, .. } in &self.blocks {
            let last = first + triangle.nrows();
            square.get_mut(first..last, first..last).copy_from(triangle);
            square.get_mut(first..last, ..common).copy_from(coupling);
            first = last;
        }
        square
    }

    /// Analyses which unknowns the rows determine.
    ///
    /// # Errors
    /// A row is not finite.
    pub fn analyse_rank(&self) -> Result<RankAnalysis, LinearError> {
        analyse_rank(self.r_factor().as_ref(), None, RANK_THRESHOLD)
    }

    /// Covariance of the unknowns (unknowns × unknowns), for rows of unit variance.
    pub fn covariance(&self) -> Mat<f64> {
        let all = self.unknown_count();
        let mut root = Mat::zeros(all, all);
        for j in 0..all {
            let mut unit = vec![0.0; all];
            unit[j] = 1.0;
            let column = self.unknowns_from_coordinates(&unit);
            column.into_iter().enumerate().for_each(|(i, value)| root[(i, j)] = value);
        }
        &root * root.transpose()
    }

    /// Norm of the column of each unknown over all rows. The product of a norm and the standard uncertainty of its
    /// unknown does not depend on the unit.
    pub fn column_norms(&self) -> Vec<f64> {
        let square = self.r_factor();
        (0..square.ncols()).map(|j| square.col(j).norm_l2()).collect()
    }

    /// Leverage of each row: the diagonal of the hat matrix H.
    pub fn leverage(&self) -> Vec<f64> {
        let mut leverage = self.common_columns.row_square_sums();
        let own = self.blocks.iter().flat_map(|block| block.orthonormal_columns.row_square_sums());
        leverage.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
        leverage
    }

    /// Returns the factorisation unchanged.
    ///
    /// # Errors
    /// The rows do not determine the unknowns.
    pub(super) fn require_full_rank(self) -> Result<Self, LinearError> {
        if self.is_rank_deficient {
            return Err(LinearError::RankDeficient(Box::new(self.analyse_rank()?)));
        }
        Ok(self)
    }

    pub(super) fn is_full_rank(&self) -> bool {
        !self.is_rank_deficient
    }
}

/// Solves R·x = z in place of z. An undetermined unknown is set to 0.
fn back_substitute(triangle: &Mat<f64>, mut z: Vec<f64>) -> Vec<f64> {
    for i in (0..z.len()).rev() {
        let known: f64 = (i + 1..z.len()).map(|j| triangle[(i, j)] * z[j]).sum();
        let pivot = triangle[(i, i)];
        z[i] = if pivot == 0.0 { 0.0 } else { (z[i] - known) / pivot };
    }
    z
}

#[cfg(test)]
mod tests;
