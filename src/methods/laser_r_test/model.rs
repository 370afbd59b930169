//! The equations of one sphere on a rotary table (paper 2, Eqs. 1 to 4, 16), with the exact chain.
//!
//! On the paper's machine, a B table with C on it, its five parameters are errors "relative to the
//! previous axis", which is what a chain's errors are: α_BY = EA0B, β_BY = EB0B, γ_BY = EC0B,
//! δx_CB = EX0C and α_CB = EA0C. In the machine's own coordinates ISO 230-1 would call the last two
//! E_X0C − E_X0B and E_A0C − E_A0B. The paper's δx_BY, δy_BY, δz_BY are not told from where the sensor's
//! zero point sits in the spindle: they stand in it.

use nalgebra::{Matrix3, Vector3};

use estimation::linear::{LinearError, Survey};
use estimation::nonlinear::{Minimum, NonlinearError, minimise};
use estimation::schur::{Rows, factor};
use machine::kinematics::{Chain, ErrorParameter, ErrorTerm};
use machine::{Position, frame::Point};

/// Steps to a solution nearby: the second is of second order already.
const NEAR_STEPS: usize = 2;

/// Unknowns beside the machine's errors: where the zero point sits (spindle frame), then where the
/// sphere stands (table frame), both mm.
pub const PLACES: usize = 6;

/// The machine with its unknown errors.
#[derive(Debug, Clone)]
pub struct Model {
    pub chain: Chain,
    pub parameters: Vec<ErrorParameter>,
}

impl Model {
    pub fn unknowns(&self) -> usize {
        self.parameters.len() + PLACES
    }

    fn terms(&self, x: &[f64]) -> Vec<ErrorTerm> {
        let pairs = self.parameters.iter().zip(x);
        pairs.map(|(parameter, value)| ErrorTerm { parameter: *parameter, value: *value }).collect()
    }

    pub fn zero(&self, x: &[f64]) -> Vector3<f64> {
        let first = self.parameters.len();
        Vector3::from_column_slice(&x[first..first + 3])
    }

    pub fn ball(&self, x: &[f64]) -> Vector3<f64> {
        let first = self.parameters.len() + 3;
        Vector3::from_column_slice(&x[first..first + 3])
    }

    /// Where the zero point stands at the axis positions `at`, less where the sphere's centre is; table
    /// frame, mm.
    pub fn misclosure(&self, at: &Position, x: &[f64]) -> Vector3<f64> {
        let tip = Point::from_vec(self.zero(x));
        self.chain.tip_in_table(at, tip, &self.terms(x)).mm - self.ball(x)
    }

    /// Its derivatives, in the order of the unknowns.
    pub fn columns(&self, at: &Position, x: &[f64]) -> Vec<Vector3<f64>> {
        let terms = self.terms(x);
        let tip = Point::from_vec(self.zero(x));
        let mut columns = self.chain.jacobian(at, tip, &terms, &self.parameters);
        let table = self.chain.machine_from_table(at, &terms).rotation;
        let turn = table.inverse() * self.chain.machine_from_spindle(at, &terms).rotation;
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        columns.extend(axes.map(|axis| turn * axis));
        columns.extend(axes.map(|axis| -axis));
        columns
    }
}

/// Where the axes stand when the zero point is at the sphere's centre, and how well that is known.
#[derive(Debug, Clone)]
pub struct Sight {
    /// All axes.
    pub at: Position,
    /// From the table frame to weighted rows.
    pub weight: Matrix3<f64>,
}

/// The sphere's centres as one least-squares problem.
#[derive(Debug, Clone)]
pub struct Problem {
    pub model: Model,
    pub sights: Vec<Sight>,
    /// A zero point known beforehand, and its standard uncertainty in mm: where it must be known before
    /// all poses are measured.
    pub hold: Option<(Vector3<f64>, f64)>,
}

impl Problem {
    /// Weighted: measured less model.
    pub fn residuals(&self, x: &[f64]) -> Vec<f64> {
        self.residuals_moved(x, &[])
    }

    /// With the sights moved by `moved` (table frame), one each.
    fn residuals_moved(&self, x: &[f64], moved: &[Vector3<f64>]) -> Vec<f64> {
        let of = |(i, sight): (usize, &Sight)| -> [f64; 3] {
            let by = moved.get(i).copied().unwrap_or_default();
            (sight.weight * -(self.model.misclosure(&sight.at, x) + by)).into()
        };
        let mut rows: Vec<f64> = self.sights.iter().enumerate().flat_map(of).collect();
        if let Some((zero, sigma)) = self.hold {
            rows.extend(&((zero - self.model.zero(x)) / sigma));
        }
        rows
    }

    fn rows(&self, x: &[f64]) -> Vec<Rows> {
        let residuals = self.residuals(x);
        let mut rows = Rows::zeros(residuals.len(), 0, self.model.unknowns());
        residuals.into_iter().enumerate().for_each(|(row, value)| rows.set_value(row, value));
        for (i, sight) in self.sights.iter().enumerate() {
            for (j, column) in self.model.columns(&sight.at, x).into_iter().enumerate() {
                let weighted = sight.weight * column;
                (0..3).for_each(|k| rows.set_common(3 * i + k, j, weighted[k]));
            }
        }
        if let Some((_, sigma)) = self.hold {
            let (first, zero) = (3 * self.sights.len(), self.model.parameters.len());
            (0..3).for_each(|k| rows.set_common(first + k, zero + k, 1.0 / sigma));
        }
        vec![rows]
    }

    /// What the sights can tell of the unknowns, about `x`.
    pub fn survey(&self, x: &[f64]) -> Result<Survey, LinearError> {
        factor(self.rows(x)).0.survey()
    }

    pub fn solve(&self, start: Vec<f64>) -> Result<Minimum, NonlinearError> {
        minimise(start, |x| self.rows(x), |x| self.residuals(x))
    }

    /// The solution for sights moved by `moved` (table frame, mm), near the one found.
    pub fn solve_near(&self, minimum: &Minimum, moved: &[Vector3<f64>]) -> Vec<f64> {
        let mut x = minimum.x.clone();
        for _ in 0..NEAR_STEPS {
            let step = minimum.factored.solve(&self.residuals_moved(&x, moved));
            x.iter_mut().zip(step).for_each(|(x, dx)| *x += dx);
        }
        x
    }
}

/// `rotary` with X, Y, Z.
pub fn placed(rotary: &Position, xyz: Vector3<f64>) -> Position {
    rotary.updated_by(&Position::from_xyz(xyz))
}
