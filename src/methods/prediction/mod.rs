//! Error of the tool at any pose in the working volume, from the errors of an estimate.

mod error_slices;
#[cfg(test)]
mod tests;
mod volume_errors;
mod workpiece_points;

pub use error_slices::ErrorSlice;
pub use volume_errors::{VOLUMETRIC_ERROR_SYMBOL, VolumeError};
pub use workpiece_points::{PointInWorkpieceFrame, WorkpieceTransform};

use std::collections::BTreeMap;

use faer::Mat;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::MethodRefusal;
use crate::identification::{KnownErrors, SpindlePosition, StatedStylusUncertainty, UndeterminedSpindleComponent};
use machine::frame::{Point, SpindleFrame};
use machine::kinematics::{ErrorTerm, KinematicChain, KinematicsError};
use machine::record::estimate::Estimate;
use machine::record::machine::Machine;
use machine::record::plan::Plan;
use machine::{Axis, Position};

/// Distance along the tool from the tip to the second point from which the error of the direction is
/// computed, mm.
const DIRECTION_BASE_MM: f64 = 256.0;

const EXTRAPOLATION_REMEDY: &str = "omit the pose, or allow extrapolation (--extrapolate)";

/// Errors at one pose, in the table frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseError {
    /// True minus nominal position of the tip, minus the same at the work zero, mm.
    pub tip_error_mm: Vector3<f64>,
    /// Standard uncertainty of each coordinate of the tip error, mm.
    pub u_tip_error_mm: Vector3<f64>,
    /// True minus nominal direction of the tool, from its tip to the spindle, rad. The work zero has no effect on the
    /// direction.
    pub direction_error_rad: Vector3<f64>,
    /// Standard uncertainty of each component of the direction error, rad.
    pub u_direction_error_rad: Vector3<f64>,
}

/// Error of the tip relative to the work zero in the table frame, mm, and its derivatives by the errors of
/// the axes.
#[derive(Debug, Clone)]
pub struct TipError {
    error_mm: Vector3<f64>,
    /// Derivative by each error of the estimate.
    derivatives: Vec<Vector3<f64>>,
}

/// Pose of the work zero, where the tip has no error by definition.
#[derive(Debug, Clone, PartialEq)]
pub enum WorkZero {
    /// Set once, with the tip on the origin of the table and all rotary axes at 0. From there tool centre
    /// point control follows the workpiece.
    TableOrigin,
    /// Set once, at this pose.
    Pose(Position),
    /// Without tool centre point control: set again at each position of the rotary axes, with the tip on the
    /// origin of the table.
    EachRotaryPosition,
}

/// Predicts the error of the tool at any pose from the axis errors of an estimate, relative to a work zero.
pub struct ErrorPredictor<'a> {
    chain: KinematicChain,
    known_errors: KnownErrors<'a>,
    /// Directions in which the estimate does not give the position of the spindle. The spindle is assumed to have no
    /// error in these directions.
    undetermined_spindle_components: Vec<UndeterminedSpindleComponent>,
    /// Errors that the control takes into account: their effect is subtracted.
    compensated_errors: Vec<ErrorTerm>,
    /// Nominal stylus tip.
    tip: Point<SpindleFrame>,
    /// Ranges of the axes over which the estimate was measured, mm and degrees. Empty: the ranges are unknown.
    measured_ranges: &'a BTreeMap<Axis, [f64; 2]>,
    /// Pose of the work zero. `None`: a work zero for each position of the rotary axes.
    work_zero: Option<Position>,
    /// Displacement of the tip at the work zero. `None`: each position of the rotary axes has its own work zero.
    work_zero_displacement: Option<DisplacementWithDerivatives>,
}

/// Displacement of a point in the table frame, mm, and its derivatives by the errors of the estimate.
type DisplacementWithDerivatives = (Vector3<f64>, Vec<Vector3<f64>>);

impl<'a> ErrorPredictor<'a> {
    /// # Errors
    /// The machine has no kinematics; the estimate has no errors of its axes.
    pub fn new(
        machine: &Machine,
        stylus: StatedStylusUncertainty,
        estimate: &'a Estimate,
        zero: WorkZero,
    ) -> Result<Self, MethodRefusal> {
        let chain = KinematicChain::new(machine)?;
        let known_errors = KnownErrors::from_estimate(estimate, &chain)?;
        let spindle = SpindlePosition::new(estimate, machine, &chain, &known_errors, stylus);
        let known_errors = known_errors.with_spindle_position(&spindle);
        let tip = Point::from_vec(Vector3::from(machine.tool_mm));
        let table_origin = linear_axes_at_table_origin(&chain, tip, &Position::new())?;
        let work_zero = match zero {
            WorkZero::TableOrigin => Some(table_origin),
            WorkZero::Pose(zero) => Some(zero),
            WorkZero::EachRotaryPosition => None,
        };
        let measured_ranges = &estimate.measured_ranges;
        let undetermined_spindle_components = spindle.undetermined;
        Ok(Self {
            chain,
            known_errors,
            undetermined_spindle_components,
            compensated_errors: Vec::new(),
            tip,
            measured_ranges,
            work_zero,
            work_zero_displacement: None,
        }
        .with_updated_work_zero_displacement())
    }

    /// For the machine and the stylus of a plan, with the work zero at the origin of the table.
    ///
    /// # Errors
    /// As for [`ErrorPredictor::new`].
    pub fn of_plan(plan: &Plan, estimate: &'a Estimate) -> Result<Self, MethodRefusal> {
        let stylus = StatedStylusUncertainty::new(&plan.probe, &plan.assumed);
        Self::new(&plan.machine, stylus, estimate, WorkZero::TableOrigin)
    }

    fn with_updated_work_zero_displacement(mut self) -> Self {
        self.work_zero_displacement = self.work_zero.as_ref().map(|zero| self.point_displacement(zero, self.tip));
        self
    }

    /// The machine after a correction of the errors `symbols` by their estimated values: these errors count as 0. The
    /// uncertainty of the estimated values remains.
    ///
    /// # Errors
    /// A symbol is not an error of the estimate.
    pub fn with_corrected_errors(mut self, symbols: &[&str]) -> Result<Self, MethodRefusal> {
        for symbol in symbols {
            let index = self.known_errors.symbols.iter().position(|known| known == symbol);
            let index = index.ok_or_else(|| {
                MethodRefusal::new(
                    format!("{symbol} is not an axis error of the estimate"),
                    format!("choose from {}", self.known_errors.symbols.join(", ")),
                )
            })?;
            self.known_errors.errors[index].value = 0.0;
        }
        Ok(self.with_updated_work_zero_displacement())
    }

    /// The machine with a control that takes `errors` into account.
    pub fn with_compensated_errors(self, errors: Vec<ErrorTerm>) -> Self {
        Self { compensated_errors: errors, ..self }.with_updated_work_zero_displacement()
    }

    /// Errors that the prediction includes, and what it does not include, in words.
    pub fn describe_model(&self) -> String {
        let undetermined =
            self.undetermined_spindle_components.chunk_by(|one, other| one.reason == other.reason).map(|group| {
                let components: Vec<String> = group.iter().map(|position| position.component.to_string()).collect();
                let (reason, remedy) = group.first().map_or(("", ""), |first| (&first.reason, &first.remedy));
                format!("; the spindle is assumed error-free in {}, because {reason}: {remedy}", components.join(", "))
            });
        format!(
            "by {} of the estimate of {}; all other errors of the machine count as 0, without uncertainty{}",
            self.known_errors.symbols.join(", "),
            self.known_errors.estimate.method,
            undetermined.collect::<String>()
        )
    }

    /// Symbols of all errors that the prediction uses: the axis errors of the estimate, and `tool_x`, `tool_y`,
    /// `tool_z` where these give the position of the spindle.
    pub fn predicted_error_symbols(&self) -> &[&'a str] {
        &self.known_errors.symbols
    }

    /// Displacement of the tip at the work zero that applies to the pose `at`.
    fn displacement_at_work_zero(&self, at: &Position) -> DisplacementWithDerivatives {
        self.work_zero_displacement.clone().unwrap_or_else(|| {
            // If X, Y, Z are linearly independent with all axes at 0, they are linearly independent at every position.
            let zero = linear_axes_at_table_origin(&self.chain, self.tip, at).unwrap_or_default();
            self.point_displacement(&at.updated_by(&zero), self.tip)
        })
    }

    /// Position of a point of the tool in the table frame with the errors of the estimate, minus that with the
    /// compensated errors, and its derivatives by the errors of the estimate.
    fn point_displacement(&self, at: &Position, point: Point<SpindleFrame>) -> DisplacementWithDerivatives {
        let Self { chain, known_errors, compensated_errors, .. } = self;
        let displacement = chain.tip_in_table(at, point, &known_errors.errors).mm
            - chain.tip_in_table(at, point, compensated_errors).mm;
        (displacement, chain.error_jacobian(at, point, &known_errors.errors, &known_errors.parameters()))
    }

    /// Checks that a pose lies within the ranges over which the estimate was measured. An axis that the pose does not
    /// name is at 0.
    ///
    /// # Errors
    /// An axis is outside its range; an axis without a range is not at 0; the estimate does not state the ranges.
    pub fn check_measured_range(&self, at: &Position) -> Result<(), MethodRefusal> {
        self.check_has_measured_ranges()?;
        for (axis, value) in at.iter().filter(|(axis, _)| !self.measured_ranges.contains_key(axis)) {
            MethodRefusal::require(
                value == 0.0,
                format!("{axis} {:.3} was not measured: the estimate has no range of {axis}", axis.to_mm_or_deg(value)),
                EXTRAPOLATION_REMEDY,
            )?;
        }
        for (axis, [least, most]) in self.measured_ranges {
            let value = axis.to_mm_or_deg(at.get(*axis).unwrap_or_default());
            MethodRefusal::require(
                (*least..=*most).contains(&value),
                format!(
                    "{axis} {value:.3} is outside {least:.3} to {most:.3}, the measured range of \
                     the estimate"
                ),
                EXTRAPOLATION_REMEDY,
            )?;
        }
        Ok(())
    }

    fn check_has_measured_ranges(&self) -> Result<(), MethodRefusal> {
        MethodRefusal::require(
            !self.measured_ranges.is_empty(),
            "the estimate does not contain the measured ranges of the axes",
            "identify the run again with this version, or allow extrapolation (--extrapolate)",
        )
    }

    /// Errors of tip and direction at the pose `at`, with their standard uncertainties.
    pub fn pose_error(&self, at: &Position) -> PoseError {
        self.pose_error_from_tip(at, &self.tip_error(at))
    }

    fn pose_error_from_tip(&self, at: &Position, tip: &TipError) -> PoseError {
        let above = Point::from_vec(self.tip.mm + Vector3::z() * DIRECTION_BASE_MM);
        let (above, columns) = self.point_displacement(at, above);
        // The work zero does not affect a direction.
        let (zero, zero_columns) = self.displacement_at_work_zero(at);
        let own = tip.derivatives.iter().zip(&zero_columns);
        let turned: Vec<Vector3<f64>> =
            columns.iter().zip(own).map(|(above, (tip, zero))| (above - tip - zero) / DIRECTION_BASE_MM).collect();
        PoseError {
            tip_error_mm: tip.error_mm,
            u_tip_error_mm: standard_uncertainty(&tip.derivatives, &self.known_errors.covariance),
            direction_error_rad: (above - tip.error_mm - zero) / DIRECTION_BASE_MM,
            u_direction_error_rad: standard_uncertainty(&turned, &self.known_errors.covariance),
        }
    }

    /// Error of the tip at the pose `at` relative to the work zero.
    fn tip_error(&self, at: &Position) -> TipError {
        let (tip, columns) = self.point_displacement(at, self.tip);
        let (zero, zero_columns) = self.displacement_at_work_zero(at);
        TipError { error_mm: tip - zero, derivatives: subtract_columns(&columns, &zero_columns) }
    }

    /// The error of the tip at each pose, computed in parallel.
    pub fn tip_errors(&self, poses: &[Position]) -> Vec<TipError> {
        poses.par_iter().map(|at| self.tip_error(at)).collect()
    }

    /// The error of each pose, from the error of its tip.
    pub fn pose_errors(&self, poses: &[Position], tips: &[TipError]) -> Vec<PoseError> {
        poses.par_iter().zip(tips).map(|(at, tip)| self.pose_error_from_tip(at, tip)).collect()
    }
}

/// X, Y, Z that move the tip to the origin of the table frame, with the other axes at `others` and no errors.
fn linear_axes_at_table_origin(
    chain: &KinematicChain,
    tip: Point<SpindleFrame>,
    others: &Position,
) -> Result<Position, KinematicsError> {
    chain.solve_linear_axes(Point::from_vec(Vector3::zeros()), tip, others, &[])
}

fn subtract_columns(columns: &[Vector3<f64>], zero: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    columns.iter().zip(zero).map(|(column, zero)| column - zero).collect()
}

/// Standard uncertainty of each coordinate: √(J·C·Jᵀ).
fn standard_uncertainty(columns: &[Vector3<f64>], covariance: &Mat<f64>) -> Vector3<f64> {
    let mut variance = Vector3::zeros();
    for (i, first) in columns.iter().enumerate() {
        for (j, second) in columns.iter().enumerate() {
            variance += first.component_mul(second) * covariance[(i, j)];
        }
    }
    variance.map(|variance: f64| variance.max(0.0).sqrt())
}
