//! Where table and tool stand at one moment, with all errors.

use glam::{DAffine3, DVec3};

/// Machine frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stand {
    pub table: DAffine3,
    pub spindle: DAffine3,
    /// Of the tool against the table.
    pub shift: DVec3,
}

impl Stand {
    /// A point of the spindle frame, in the table frame.
    pub fn on_table(&self, point: DVec3) -> DVec3 {
        let in_machine = self.spindle.transform_point3(point) + self.shift;
        self.table.matrix3.transpose() * (in_machine - self.table.translation)
    }

    /// A direction of the spindle frame, in the table frame.
    pub fn turned_to_table(&self, direction: DVec3) -> DVec3 {
        self.table.matrix3.transpose() * (self.spindle.matrix3 * direction)
    }

    /// A direction of the table frame, in the spindle frame.
    pub fn turned_to_spindle(&self, direction: DVec3) -> DVec3 {
        self.spindle.matrix3.transpose() * (self.table.matrix3 * direction)
    }
}
