//! Poses of table and tool at one moment, with all errors.

use nalgebra::{Point3, Vector3};

use machine::frame::Pose;

/// Poses in the machine frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MachinePose {
    pub table: Pose,
    pub spindle: Pose,
    /// Shift of the tool against the table.
    pub shift: Vector3<f64>,
}

impl MachinePose {
    /// Transforms a point of the spindle frame into the table frame.
    pub fn to_table_point(self, point: Vector3<f64>) -> Vector3<f64> {
        let in_machine = self.spindle * Point3::from(point) + self.shift;
        self.table.inverse_transform_point(&in_machine).coords
    }

    /// Transforms a direction of the spindle frame into the table frame.
    pub fn to_table_direction(self, direction: Vector3<f64>) -> Vector3<f64> {
        self.table.inverse_transform_vector(&(self.spindle * direction))
    }

    /// Transforms a direction of the table frame into the spindle frame.
    pub fn to_spindle_direction(self, direction: Vector3<f64>) -> Vector3<f64> {
        self.spindle.inverse_transform_vector(&(self.table * direction))
    }
}
