//! Points with their frame in the type, so that a table point is never added to a machine point.

use std::marker::PhantomData;

use nalgebra::{IsometryMatrix3, Vector3};

/// Frame of the workpiece table: coincides with the machine frame when all axes are at zero. The machine frame has its
/// origin at the zero of the machine coordinates, and the directions of X, Y, Z after ISO 841.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableFrame;
/// Frame of the spindle nose: origin at the spindle datum, rotating with the spindle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpindleFrame;

/// Pose of one frame in another: rotation matrix and translation, mm. It transforms points of the first frame into
/// the second.
pub type Pose = IsometryMatrix3<f64>;

/// `vector` scaled to length 1; `None` if its length is 0 or not finite.
pub fn unit_vector(vector: Vector3<f64>) -> Option<Vector3<f64>> {
    let length = vector.norm();
    (length > 0.0 && length.is_finite()).then(|| vector / length)
}

/// Two unit vectors, right and up, at right angles to the unit vector `along` and to each other; right, up and
/// `along` are right-handed.
pub fn perpendicular_directions(along: Vector3<f64>) -> [Vector3<f64>; 2] {
    let mut aside = Vector3::zeros();
    aside[along.iamin()] = 1.0;
    let right = aside.cross(&along).normalize();
    [right, along.cross(&right)]
}

/// A point in frame `F`, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point<F> {
    pub mm: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Point<F> {
    pub fn new(x: f64, y: f64, z: f64) -> Self {
        Self::from_vec(Vector3::new(x, y, z))
    }

    pub fn from_vec(mm: Vector3<f64>) -> Self {
        Self { mm, frame: PhantomData }
    }
}
