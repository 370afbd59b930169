//! Positions of the rotary axes of the table in the coordinates of the control, from an estimate.

use estimation::coverage::coverage_factor;
use nalgebra::Vector3;
use serde::Serialize;

use super::travel::{AxisTravel, error_by_gain_mm, gain_parameter_of_axis};
use crate::MethodRefusal;
use crate::identification::{KnownErrors, SpindlePosition, StatedStylusUncertainty, UndeterminedSpindleComponent};
use machine::frame::{Point, SpindleFrame};
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm, KinematicChain, ZParallelTableAxis};
use machine::record::estimate::Estimate;
use machine::record::machine::Machine;
use machine::{Axis, Position};

/// Derivative, mm per mm or rad, below which an error has no effect.
const MIN_ERROR_EFFECT_DERIVATIVE: f64 = 1e-9;

/// Position of a rotary `axis` of the table along `component`: X, Y or Z of the control with the tip on the axis and
/// the rotary axes at zero, minus the same coordinate of the stated stylus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct RotaryAxisCoordinate {
    pub axis: Axis,
    pub component: Axis,
}

/// A measured position, or error of a travel, in mm, with its expanded uncertainty (coverage probability 95.45 %).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredLength {
    pub mm: f64,
    pub expanded_mm: f64,
}

/// Positions of the rotary axes, and errors of the travel of linear axes, as determined by an estimate.
pub struct MeasuredAxisPositions<'a> {
    chain: KinematicChain,
    estimate: &'a Estimate,
    /// Errors of the axes, with the position of the spindle where the estimate gives it.
    known: KnownErrors<'a>,
    undetermined_spindle_components: Vec<UndeterminedSpindleComponent>,
    /// Point for which the positions are valid. `None`: the table has no axis along Z.
    at: Option<Vector3<f64>>,
    /// On the spindle axis at the stated stylus length.
    tip: Point<SpindleFrame>,
}

impl<'a> MeasuredAxisPositions<'a> {
    /// # Errors
    /// The machine has no kinematics; the estimate has no errors of its axes.
    pub fn new(
        machine: &Machine,
        stylus: StatedStylusUncertainty,
        estimate: &'a Estimate,
    ) -> Result<Self, MethodRefusal> {
        let chain = KinematicChain::new(machine)?;
        let known = KnownErrors::from_estimate(estimate, &chain)?;
        let spindle = SpindlePosition::new(estimate, machine, &chain, &known, stylus);
        let at = reference_point(machine, &chain, estimate);
        let known = known.with_spindle_position(&spindle);
        let tip = Point::from_vec(Vector3::z() * machine.tool_mm[2]);
        Ok(Self { chain, estimate, known, undetermined_spindle_components: spindle.undetermined, at, tip })
    }

    /// Point for which the positions are valid: machine frame with all axes at zero, mm. The position of each axis is
    /// measured at the point of the axis nearest to this point, with the tip there.
    pub fn at_mm(&self) -> Option<[f64; 3]> {
        self.at.map(Into::into)
    }

    /// The only point for which the estimate states its positions; `None`: it is valid at any point.
    pub(super) fn only_valid_point_mm(&self) -> Option<Vector3<f64>> {
        self.estimate.location_at_mm.map(Into::into)
    }

    /// The same positions, valid for `at`.
    pub(super) fn with_reference_point(self, at: Option<Vector3<f64>>) -> Self {
        Self { at, ..self }
    }

    /// The position that the machine file states, mm.
    pub fn stated_mm(&self, coordinate: RotaryAxisCoordinate) -> Option<f64> {
        self.at.map(|at| nominal_coordinate(&self.chain, coordinate, at))
    }

    /// Excess motion of the tool relative to the workpiece over `travel`, from the gain error of the axis.
    ///
    /// # Errors
    /// The estimate does not determine the gain.
    pub fn travel_error(&self, travel: AxisTravel) -> Result<MeasuredLength, MethodRefusal> {
        let symbol = gain_parameter_of_axis(travel.axis)?.to_string();
        let gain = self.estimate.parameters.iter().find(|own| own.symbol == symbol && own.identifiable);
        let gain = gain.ok_or_else(|| {
            MethodRefusal::new(
                format!("the {} run does not determine the scale of {}", self.estimate.method, travel.axis),
                format!("give a run that determines {symbol}, e.g. of samba with a calibrated length"),
            )
        })?;
        let per_unit = gain.unit.to_reported_value(1.0);
        let by_gain_mm = error_by_gain_mm(&self.chain, travel)?;
        let (mm, expanded_mm) = (by_gain_mm * gain.value / per_unit, by_gain_mm.abs() * gain.expanded / per_unit);
        Ok(MeasuredLength { mm, expanded_mm })
    }

    /// Measured position: the stated one plus the displacement by the identified errors, relative to the tip.
    ///
    /// # Errors
    /// The estimate does not determine the position, or not relative to the spindle.
    pub fn position(&self, coordinate: RotaryAxisCoordinate) -> Result<MeasuredLength, MethodRefusal> {
        self.check_is_determined(coordinate)?;
        let RotaryAxisCoordinate { axis, component } = coordinate;
        let at = self.at.ok_or_else(|| {
            MethodRefusal::new("the table does not turn about Z", "check the topology and the directions of the axes")
        })?;
        let derivative = |error: &ErrorTerm| -> Result<f64, MethodRefusal> {
            let by = self.chain.axis_displacement_derivative(axis, at, self.tip, error.parameter)?;
            Ok(by.dot(&component.nominal_direction()))
        };
        let derivatives = self.known.errors.iter().map(derivative).collect::<Result<Vec<f64>, _>>()?;
        MethodRefusal::require(
            derivatives.iter().any(|derivative| derivative.abs() > MIN_ERROR_EFFECT_DERIVATIVE),
            format!(
                "no error of the {} run has an effect on the position of {axis} in {component}",
                self.estimate.method
            ),
            "add the errors equivalent to this position to the parameters of the method",
        )?;
        let covariance = &self.known.covariance;
        let variance_by = |i: usize| {
            let row = derivatives.iter().enumerate().map(|(j, by)| by * covariance[(i, j)]);
            derivatives[i] * row.sum::<f64>()
        };
        let variance: f64 = (0..derivatives.len()).map(variance_by).sum();
        let used = self
            .known
            .symbols
            .iter()
            .zip(&derivatives)
            .filter(|(_, derivative)| derivative.abs() > MIN_ERROR_EFFECT_DERIVATIVE);
        let dof_of = |symbol: &str| self.estimate.parameters.iter().find(|own| own.symbol == symbol)?.dof;
        let smallest_dof = used.filter_map(|(symbol, _)| dof_of(symbol)).fold(f64::INFINITY, f64::min);
        let displacement = self.chain.axis_displacement_relative_to_tip(axis, at, self.tip, &self.known.errors)?;
        Ok(MeasuredLength {
            mm: nominal_coordinate(&self.chain, coordinate, at) + displacement.dot(&component.nominal_direction()),
            expanded_mm: coverage_factor(smallest_dof) * variance.max(0.0).sqrt(),
        })
    }

    /// Checks that the estimate contains the location error, or holds it at zero as equivalent to others, that the
    /// run includes zero of each rotary axis that carries the axis, and that the position of the spindle is
    /// determined.
    fn check_is_determined(
        &self,
        RotaryAxisCoordinate { axis, component }: RotaryAxisCoordinate,
    ) -> Result<(), MethodRefusal> {
        let method = &self.estimate.method;
        let symbol = format!("E{component}0{axis}");
        let has_error = ErrorParameter::new(component, axis, ErrorShape::Location)
            .is_ok_and(|location| self.known.has_error(location));
        MethodRefusal::require(
            has_error || self.estimate.held_at_zero.contains(&symbol),
            format!("the {method} run does not determine the position of {axis} in {component}"),
            format!("give a run that determines {symbol}, e.g. of samba"),
        )?;
        let is_at_zero = |[least, most]: &[f64; 2]| (*least..=*most).contains(&0.0);
        let carriers = self.chain.topology().workpiece_branch().iter().take_while(|own| **own != axis);
        for carrier in carriers.filter(|carrier| !carrier.is_linear()) {
            MethodRefusal::require(
                self.estimate.measured_ranges.get(carrier).is_none_or(is_at_zero),
                format!("the {method} run did not measure with {carrier} at 0"),
                format!("give a run that includes {carrier} at 0"),
            )?;
        }
        match self.undetermined_spindle_components.iter().find(|own| own.component == component) {
            Some(UndeterminedSpindleComponent { reason, remedy, .. }) => Err(MethodRefusal::new(reason, remedy)),
            None => Ok(()),
        }
    }
}

/// Point for which the estimate states its positions, or else on the stated axis along Z at mid-range of the measured
/// Z.
fn reference_point(machine: &Machine, chain: &KinematicChain, estimate: &Estimate) -> Option<Vector3<f64>> {
    if let Some(at_mm) = estimate.location_at_mm {
        return Some(at_mm.into());
    }
    let axis = ZParallelTableAxis::of_machine(machine, chain).map(|own| own.axis);
    let line = axis.and_then(|axis| chain.axis_line(axis, &Position::new()))?;
    let measured_z =
        estimate.measured_ranges.get(&Axis::Z).map(|[least, most]| (least + most) / 2.0 + machine.tool_mm[2]);
    Some(Vector3::new(line.point.x, line.point.y, measured_z.unwrap_or(line.point.z)))
}

/// Coordinate of the stated axis at its point nearest to `at`, mm.
pub(super) fn nominal_coordinate(chain: &KinematicChain, coordinate: RotaryAxisCoordinate, at: Vector3<f64>) -> f64 {
    let line = chain.axis_line(coordinate.axis, &Position::new());
    let nearest = line.map_or(Vector3::zeros(), |line| line.point_nearest_to(at));
    coordinate.component.nominal_direction().dot(&nearest)
}
