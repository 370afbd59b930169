//! The equations: one measurement of a ball, and a certified length.

use nalgebra::{Matrix3, Vector3};

use super::separable::Way;
use machine::kinematics::{Chain, ErrorParameter, ErrorTerm, KinematicsError};
use machine::record::artefact::{Length, REFERENCE_C};
use machine::record::machine::Machine;
use machine::{Axis, Position, frame::Point};

/// Distance at which the change over a linear axis is taken, mm: a power of two, so that dividing by
/// it does not round.
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

/// Of one measurement: FK(reading; errors, tool) − ball, table frame, and its derivatives. The one
/// with respect to the ball is −I.
#[derive(Debug, Clone)]
pub struct Rows {
    /// mm.
    pub misclosure: Vector3<f64>,
    /// ∂/∂parameter, in the order of the parameters: mm per mm, per rad or per mm/mm.
    pub machine: Vec<Vector3<f64>>,
    /// ∂/∂tool.
    pub tool: Matrix3<f64>,
}

impl Model {
    /// # Errors
    /// A machine whose kinematics cannot be built; an error of an axis that it does not have.
    pub fn new(machine: &Machine, parameters: &[ErrorParameter]) -> Result<Self, KinematicsError> {
        let chain = Chain::new(machine)?;
        parameters.iter().try_for_each(|parameter| chain.check(*parameter))?;
        Ok(Self::of(chain, parameters.to_vec(), Vec::new(), Vec::new()))
    }

    /// `stands`: turning axes that stay at zero; `lengths`: directions of the certified ones.
    pub(super) fn of(
        chain: Chain,
        parameters: Vec<ErrorParameter>,
        stands: Vec<Axis>,
        lengths: Vec<Vector3<f64>>,
    ) -> Self {
        let stylus = Way { chain: &chain, stands: &stands, lengths: &lengths }.free_stylus();
        Self { chain, parameters, stands, lengths, stylus }
    }

    /// What may be told apart.
    pub(super) fn way(&self) -> Way<'_> {
        Way { chain: &self.chain, stands: &self.stands, lengths: &self.lengths }
    }

    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    pub fn parameters(&self) -> &[ErrorParameter] {
        &self.parameters
    }

    /// The coordinates of the stylus that are unknown: all three (0, 1, 2), but for those that only
    /// shift all balls alike, such as its length where nothing ever turns across it (four axes). These
    /// are held as stated.
    pub fn stylus(&self) -> &[usize] {
        &self.stylus
    }

    /// The rows of the measurement of `ball` (table frame, mm) at `position` (axis positions at which
    /// the stylus-ball centre coincides with it). `errors` in the order of the parameters, mm, rad,
    /// mm/mm; `tool` from the spindle datum, mm.
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

    /// R_wᵀ·R_t.
    fn tool_columns(&self, position: &Position, terms: &[ErrorTerm]) -> Matrix3<f64> {
        let table = self.chain.machine_from_table(position, terms).rotation;
        let spindle = self.chain.machine_from_spindle(position, terms).rotation;
        (table.inverse() * spindle).into_inner()
    }

    fn terms(&self, errors: &[f64]) -> Vec<ErrorTerm> {
        let pairs = self.parameters.iter().zip(errors);
        pairs.map(|(parameter, value)| ErrorTerm { parameter: *parameter, value: *value }).collect()
    }

    /// The tip on the table with the rotary axes and the spindle as in `position`.
    pub fn tips(&self, position: &Position, errors: &[f64], tool: Vector3<f64>) -> Affine {
        let (errors, tip) = (self.terms(errors), Point::from_vec(tool));
        let zero = position.only(|axis| !axis.is_linear());
        Affine {
            origin: self.chain.tip_in_table(&zero, tip, &errors).mm,
            linear: self.chain.linear_jacobian(&zero, &errors),
        }
    }

    /// All that [`Model::rows`] gives, for all X, Y, Z with the rotary axes and the spindle as in
    /// `position`.
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

/// The model at one indexation. Without angular error motions of linear axes the tip on the table and
/// with it all its derivatives are affine in X, Y, Z: exact, and many times faster than a pose each.
#[derive(Debug, Clone)]
pub struct Indexed {
    tip: Affine,
    machine: Vec<Affine>,
    /// ∂p_w/∂tool: R_wᵀ·R_t.
    pub tool: Matrix3<f64>,
}

impl Indexed {
    /// The tip on the table with the linear axes at `xyz`.
    pub fn tip(&self, xyz: Vector3<f64>) -> Vector3<f64> {
        self.tip.at(xyz)
    }

    /// ∂p_w/∂parameter of the parameter `index`.
    pub fn machine(&self, index: usize, xyz: Vector3<f64>) -> Vector3<f64> {
        self.machine[index].at(xyz)
    }
}

/// A point of the table frame that follows X, Y, Z.
#[derive(Debug, Clone, Copy)]
pub struct Affine {
    origin: Vector3<f64>,
    linear: Matrix3<f64>,
}

impl Affine {
    /// From its values at the origin and at [`REACH`] along X, Y, Z.
    fn through(origin: Vector3<f64>, steps: [Vector3<f64>; 3]) -> Self {
        let [x, y, z] = steps.map(|step| (step - origin) / REACH);
        Self { origin, linear: Matrix3::from_columns(&[x, y, z]) }
    }

    /// ∂/∂(X, Y, Z).
    pub fn linear(&self) -> Matrix3<f64> {
        self.linear
    }

    /// ∂(X, Y, Z)/∂; not a number where X, Y, Z do not span space.
    pub fn inverse(&self) -> Matrix3<f64> {
        self.linear.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN))
    }

    pub fn at(&self, xyz: Vector3<f64>) -> Vector3<f64> {
        self.origin + self.linear * xyz
    }
}

/// The certified length at its temperature during the measurement, mm: 20 °C where none is stated.
pub fn length_mm(length: &Length) -> f64 {
    let above = length.temperature_c.map_or(0.0, |celsius| celsius - REFERENCE_C);
    length.mm * (1.0 + length.expansion_um_per_m_k * 1e-6 * above)
}

/// Its standard uncertainty, mm; never so small that its row outweighs all others' rounding.
pub fn length_u_mm(length: &Length) -> f64 {
    let [certificate, temperature] = length_u_parts_mm(length);
    certificate.hypot(temperature).max(1e-6)
}

/// The same from the certificate and from the temperature, mm.
pub fn length_u_parts_mm(length: &Length) -> [f64; 2] {
    [length.u_mm, (length.mm * length.expansion_um_per_m_k * 1e-6 * length.u_temperature_k).abs()]
}
