//! The equations: one measurement of a ball, and a certified length.

use glam::{DMat3, DVec3};

use super::separable::Way;
use machine::kinematics::{Chain, ErrorParameter, ErrorTerm, KinematicsError};
use machine::record::artefact::Length;
use machine::record::machine::Machine;
use machine::{Axis, Position, frame::Point};

/// Temperature that lengths are certified at, °C (ISO 1).
const REFERENCE_C: f64 = 20.0;
/// Distance at which the change over a linear axis is taken, mm: a power of two, so that dividing by
/// it does not round.
const REACH: f64 = 256.0;

/// The machine with its unknown errors.
#[derive(Debug, Clone)]
pub struct Model {
    chain: Chain,
    parameters: Vec<ErrorParameter>,
    stands: Vec<Axis>,
    lengths: Vec<DVec3>,
    stylus: Vec<usize>,
}

/// Of one measurement: FK(reading; errors, tool) − ball, table frame, and its derivatives. The one
/// with respect to the ball is −I.
#[derive(Debug, Clone)]
pub struct Rows {
    /// mm.
    pub misclosure: DVec3,
    /// ∂/∂parameter, in the order of the parameters: mm per mm, per rad or per mm/mm.
    pub machine: Vec<DVec3>,
    /// ∂/∂tool.
    pub tool: DMat3,
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
        lengths: Vec<DVec3>,
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
    pub fn rows(&self, position: &Position, errors: &[f64], tool: DVec3, ball: DVec3) -> Rows {
        let (terms, tip) = (self.terms(errors), Point::from_vec(tool));
        Rows {
            misclosure: self.chain.tip_in_table(position, tip, &terms).mm - ball,
            machine: self.chain.jacobian(position, tip, &terms, &self.parameters),
            tool: self.tool_columns(position, &terms),
        }
    }

    /// R_wᵀ·R_t.
    fn tool_columns(&self, position: &Position, terms: &[ErrorTerm]) -> DMat3 {
        let table = self.chain.machine_from_table(position, terms).matrix3;
        table.transpose() * self.chain.machine_from_spindle(position, terms).matrix3
    }

    fn terms(&self, errors: &[f64]) -> Vec<ErrorTerm> {
        let pairs = self.parameters.iter().zip(errors);
        pairs.map(|(parameter, value)| ErrorTerm { parameter: *parameter, value: *value }).collect()
    }

    /// The tip on the table with the rotary axes and the spindle as in `position`.
    pub fn tips(&self, position: &Position, errors: &[f64], tool: DVec3) -> Affine {
        let (errors, tip) = (self.terms(errors), Point::from_vec(tool));
        let zero = position.only(|axis| !axis.is_linear());
        Affine {
            origin: self.chain.tip_in_table(&zero, tip, &errors).mm,
            linear: self.chain.linear_jacobian(&zero, &errors),
        }
    }

    /// All that [`Model::rows`] gives, for all X, Y, Z with the rotary axes and the spindle as in
    /// `position`.
    pub fn indexed(&self, position: &Position, errors: &[f64], tool: DVec3) -> Indexed {
        let (terms, tip) = (self.terms(errors), Point::from_vec(tool));
        let at = |xyz: DVec3| {
            let position = position.updated_by(&linear_axes(xyz));
            self.chain.jacobian(&position, tip, &terms, &self.parameters)
        };
        let columns = at(DVec3::ZERO);
        let steps = DVec3::AXES.map(|axis| at(axis * REACH));
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
    pub tool: DMat3,
}

impl Indexed {
    /// The tip on the table with the linear axes at `xyz`.
    pub fn tip(&self, xyz: DVec3) -> DVec3 {
        self.tip.at(xyz)
    }

    /// ∂p_w/∂parameter of the parameter `index`.
    pub fn machine(&self, index: usize, xyz: DVec3) -> DVec3 {
        self.machine[index].at(xyz)
    }
}

/// A point of the table frame that follows X, Y, Z.
#[derive(Debug, Clone, Copy)]
pub struct Affine {
    origin: DVec3,
    linear: DMat3,
}

impl Affine {
    /// From its values at the origin and at [`REACH`] along X, Y, Z.
    fn through(origin: DVec3, steps: [DVec3; 3]) -> Self {
        let [x, y, z] = steps.map(|step| (step - origin) / REACH);
        Self { origin, linear: DMat3::from_cols(x, y, z) }
    }

    /// ∂/∂(X, Y, Z).
    pub fn linear(&self) -> DMat3 {
        self.linear
    }

    pub fn at(&self, xyz: DVec3) -> DVec3 {
        self.origin + self.linear * xyz
    }
}

pub fn linear_axes(xyz: DVec3) -> Position {
    Axis::LINEAR.into_iter().zip(xyz.to_array()).collect()
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
