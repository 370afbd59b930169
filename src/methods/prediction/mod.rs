//! Error of the tool at any pose in the working volume, from the errors of an estimate.

mod slices;
#[cfg(test)]
mod tests;
mod volume;
mod workpiece;

pub use slices::Slice;
pub use volume::VolumeError;
pub use workpiece::{WorkpieceFrame, WorkpiecePoint};

use std::collections::BTreeMap;

use faer::Mat;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::Refused;
use crate::identification::KnownErrors;
use machine::frame::{Point, Spindle};
use machine::kinematics::{Chain, KinematicsError};
use machine::record::estimate::Estimate;
use machine::record::machine::Machine;
use machine::{Axis, Position};

/// Distance along the tool from the tip to the second point from which the error of the direction is
/// computed, mm.
const ALONG_MM: f64 = 256.0;

const EXTRAPOLATE: &str = "leave the pose out, or ask for extrapolation (--extrapolate)";

/// Errors at one pose, in the table frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseError {
    /// True minus nominal position of the tip, minus the same at the work zero, mm.
    pub tip_mm: Vector3<f64>,
    pub u_tip_mm: Vector3<f64>,
    /// True minus nominal direction of the tool, from its tip to the spindle, rad. The work zero has no
    /// effect on it.
    pub direction: Vector3<f64>,
    pub u_direction: Vector3<f64>,
}

/// Error of the tip relative to the work zero in the table frame, mm, and its derivatives by the errors of
/// the axes.
#[derive(Debug, Clone)]
pub struct TipError {
    mm: Vector3<f64>,
    columns: Vec<Vector3<f64>>,
}

/// Pose of the work zero, where the tip has no error by definition.
#[derive(Debug, Clone, PartialEq)]
pub enum WorkZero {
    /// Set once, with the tip on the origin of the table and all rotary axes at 0. From there tool centre
    /// point control follows the workpiece.
    OnTable,
    /// Set once, at this pose.
    At(Position),
    /// Without tool centre point control: set again at each position of the rotary axes, with the tip on the
    /// origin of the table.
    EachTime,
}

pub struct Predictor<'a> {
    chain: Chain,
    known: KnownErrors<'a>,
    tip: Point<Spindle>,
    /// Ranges of the axes over which the estimate was measured, mm and degrees; empty: unknown.
    measured: &'a BTreeMap<Axis, [f64; 2]>,
    /// Pose of the work zero. `None`: a work zero for each position of the rotary axes.
    zero_at: Option<Position>,
    /// Displacement at the work zero.
    zero: Option<Displacement>,
}

/// Displacement of a point in the table frame, and its derivatives by the errors.
type Displacement = (Vector3<f64>, Vec<Vector3<f64>>);

impl<'a> Predictor<'a> {
    /// # Errors
    /// The machine has no kinematics; the estimate has no errors of its axes.
    pub fn new(machine: &Machine, estimate: &'a Estimate, zero: WorkZero) -> Result<Self, Refused> {
        let chain = Chain::new(machine)?;
        let known = KnownErrors::of(estimate, &chain)?;
        let tip = Point::from_vec(Vector3::from(machine.tool_mm));
        let on_table = on_table(&chain, tip, &Position::new())?;
        let zero_at = match zero {
            WorkZero::OnTable => Some(on_table),
            WorkZero::At(zero) => Some(zero),
            WorkZero::EachTime => None,
        };
        let measured = &estimate.measured;
        Ok(Self { chain, known, tip, measured, zero_at, zero: None }.zeroed())
    }

    fn zeroed(mut self) -> Self {
        self.zero = self.zero_at.as_ref().map(|zero| self.of_point(zero, self.tip));
        self
    }

    /// The machine after a correction of the errors `symbols` by their estimated values. The uncertainty of
    /// these values remains.
    ///
    /// # Errors
    /// A symbol is not an error of the estimate.
    pub fn corrected(mut self, symbols: &[&str]) -> Result<Self, Refused> {
        for symbol in symbols {
            let place = self.known.symbols.iter().position(|known| known == symbol);
            let place = place.ok_or_else(|| {
                Refused::new(
                    format!("{symbol} is no error of an axis in the estimate"),
                    format!("name some of {}", self.known.symbols.join(", ")),
                )
            })?;
            self.known.errors[place].value = 0.0;
        }
        Ok(self.zeroed())
    }

    /// Errors that the prediction includes, and what it does not include, in words.
    pub fn model_in_words(&self) -> String {
        format!(
            "by {} of the estimate of {}; all other errors of the machine count as 0, without uncertainty",
            self.known.symbols.join(", "),
            self.known.estimate.method
        )
    }

    /// Symbols of the axis errors in the estimate.
    pub fn symbols(&self) -> &[&'a str] {
        &self.known.symbols
    }

    /// Displacement at the work zero.
    fn zero(&self, at: &Position) -> Displacement {
        self.zero.clone().unwrap_or_else(|| {
            // X, Y, Z that are linearly independent with all axes at 0 are so everywhere.
            let zero = on_table(&self.chain, self.tip, at).unwrap_or_default();
            self.of_point(&at.updated_by(&zero), self.tip)
        })
    }

    /// Displacement of a point of the tool in the table frame, and its derivatives by the errors.
    fn of_point(&self, at: &Position, point: Point<Spindle>) -> Displacement {
        let Self { chain, known, .. } = self;
        let off =
            chain.tip_in_table(at, point, &known.errors).mm - chain.tip_in_table(at, point, &[]).mm;
        (off, chain.jacobian(at, point, &known.errors, &known.parameters()))
    }

    /// Checks that a pose lies within the ranges over which the estimate was measured. An axis that the pose
    /// does not name is at 0.
    ///
    /// # Errors
    /// An axis is outside its range; the estimate does not state the ranges.
    pub fn check(&self, at: &Position) -> Result<(), Refused> {
        self.check_ranges()?;
        for (axis, value) in at.iter().filter(|(axis, _)| !self.measured.contains_key(axis)) {
            Refused::unless(
                value == 0.0,
                format!(
                    "{axis} {:.3} was not measured: the estimate has no range of {axis}",
                    axis.to_edge(value)
                ),
                EXTRAPOLATE,
            )?;
        }
        for (axis, [least, most]) in self.measured {
            let value = axis.to_edge(at.get(*axis).unwrap_or_default());
            Refused::unless(
                (*least..=*most).contains(&value),
                format!(
                    "{axis} {value:.3} is outside {least:.3} to {most:.3}, over which the estimate was measured"
                ),
                EXTRAPOLATE,
            )?;
        }
        Ok(())
    }

    fn check_ranges(&self) -> Result<(), Refused> {
        Refused::unless(
            !self.measured.is_empty(),
            "the estimate does not say over which ranges of the axes it was measured",
            "identify it again from its run with this version, or ask for extrapolation (--extrapolate)",
        )
    }

    pub fn at(&self, at: &Position) -> PoseError {
        self.with_direction(at, &self.tip_at(at))
    }

    fn with_direction(&self, at: &Position, tip: &TipError) -> PoseError {
        let above = Point::from_vec(self.tip.mm + Vector3::z() * ALONG_MM);
        let (above, columns) = self.of_point(at, above);
        // The work zero does not affect a direction.
        let (zero, zero_columns) = self.zero(at);
        let own = tip.columns.iter().zip(&zero_columns);
        let turned: Vec<Vector3<f64>> = columns
            .iter()
            .zip(own)
            .map(|(above, (tip, zero))| (above - tip - zero) / ALONG_MM)
            .collect();
        PoseError {
            tip_mm: tip.mm,
            u_tip_mm: uncertainty(&tip.columns, &self.known.covariance),
            direction: (above - tip.mm - zero) / ALONG_MM,
            u_direction: uncertainty(&turned, &self.known.covariance),
        }
    }

    fn tip_at(&self, at: &Position) -> TipError {
        let (tip, columns) = self.of_point(at, self.tip);
        let (zero, zero_columns) = self.zero(at);
        TipError { mm: tip - zero, columns: less(&columns, &zero_columns) }
    }

    /// The error of the tip at each pose, computed in parallel.
    pub fn tips(&self, poses: &[Position]) -> Vec<TipError> {
        poses.par_iter().map(|at| self.tip_at(at)).collect()
    }

    /// The error of each pose, from the error of its tip.
    pub fn with_directions(&self, poses: &[Position], tips: &[TipError]) -> Vec<PoseError> {
        poses.par_iter().zip(tips).map(|(at, tip)| self.with_direction(at, tip)).collect()
    }
}

/// X, Y, Z that move the tip to the origin of the table.
fn on_table(
    chain: &Chain,
    tip: Point<Spindle>,
    others: &Position,
) -> Result<Position, KinematicsError> {
    chain.linear_axes_for(Point::from_vec(Vector3::zeros()), tip, others, &[])
}

fn less(columns: &[Vector3<f64>], zero: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    columns.iter().zip(zero).map(|(column, zero)| column - zero).collect()
}

/// Standard uncertainty of each coordinate: √(J·C·Jᵀ).
fn uncertainty(columns: &[Vector3<f64>], covariance: &Mat<f64>) -> Vector3<f64> {
    let mut variance = Vector3::zeros();
    for (i, one) in columns.iter().enumerate() {
        for (j, other) in columns.iter().enumerate() {
            variance += one.component_mul(other) * covariance[(i, j)];
        }
    }
    variance.map(|variance: f64| variance.max(0.0).sqrt())
}
