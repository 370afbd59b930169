//! The equations of one measurement of a ball, and of a certified length.

use nalgebra::{Matrix3, Vector3};

use super::separable::Way;
use machine::kinematics::{Chain, ErrorParameter, ErrorTerm, KinematicsError};
use machine::record::artefact::{Length, REFERENCE_C};
use machine::record::machine::Machine;
use machine::{Axis, Position, frame::Point};

/// Distance over which the change along a linear axis is computed, mm: a power of two, so that the division
/// does not round.
const REACH: f64 = 256.0;

/// The machine with its unknown errors.
#[derive(Debug, Clone)]
pub struct Model {
    chain: Chain,
    parameters: Vec<ErrorParameter>,
    stands: Vec<Axis>,
    lengths: Vec<Vector3<f64>>,
    stylus: Vec<usize>,
}

/// Rows of one measurement: FK(reading; errors, tool) − ball, table frame, and its derivatives. The
/// derivative by the ball is −I.
#[derive(Debug, Clone)]
pub struct Rows {
    /// Misclosure: calculated position of the ball minus its position `ball`, table frame, mm.
    pub misclosure: Vector3<f64>,
    /// ∂/∂parameter, in the order of the parameters: mm per mm, per rad or per mm/mm.
    pub machine: Vec<Vector3<f64>>,
    /// ∂/∂tool: derivative of the tip on the table by the stylus vector.
    pub tool: Matrix3<f64>,
}

impl Model {
    /// # Errors
    /// The kinematics of the machine cannot be built; an error belongs to an axis that the machine does not
    /// have.
    pub fn new(machine: &Machine, parameters: &[ErrorParameter]) -> Result<Self, KinematicsError> {
        let chain = Chain::new(machine)?;
        parameters.iter().try_for_each(|parameter| chain.check(*parameter))?;
        Ok(Self::of(chain, parameters.to_vec(), Vec::new(), Vec::new()))
    }

    /// `stands`: rotary axes that stay at zero; `lengths`: directions of the certified lengths.
    pub(super) fn of(
        chain: Chain,
        parameters: Vec<ErrorParameter>,
        stands: Vec<Axis>,
        lengths: Vec<Vector3<f64>>,
    ) -> Self {
        let stylus = Way { chain: &chain, stands: &stands, lengths: &lengths }.free_stylus();
        Self { chain, parameters, stands, lengths, stylus }
    }

    /// The measuring conditions that decide which errors are separable.
    pub(super) fn way(&self) -> Way<'_> {
        Way { chain: &self.chain, stands: &self.stands, lengths: &self.lengths }
    }

    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    pub fn parameters(&self) -> &[ErrorParameter] {
        &self.parameters
    }

    /// Indices of the unknown coordinates of the stylus: all three (0, 1, 2), except those that only shift
    /// all balls alike, such as its length if no axis turns across it (four axes). These keep their stated
    /// values.
    pub fn stylus(&self) -> &[usize] {
        &self.stylus
    }

    /// The rows of the measurement of `ball` (table frame, mm) at `position` (axis positions at which the
    /// stylus ball centre coincides with it). `errors` are in the order of the parameters, mm, rad, mm/mm;
    /// `tool` is the stylus from the spindle datum, mm.
    pub fn rows(
        &self,
        position: &Position,
        errors: &[f64],
        tool: Vector3<f64>,
        ball: Vector3<f64>,
    ) -> Rows {
        let (terms, tip) = (self.terms(errors), Point::from_vec(tool));
        Rows {
            misclosure: self.chain.tip_in_table(position, tip, &terms).mm - ball,
            machine: self.chain.jacobian(position, tip, &terms, &self.parameters),
            tool: self.tool_columns(position, &terms),
        }
    }

    /// Derivative of the tip by the stylus vector: R_wᵀ·R_t.
    fn tool_columns(&self, position: &Position, terms: &[ErrorTerm]) -> Matrix3<f64> {
        let table = self.chain.machine_from_table(position, terms).rotation;
        let spindle = self.chain.machine_from_spindle(position, terms).rotation;
        (table.inverse() * spindle).into_inner()
    }

    fn terms(&self, errors: &[f64]) -> Vec<ErrorTerm> {
        let pairs = self.parameters.iter().zip(errors);
        pairs.map(|(parameter, value)| ErrorTerm { parameter: *parameter, value: *value }).collect()
    }

    /// The tip on the table as a function of X, Y, Z, with the rotary axes and the spindle as in `position`.
    pub fn tips(&self, position: &Position, errors: &[f64], tool: Vector3<f64>) -> Affine {
        let (errors, tip) = (self.terms(errors), Point::from_vec(tool));
        let zero = position.only(|axis| !axis.is_linear());
        Affine {
            origin: self.chain.tip_in_table(&zero, tip, &errors).mm,
            linear: self.chain.linear_jacobian(&zero, &errors),
        }
    }

    /// The results of [`Model::rows`] for all X, Y, Z, with the rotary axes and the spindle as in `position`.
    pub fn indexed(&self, position: &Position, errors: &[f64], tool: Vector3<f64>) -> Indexed {
        let (terms, tip) = (self.terms(errors), Point::from_vec(tool));
        let at = |xyz: Vector3<f64>| {
            let position = position.updated_by(&Position::from_xyz(xyz));
            self.chain.jacobian(&position, tip, &terms, &self.parameters)
        };
        let columns = at(Vector3::zeros());
        let steps = Axis::LINEAR.map(|axis| at(axis.direction() * REACH));
        let machine = columns.iter().enumerate().map(|(k, column)| {
            Affine::through(*column, [0, 1, 2].map(|axis: usize| steps[axis][k]))
        });
        Indexed {
            tip: self.tips(position, errors, tool),
            machine: machine.collect(),
            tool: self.tool_columns(position, &terms),
        }
    }
}

/// The model at one indexation. Without angular error motions of linear axes, the tip on the table and all
/// its derivatives are affine in X, Y, Z. This is exact, and many times faster than computing each pose.
#[derive(Debug, Clone)]
pub struct Indexed {
    tip: Affine,
    machine: Vec<Affine>,
    /// ∂p_w/∂tool: R_wᵀ·R_t.
    pub tool: Matrix3<f64>,
}

impl Indexed {
    /// Position of the tip in the table frame with the linear axes at `xyz`, mm.
    pub fn tip(&self, xyz: Vector3<f64>) -> Vector3<f64> {
        self.tip.at(xyz)
    }

    /// Derivative ∂p_w/∂parameter of the tip for the parameter `index`.
    pub fn machine(&self, index: usize, xyz: Vector3<f64>) -> Vector3<f64> {
        self.machine[index].at(xyz)
    }
}

/// A point of the table frame as an affine function of X, Y, Z.
#[derive(Debug, Clone, Copy)]
pub struct Affine {
    origin: Vector3<f64>,
    linear: Matrix3<f64>,
}

impl Affine {
    /// The function from its values at the origin and at [`REACH`] along X, Y, Z.
    fn through(origin: Vector3<f64>, steps: [Vector3<f64>; 3]) -> Self {
        let [x, y, z] = steps.map(|step| (step - origin) / REACH);
        Self { origin, linear: Matrix3::from_columns(&[x, y, z]) }
    }

    /// Derivative of the point by X, Y, Z: ∂/∂(X, Y, Z).
    pub fn linear(&self) -> Matrix3<f64> {
        self.linear
    }

    /// Inverse derivative ∂(X, Y, Z)/∂point; NaN if X, Y, Z are linearly dependent.
    pub fn inverse(&self) -> Matrix3<f64> {
        self.linear.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN))
    }

    pub fn at(&self, xyz: Vector3<f64>) -> Vector3<f64> {
        self.origin + self.linear * xyz
    }
}

/// The certified length at its temperature during the measurement, mm; at 20 °C if none is stated.
pub fn length_mm(length: &Length) -> f64 {
    let above = length.temperature_c.map_or(0.0, |celsius| celsius - REFERENCE_C);
    length.mm * (1.0 + length.expansion_um_per_m_k * 1e-6 * above)
}

/// Standard uncertainty of the certified length, mm, with a lower bound so that its row does not dominate the
/// others numerically.
pub fn length_u_mm(length: &Length) -> f64 {
    let [certificate, temperature] = length_u_parts_mm(length);
    certificate.hypot(temperature).max(1e-6)
}

/// Standard uncertainties of the certified length from the certificate and from the temperature, mm.
pub fn length_u_parts_mm(length: &Length) -> [f64; 2] {
    [length.u_mm, (length.mm * length.expansion_um_per_m_k * 1e-6 * length.u_temperature_k).abs()]
}
