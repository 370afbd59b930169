//! Sag: deflection of the table as a tilt axis turns the weight of the part.

use nalgebra::{Rotation3, Translation3, Vector3};

use super::truth::{SagLaw, SagTerm};
use machine::frame::Pose;
use machine::{Axis, Position};

/// Sum of the deflections of the table by all `[[simulated.sag]]`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TableSag {
    terms: Vec<SagComponent>,
}

/// One `[[simulated.sag]]`, in mm and rad.
#[derive(Debug, Clone, PartialEq)]
struct SagComponent {
    axis: Axis,
    law: SagLaw,
    /// Displacement at an axis angle of 90°, machine frame.
    displacement_at_90_deg_mm: Vector3<f64>,
    /// Rotation vector at an axis angle of 90°, machine frame.
    rotation_at_90_deg_rad: Vector3<f64>,
}

impl TableSag {
    pub fn new(terms: &[SagTerm]) -> Self {
        let read = |term: &SagTerm| SagComponent {
            axis: term.axis,
            law: term.law,
            displacement_at_90_deg_mm: Vector3::from(term.um) * 1e-3,
            rotation_at_90_deg_rad: Vector3::from(term.urad) * 1e-6,
        };
        Self { terms: terms.iter().map(read).collect() }
    }

    /// Pose of the deflected table: shifted, and rotated about the position of its origin.
    pub fn deflected_table_pose(&self, table: Pose, axes: &Position) -> Pose {
        self.terms.iter().fold(table, |table, term| {
            let angle = axes.get_or_zero(term.axis);
            let share = match term.law {
                SagLaw::Sin => angle.sin(),
                SagLaw::OneMinusCos => 1.0 - angle.cos(),
            };
            let shift = Translation3::from(term.displacement_at_90_deg_mm * share);
            let turn = Rotation3::new(term.rotation_at_90_deg_rad * share);
            Pose::from_parts(shift * table.translation, turn * table.rotation)
        })
    }
}
