//! Whether touches have confirmed where the machine stands.

use nalgebra::{Matrix3, Vector3};

use machine::Position;
use machine::record::plan::{Scan, Step, StepKind};

/// Determinant of the sum of the normals' dyads (1 for three at right angles) from which on they
/// count as independent: two at right angles and a third that leaves their plane by 18 degrees.
const INDEPENDENT: f64 = 0.1;

/// From where a block goes to the part.
#[derive(Debug, Clone, Copy, Default)]
pub struct Start<'a> {
    /// Where the machine stands; `None` if nobody knows, then Z goes to its upper end first.
    pub stands: Option<&'a Position>,
    /// What touches have confirmed since the control was prepared.
    pub confirmed: Confirmed,
}

/// The directions in which touches have met the part where it is stated, since the control was
/// prepared: a touch is no longer than the range in which the part may stand, and a run holds where
/// one of them meets nothing, or anything else meets something. The default: none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Confirmed {
    dyads: Matrix3<f64>,
}

impl Default for Confirmed {
    fn default() -> Self {
        Self { dyads: Matrix3::zeros() }
    }
}

impl Confirmed {
    /// All directions.
    pub fn all() -> Self {
        Self { dyads: Matrix3::identity() }
    }

    /// Along three independent normals.
    pub fn is_all(&self) -> bool {
        self.dyads.determinant() >= INDEPENDENT
    }

    /// Along any normal: the probe has shown that it lives.
    pub fn is_begun(&self) -> bool {
        self.dyads.trace() > 0.0
    }

    /// After `step` was measured. A sensor that has seen the artefact within its range at all points
    /// of a scan has confirmed it in all directions: its method refuses an artefact that is found elsewhere than
    /// stated. Where only rotary axes turn nothing is confirmed of the linear ones. A person at the machine may
    /// have moved it.
    pub fn after(self, step: &Step) -> Self {
        let normal = Vector3::from(step.normal);
        match step.kind {
            StepKind::Prompt => Self::default(),
            _ if step.scan.as_ref().is_some_and(Scan::turns_only) => self,
            _ if step.scan.is_some() => Self::all(),
            _ => Self { dyads: self.dyads + normal * normal.transpose() },
        }
    }
}
