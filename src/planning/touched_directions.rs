//! Directions in which touches have verified the machine's position.

use nalgebra::{Matrix3, Vector3};

use machine::Position;
use machine::record::plan::{Scan, Step, StepKind};

/// Minimum determinant of the sum of the normals' dyads (1 for three at right angles) at which the normals count as
/// independent: two at right angles and a third that is inclined to their plane by 18 degrees.
const MIN_DETERMINANT_OF_INDEPENDENT_NORMALS: f64 = 0.1;

/// Start of a block that moves to the part.
#[derive(Debug, Clone, Copy, Default)]
pub struct BlockStart<'a> {
    /// Position of the machine; `None` if unknown: then Z moves to its upper end first.
    pub position: Option<&'a Position>,
    /// Directions in which touches have met the part since the control was prepared or the operator was last prompted.
    pub touched_directions: TouchedDirections,
}

/// Directions in which touches have met the part at its stated position since the control was prepared. Each contact
/// verifies the position along its normal: a touch is not longer than the range in which the part may be, and a run
/// stops when a touch meets nothing or any other move meets something. By default, there is no direction.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TouchedDirections {
    /// Sum of n·nᵀ over the unit normals n of the touches; the identity if all directions count as touched.
    normal_dyad_sum: Matrix3<f64>,
}

impl TouchedDirections {
    /// All directions.
    pub fn all() -> Self {
        Self { normal_dyad_sum: Matrix3::identity() }
    }

    /// Whether three independent directions were touched: the position is verified.
    pub fn has_three_independent_directions(&self) -> bool {
        self.normal_dyad_sum.determinant() >= MIN_DETERMINANT_OF_INDEPENDENT_NORMALS
    }

    /// Whether any direction was touched: the probe has shown that it works.
    pub fn has_any_direction(&self) -> bool {
        self.normal_dyad_sum.trace() > 0.0
    }

    /// Touched directions after `step` was measured. A sensor that has measured the artefact within its range at
    /// all points of a scan counts for all directions: its method refuses an artefact that is found at another
    /// position than stated. A scan that moves only rotary axes verifies nothing about the linear axes. A prompt
    /// clears all directions, because the operator may have moved the machine.
    pub fn after_step(self, step: &Step) -> Self {
        let normal = Vector3::from(step.normal);
        match step.kind {
            StepKind::Prompt => Self::default(),
            _ if step.scan.as_ref().is_some_and(Scan::is_rotary_only) => self,
            _ if step.scan.is_some() => Self::all(),
            _ => Self { normal_dyad_sum: self.normal_dyad_sum + normal * normal.transpose() },
        }
    }
}
