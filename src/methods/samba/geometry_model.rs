//! The equations of one measurement of a ball, and of a certified length.

use nalgebra::{Matrix3, Vector3};

use super::confounding::{MeasuringConditions, length_directions};
use super::parameters::{fixed_axes, select_parameters};
use super::settings::SambaSettings;
use crate::MethodRefusal;
use crate::ball_measurement::tip_derivative_by_stylus;
use machine::frame::{Point, SpindleFrame};
use machine::kinematics::{ErrorParameter, ErrorTerm, KinematicChain, KinematicsError};
use machine::record::artefact::{Balls, CertifiedLength, REFERENCE_TEMPERATURE_C};
use machine::record::machine::Machine;
use machine::record::plan::Plan;
use machine::{Axis, Position};

/// Distance over which the change along a linear axis is computed, mm: a power of two, so that the division
/// does not round.
const AFFINE_STEP_MM: f64 = 256.0;

/// The kinematics of the machine, its unknown errors, and the conditions under which they are measured.
#[derive(Debug, Clone)]
pub struct GeometryModel {
    chain: KinematicChain,
    /// The unknown machine errors.
    parameters: Vec<ErrorParameter>,
    /// Rotary axes that stay at zero.
    fixed_axes: Vec<Axis>,
    /// Directions of the certified lengths, unit vectors, table frame.
    length_directions: Vec<Vector3<f64>>,
    /// Indices, 0 for x to 2 for z, of the stylus coordinates that are unknowns.
    free_stylus_coordinates: Vec<usize>,
}

impl GeometryModel {
    /// Model with exactly these errors, without fixed axes; a certified length along X is assumed.
    ///
    /// # Errors
    /// The kinematics of the machine cannot be built; an error belongs to an axis that the machine does not
    /// have.
    pub fn new(machine: &Machine, parameters: &[ErrorParameter]) -> Result<Self, KinematicsError> {
        let chain = KinematicChain::new(machine)?;
        parameters.iter().try_for_each(|parameter| chain.check_parameter_axis(*parameter))?;
        Ok(Self::from_parts(chain, parameters.to_vec(), Vec::new(), Vec::new()))
    }

    /// `fixed_axes`: rotary axes that stay at zero; `length_directions`: directions of the certified lengths.
    pub(super) fn from_parts(
        chain: KinematicChain,
        parameters: Vec<ErrorParameter>,
        fixed_axes: Vec<Axis>,
        length_directions: Vec<Vector3<f64>>,
    ) -> Self {
        let free_stylus_coordinates = Vec::new();
        let mut model = Self { chain, parameters, fixed_axes, length_directions, free_stylus_coordinates };
        model.free_stylus_coordinates = model.measuring_conditions().free_stylus_coordinates();
        model
    }

    /// The machine of the plan with the errors that the settings select.
    ///
    /// # Errors
    /// The errors of [`select_parameters`].
    pub(super) fn for_plan(
        chain: KinematicChain,
        plan: &Plan,
        settings: &SambaSettings,
        balls: &Balls,
    ) -> Result<Self, MethodRefusal> {
        let fixed_axes = fixed_axes(plan, settings, &chain);
        let mut model = Self::from_parts(chain, Vec::new(), fixed_axes, length_directions(balls));
        model.parameters = select_parameters(&settings.parameters, model.measuring_conditions())?;
        Ok(model)
    }

    /// The measuring conditions that decide which errors are separable.
    pub(super) fn measuring_conditions(&self) -> MeasuringConditions<'_> {
        MeasuringConditions {
            chain: &self.chain,
            fixed_axes: &self.fixed_axes,
            length_directions: &self.length_directions,
        }
    }

    pub fn chain(&self) -> &KinematicChain {
        &self.chain
    }

    pub fn parameters(&self) -> &[ErrorParameter] {
        &self.parameters
    }

    /// Indices of the unknown coordinates of the stylus: all three (0, 1, 2), except those that only shift
    /// all balls alike, such as its length if no axis turns across it (four axes). These keep their stated
    /// values.
    pub fn free_stylus_coordinates(&self) -> &[usize] {
        &self.free_stylus_coordinates
    }

    /// Number of unknowns that all measurements share: machine errors and stylus.
    pub fn shared_unknown_count(&self) -> usize {
        self.parameters.len() + self.free_stylus_coordinates.len()
    }

    /// Derivatives of the tip in the table frame by each shared unknown, at zero errors: mm per mm, per rad or per
    /// mm/mm.
    pub fn nominal_tip_derivatives(&self, position: &Position, tip: Point<SpindleFrame>) -> Vec<Vector3<f64>> {
        let zero_errors = self.error_terms(&vec![0.0; self.parameters.len()]);
        let mut derivatives = self.chain.error_jacobian(position, tip, &zero_errors, &self.parameters);
        let by_stylus = tip_derivative_by_stylus(&self.chain, position, &zero_errors);
        derivatives.extend(self.free_stylus_coordinates.iter().map(|k| by_stylus.column(*k).into_owned()));
        derivatives
    }

    fn error_terms(&self, errors: &[f64]) -> Vec<ErrorTerm> {
        let pairs = self.parameters.iter().zip(errors);
        pairs.map(|(parameter, value)| ErrorTerm { parameter: *parameter, value: *value }).collect()
    }

    /// The tip on the table as a function of X, Y, Z, with the rotary axes and the spindle as in `position`.
    /// `tool`: tip in the spindle frame.
    pub fn tip_function(&self, position: &Position, errors: &[f64], tool: Vector3<f64>) -> AffineFunctionOfXyz {
        let (errors, tip) = (self.error_terms(errors), Point::from_vec(tool));
        let zero = position.filter_axes(|axis| !axis.is_linear());
        AffineFunctionOfXyz {
            value_at_origin: self.chain.tip_in_table(&zero, tip, &errors).mm,
            linear_part: self.chain.linear_axes_jacobian(&zero, &errors),
        }
    }

    /// The tip and its derivatives for all X, Y, Z, with the rotary axes and the spindle as in `position`.
    /// `tool`: tip in the spindle frame.
    pub fn linearise_at_indexation(&self, position: &Position, errors: &[f64], tool: Vector3<f64>) -> IndexationModel {
        let (terms, tip) = (self.error_terms(errors), Point::from_vec(tool));
        let derivatives = |xyz: Vector3<f64>| {
            let position = position.updated_by(&Position::from_xyz(xyz));
            self.chain.error_jacobian(&position, tip, &terms, &self.parameters)
        };
        let columns_at_origin = derivatives(Vector3::zeros());
        let columns_at_steps = Axis::LINEAR.map(|axis| derivatives(axis.nominal_direction() * AFFINE_STEP_MM));
        let machine = columns_at_origin.iter().enumerate().map(|(k, column)| {
            AffineFunctionOfXyz::from_samples(*column, [0, 1, 2].map(|axis: usize| columns_at_steps[axis][k]))
        });
        IndexationModel {
            tip: self.tip_function(position, errors, tool),
            error_derivative_functions: machine.collect(),
            stylus_derivatives: tip_derivative_by_stylus(&self.chain, position, &terms),
        }
    }
}

/// The model at one indexation. Without angular error motions of linear axes, the tip on the table and all
/// its derivatives are affine in X, Y, Z. This is exact, and many times faster than computing each pose.
#[derive(Debug, Clone)]
pub struct IndexationModel {
    /// Position of the tip in the table frame, mm.
    pub tip: AffineFunctionOfXyz,
    /// ∂p_w/∂parameter of the tip, for each parameter.
    pub error_derivative_functions: Vec<AffineFunctionOfXyz>,
    /// ∂p_w/∂tool: R_wᵀ·R_t.
    pub stylus_derivatives: Matrix3<f64>,
}

/// A point of the table frame, or its derivative by an error, as an affine function of X, Y, Z.
#[derive(Debug, Clone, Copy)]
pub struct AffineFunctionOfXyz {
    /// Value at X = Y = Z = 0.
    value_at_origin: Vector3<f64>,
    /// Derivative of the point by X, Y, Z: ∂/∂(X, Y, Z).
    pub linear_part: Matrix3<f64>,
}

impl AffineFunctionOfXyz {
    /// The function from its values at the origin and at [`AFFINE_STEP_MM`] along X, Y, Z.
    fn from_samples(at_origin: Vector3<f64>, at_steps: [Vector3<f64>; 3]) -> Self {
        let [x, y, z] = at_steps.map(|at_step| (at_step - at_origin) / AFFINE_STEP_MM);
        Self { value_at_origin: at_origin, linear_part: Matrix3::from_columns(&[x, y, z]) }
    }

    /// Inverse derivative ∂(X, Y, Z)/∂point; NaN if X, Y, Z are linearly dependent.
    pub fn inverse_linear_part(&self) -> Matrix3<f64> {
        self.linear_part.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN))
    }

    pub fn value_at(&self, xyz: Vector3<f64>) -> Vector3<f64> {
        self.value_at_origin + self.linear_part * xyz
    }
}

/// The certified length at its temperature during the measurement, mm; at 20 °C if no temperature is stated.
pub fn length_at_its_temperature_mm(length: &CertifiedLength) -> f64 {
    let kelvin = length.temperature_c.map_or(0.0, |celsius| celsius - REFERENCE_TEMPERATURE_C);
    length.mm * (1.0 + length.expansion_um_per_m_k * 1e-6 * kelvin)
}

/// Standard uncertainty of the certified length from certificate and temperature, mm, with a lower bound so that its
/// row does not dominate the others numerically.
pub fn length_u_mm(length: &CertifiedLength) -> f64 {
    let [certificate, temperature] = certificate_and_temperature_u_mm(length);
    certificate.hypot(temperature).max(1e-6)
}

/// Standard uncertainties of the certified length from the certificate and from the temperature, mm.
pub fn certificate_and_temperature_u_mm(length: &CertifiedLength) -> [f64; 2] {
    [length.u_mm, (length.mm * length.expansion_um_per_m_k * 1e-6 * length.u_temperature_k).abs()]
}
