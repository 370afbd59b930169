//! Comparison of the tool centre that the control computes with its values, and with the machine as two runs measured
//! it.

use machine::frame::Point;
use machine::kinematics::{ErrorTerm, KinematicChain};
use machine::record::tool_centre::ToolCentreReading;
use machine::{Axis, Position};
use methods::MethodRefusal;
use methods::compensation::{ControlModel, RotaryAxisCoordinate};
use nalgebra::Vector3;
use serde::Serialize;

use super::measured_run::{JointCoverage, MeasuredRun};

/// Largest deviation of the tool centre by the control from that of its values, mm: five times what the last printed
/// decimal of a rotary axis, 1e-6 degrees, moves a point 1 m from the axis.
const MAX_CONTROL_DEVIATION_MM: f64 = 1e-4;

/// Error of the tool centre at one standstill of the second run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ToolCentreError {
    /// Step after which the tool centre was read.
    pub step: u32,
    /// Positions of the axes of the machine, without tool centre point control.
    pub position: Position,
    /// Distance between the tool centre that the control reports and the one that follows from its values, mm.
    pub control_deviation_mm: f64,
    /// Error of the tip in the frame of the table by the estimate of the second run, including the deviation of the
    /// tool centre that the control reports from its values, mm.
    pub measured_mm: [f64; 3],
    /// `None`: the two estimates contain different axis errors.
    #[serde(flatten)]
    pub prediction: Option<ToolCentrePrediction>,
}

/// Prediction from the estimate of the first run, from which the compensation was computed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ToolCentrePrediction {
    /// Error of the tip in the frame of the table with the present values of the control, mm.
    pub predicted_mm: [f64; 3],
    /// Limit of |measured − predicted| for each component, mm: all comparisons of the verification hold together at
    /// 95.45 %.
    pub limit_mm: [f64; 3],
}

impl ToolCentreError {
    /// Whether the control computes its tool centre from its values.
    pub fn follows_from_values(&self) -> bool {
        self.control_deviation_mm <= MAX_CONTROL_DEVIATION_MM
    }

    /// Whether the second run measured what the first one predicts; also true without a prediction.
    pub fn is_as_predicted(&self) -> bool {
        self.prediction
            .is_none_or(|own| (0..3).all(|k| (self.measured_mm[k] - own.predicted_mm[k]).abs() <= own.limit_mm[k]))
    }
}

/// Errors of the tool centre where the second run has read it from the control. They are relative to the tool centre at
/// the origin of the table, with the rotary axes at zero.
pub(super) fn tool_centre_errors(
    [first, second]: [&MeasuredRun<'_>; 2],
    control: &ControlModel,
    coverage: JointCoverage,
) -> Result<Vec<ToolCentreError>, MethodRefusal> {
    let machine = &second.stored.plan.machine;
    let chain = KinematicChain::new(machine)?;
    // For the control a tool is on the axis of the spindle.
    let tool_centre = Point::from_vec(Vector3::z() * machine.tool_mm[2]);
    let (of_first, of_second) = (first.positions()?, second.positions()?);
    let values_mm: Vec<f64> = control.values().iter().map(|value| value.present_mm).collect();
    let errors_of_control = |is_determined: &dyn Fn(RotaryAxisCoordinate) -> bool| {
        control.compensated_errors(&chain, &values_mm, of_first.at_mm(), is_determined)
    };
    let all = errors_of_control(&|_| true)?;
    let determined = errors_of_control(&|own| of_first.position(own).is_ok() && of_second.position(own).is_ok())?;
    let [by_first, by_second] = [first.predictor(determined.clone())?, second.predictor(determined)?];
    let is_comparable = by_first.predicted_error_symbols() == by_second.predicted_error_symbols();
    let factor = coverage.factor();
    let error = |(step, reading): (u32, &ToolCentreReading)| {
        let position = &reading.position;
        let tip = |at: &Position, errors: &[ErrorTerm]| chain.tip_in_table(at, tool_centre, errors).mm;
        // The coordinates of the control are those of the machine while the rotary axes are at zero.
        let at_zero = position.filter_axes(Axis::is_linear);
        let by_values = tip(position, &all) - (tip(&at_zero, &all) - tip(&at_zero, &[]));
        let deviation = by_values - Vector3::from(reading.tool_centre_mm);
        let [predicted, measured] = [&by_first, &by_second].map(|predictor| predictor.pose_error(position));
        let u_mm = predicted.u_tip_error_mm.zip_map(&measured.u_tip_error_mm, f64::hypot);
        ToolCentreError {
            step,
            position: position.clone(),
            control_deviation_mm: deviation.norm(),
            measured_mm: (measured.tip_error_mm + deviation).into(),
            prediction: is_comparable.then(|| ToolCentrePrediction {
                predicted_mm: predicted.tip_error_mm.into(),
                limit_mm: (u_mm * factor).add_scalar(MAX_CONTROL_DEVIATION_MM).into(),
            }),
        }
    };
    Ok(second.tool_centre_readings().into_iter().map(error).collect())
}
