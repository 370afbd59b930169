//! Points that know their frame, so that a table point is never added to a machine point.

use std::marker::PhantomData;

use glam::DVec3;

/// Machine frame: origin at the nominal intersection (or foot of the common normal) of the rotary
/// axes, directions of X, Y, Z after ISO 841.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Machine;
/// Frame of the workpiece table: coincides with the machine frame when all axes stand at zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Table;
/// Frame of the spindle nose: origin at the spindle datum, turned with the spindle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spindle;

/// A point in frame `F`, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point<F> {
    pub mm: DVec3,
    frame: PhantomData<F>,
}

impl<F> Point<F> {
    pub fn new(x: f64, y: f64, z: f64) -> Self {
        Self::from_vec(DVec3::new(x, y, z))
    }

    pub fn from_vec(mm: DVec3) -> Self {
        Self { mm, frame: PhantomData }
    }
}
