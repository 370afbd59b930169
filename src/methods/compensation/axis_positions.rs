//! Positions of the rotary axes in the coordinates of the control, from an estimate.

use estimation::coverage::coverage_factor;
use faer::Mat;
use nalgebra::{Point3, Vector3};

use crate::MethodRefusal;
use crate::identification::prior_covariance;
use machine::frame::{Point, Pose};
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm, KinematicChain};
use machine::record::estimate::{Estimate, Parameter};
use machine::record::machine::Machine;
use machine::{Axis, Position};

/// Angle or displacement, rad or mm, of one error for its derivative: small against the lever arms, so that the
/// position is linear in it.
const DERIVATIVE_STEP: f64 = 1e-4;

/// Position of a rotary `axis` along `component`: the coordinate X, Y or Z that the control shows while the tip, on the
/// axis of the spindle, is at the stated point of the rotary axis. All rotary axes are at zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct AxisCoordinate {
    pub axis: Axis,
    pub component: Axis,
}

/// A value in mm with its standard uncertainty and its coverage factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ValueWithUncertainty {
    pub mm: f64,
    pub u_mm: f64,
    pub k: f64,
}

/// Where the rotary axes are by an estimate.
pub struct MeasuredAxisPositions<'a> {
    chain: KinematicChain,
    machine: &'a Machine,
    estimate: &'a Estimate,
    errors: Vec<ErrorTerm>,
    /// Parameters of the estimate: those of `errors`, then the coordinates of the tool.
    parameters: Vec<&'a Parameter>,
    /// Covariance of the `parameters`, mm and rad.
    covariance: Mat<f64>,
    /// Standard uncertainty of the stated offset of the stylus from the axis of the spindle, mm; 0 if it is not stated.
    u_stylus_offset_mm: f64,
}

impl<'a> MeasuredAxisPositions<'a> {
    /// `u_stylus_offset_mm`: standard uncertainty of the stated offset of the stylus from the axis of the spindle; 0 if it
    /// is not stated.
    ///
    /// # Errors
    /// The machine has no kinematics; the estimate has no errors of its axes with their covariance.
    pub fn new(machine: &'a Machine, u_stylus_offset_mm: f64, estimate: &'a Estimate) -> Result<Self, MethodRefusal> {
        let chain = KinematicChain::new(machine)?;
        let error = |parameter: &'a Parameter| {
            let error: ErrorParameter = parameter.symbol.parse().ok()?;
            let value = parameter.value / parameter.unit.to_reported_value(1.0);
            let is_of_machine = chain.check_parameter_axis(error).is_ok();
            is_of_machine.then_some((ErrorTerm { parameter: error, value }, parameter))
        };
        let (errors, mut parameters): (Vec<_>, Vec<_>) = estimate.parameters.iter().filter_map(error).unzip();
        parameters.extend(estimate.parameters.iter().filter(|own| tool_component(&own.symbol).is_some()));
        let symbols: Vec<&str> = parameters.iter().map(|own| own.symbol.as_str()).collect();
        let covariance = prior_covariance(estimate, &symbols).filter(|_| !errors.is_empty()).ok_or_else(|| {
            MethodRefusal::new(
                format!(
                    "the estimate of {} has no errors of this machine's axes with their covariance",
                    estimate.method
                ),
                "give a run of samba, self-calibration or laser-r-test on this machine",
            )
        })?;
        Ok(Self { chain, machine, estimate, errors, parameters, covariance, u_stylus_offset_mm })
    }

    /// The sum of the measured positions, each times its factor.
    ///
    /// # Errors
    /// The estimate does not determine a position, or not relative to the spindle.
    pub fn sum(&self, terms: &[(AxisCoordinate, f64)]) -> Result<ValueWithUncertainty, MethodRefusal> {
        terms.iter().try_for_each(|(coordinate, _)| self.check_is_determined(*coordinate))?;
        let mut own_variance = 0.0;
        for component in Axis::LINEAR {
            let of_component = terms.iter().filter(|(coordinate, _)| coordinate.component == component);
            let spindle_factor: f64 = of_component.map(|(_, factor)| factor).sum();
            if spindle_factor != 0.0 {
                own_variance += (spindle_factor * self.check_spindle(component)?).powi(2);
            }
        }
        let nominal = self.nominal_sum(terms);
        let total = |errors: &[ErrorTerm], tool: Vector3<f64>| -> f64 {
            terms.iter().map(|(coordinate, factor)| factor * self.displacement(*coordinate, errors, tool)).sum()
        };
        let derivatives: Vec<f64> = (0..self.parameters.len()).map(|index| self.derivative(index, &total)).collect();
        let mut variance = own_variance;
        for (i, first) in derivatives.iter().enumerate() {
            variance +=
                derivatives.iter().enumerate().map(|(j, own)| first * own * self.covariance[(i, j)]).sum::<f64>();
        }
        let used = self.parameters.iter().zip(&derivatives).filter(|(_, derivative)| **derivative != 0.0);
        let smallest_dof = used.filter_map(|(parameter, _)| parameter.dof).fold(f64::INFINITY, f64::min);
        let mm = nominal + total(&self.errors, self.tool_displacement());
        Ok(ValueWithUncertainty { mm, u_mm: variance.max(0.0).sqrt(), k: coverage_factor(smallest_dof) })
    }

    /// The sum of the positions in the machine file, mm.
    pub fn nominal_sum(&self, terms: &[(AxisCoordinate, f64)]) -> f64 {
        terms.iter().map(|(coordinate, factor)| factor * nominal_coordinate(self.machine, *coordinate)).sum()
    }

    fn derivative(&self, index: usize, total: &dyn Fn(&[ErrorTerm], Vector3<f64>) -> f64) -> f64 {
        let (mut one, mut tool) = (Vec::new(), Vector3::zeros());
        match self.errors.get(index) {
            Some(error) => one.push(ErrorTerm { value: DERIVATIVE_STEP, ..*error }),
            None => {
                let component = tool_component(&self.parameters[index].symbol);
                let is_used = component.filter(|component| self.uses_tool_coordinate(*component));
                tool = is_used.map_or(tool, |component| component.nominal_direction() * DERIVATIVE_STEP);
            }
        }
        total(&one, tool) / DERIVATIVE_STEP
    }

    /// Displacement of the axis minus that of the spindle along the component, mm. `tool`: displacement of the stylus
    /// ball from its stated position where that describes the spindle.
    fn displacement(&self, coordinate: AxisCoordinate, errors: &[ErrorTerm], tool: Vector3<f64>) -> f64 {
        let AxisCoordinate { axis, component } = coordinate;
        let branch = self.chain.topology().workpiece_branch();
        let carriers_and_own = branch.iter().position(|own| *own == axis).map_or(&branch[..0], |own| &branch[..=own]);
        let own: Vec<ErrorTerm> =
            errors.iter().copied().filter(|error| carriers_and_own.contains(&error.parameter.axis())).collect();
        let tip = self.machine.tool_mm[2] * Vector3::z();
        let point = self.machine.axes.get(&axis).map_or(Vector3::zeros(), |stated| stated.point_mm.into());
        // The tip on the point: there the squareness and the gains of X, Y and Z count as they do beside the workpiece.
        let at = self.chain.solve_linear_axes(Point::from_vec(point), Point::from_vec(tip), &Position::new(), &[]);
        let at = at.unwrap_or_default();
        let displacement = |pose: [Pose; 2], point: Vector3<f64>| {
            let [with_errors, nominal] = pose.map(|pose| pose * Point3::from(point));
            with_errors - nominal
        };
        let of_axis = displacement([&own[..], &[]].map(|errors| self.chain.machine_from_table(&at, errors)), point);
        let of_tip = displacement([errors, &[]].map(|errors| self.chain.machine_from_spindle(&at, errors)), tip);
        (of_axis - of_tip - tool).dot(&component.nominal_direction())
    }

    /// Measured minus stated position of the stylus ball, where it describes the position of the spindle, mm.
    fn tool_displacement(&self) -> Vector3<f64> {
        let along = |component: Axis| {
            let parameter = self.tool_parameter(component).filter(|_| self.uses_tool_coordinate(component));
            parameter.map_or(0.0, |own| own.value / own.unit.to_reported_value(1.0) - self.stated_tool_mm(component))
        };
        Vector3::from(Axis::LINEAR.map(along))
    }

    fn stated_tool_mm(&self, component: Axis) -> f64 {
        component.nominal_direction().dot(&Vector3::from(self.machine.tool_mm))
    }

    fn tool_parameter(&self, component: Axis) -> Option<&'a Parameter> {
        self.parameters.iter().copied().find(|own| tool_component(&own.symbol) == Some(component))
    }

    /// Whether the measured position of the stylus ball stands for that of the spindle: the estimate does not separate
    /// them.
    fn uses_tool_coordinate(&self, component: Axis) -> bool {
        self.tool_parameter(component).is_some() && !self.has_error(component, Axis::S)
    }

    fn has_error(&self, component: Axis, axis: Axis) -> bool {
        let location = ErrorParameter::new(component, axis, ErrorShape::Location).ok();
        self.errors.iter().any(|error| Some(error.parameter) == location)
    }

    /// The estimate has the location error, or holds it at zero as equivalent to others.
    fn check_is_determined(&self, coordinate: AxisCoordinate) -> Result<(), MethodRefusal> {
        let AxisCoordinate { axis, component } = coordinate;
        let symbol = format!("E{component}0{axis}");
        let is_held = self.estimate.held_at_zero.contains(&symbol);
        MethodRefusal::require(
            self.has_error(component, axis) || is_held,
            format!(
                "the estimate of {} does not determine the position of {axis} in {component}",
                self.estimate.method
            ),
            format!("give a run that determines {symbol}, e.g. of samba"),
        )
    }

    /// Additional standard uncertainty of the position of the spindle along `component`, mm.
    fn check_spindle(&self, component: Axis) -> Result<f64, MethodRefusal> {
        let has_sensor_zero = self.estimate.parameters.iter().any(|own| own.symbol.starts_with("zero_"));
        MethodRefusal::require(
            !has_sensor_zero,
            format!(
                "the estimate of {} does not determine the axes relative to the spindle: the position of its sensor in \
                 the spindle is unknown",
                self.estimate.method
            ),
            "give a run with the touch probe, e.g. of samba",
        )?;
        if component == Axis::Z || !self.uses_tool_coordinate(component) {
            return Ok(0.0);
        }
        MethodRefusal::require(
            self.u_stylus_offset_mm > 0.0,
            format!(
                "the estimate of {} does not separate the stylus from the axis of the spindle in {component}",
                self.estimate.method
            ),
            "measure with an oriented spindle (add S to the topology, and angles of S to the method), or state the \
             run-out of the stylus as stylus_offset_um in [probe]",
        )?;
        Ok(self.u_stylus_offset_mm)
    }
}

/// Position of the axis in the machine file, mm.
pub(super) fn nominal_coordinate(machine: &Machine, coordinate: AxisCoordinate) -> f64 {
    let point = machine.axes.get(&coordinate.axis).map_or([0.0; 3], |stated| stated.point_mm);
    coordinate.component.nominal_direction().dot(&Vector3::from(point))
}

/// X, Y or Z of `tool_x`, `tool_y` or `tool_z`.
fn tool_component(symbol: &str) -> Option<Axis> {
    Axis::LINEAR.into_iter().find(|axis| symbol == format!("tool_{}", axis.name().to_lowercase()))
}
