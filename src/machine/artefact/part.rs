//! The bodies of an artefact.

use nalgebra::Vector3;

use crate::frame::unit_vector;
use crate::record::artefact::{Artefact, Ball, Balls, Cylinder, DatumCylinder};

/// One body of an artefact.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// e.g. `artefact`, `ball 3`, `stem of ball 3`.
    pub name: String,
    pub shape: Shape,
    /// Whether the probe may touch the body; false for a stem.
    pub touched: bool,
}

/// Shape of a body, table frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    Ball {
        centre: Vector3<f64>,
        radius: f64,
    },
    /// Cylinder between the centres of its two ends.
    Cylinder {
        from: Vector3<f64>,
        to: Vector3<f64>,
        radius: f64,
    },
}

impl Shape {
    /// Farthest extent of the body along the unit vector `up`, from the origin, mm.
    pub fn highest(&self, up: Vector3<f64>) -> f64 {
        match *self {
            Shape::Ball { centre, radius } => centre.dot(&up) + radius,
            Shape::Cylinder { from, to, radius } => {
                let axis = unit_vector(to - from).unwrap_or_default();
                // The rim contributes the component of `up` across the axis.
                from.dot(&up).max(to.dot(&up)) + radius * (up - axis * axis.dot(&up)).norm()
            }
        }
    }
}

/// All bodies of an artefact; those that the probe touches come first.
pub fn parts(artefact: &Artefact) -> Vec<Part> {
    match artefact {
        Artefact::Cylinder(cylinder) => vec![round(cylinder)],
        Artefact::Balls(Balls { balls, .. }) => {
            balls.iter().map(ball).chain(balls.iter().filter_map(stem)).collect()
        }
        Artefact::DatumCylinder(cylinder) => vec![datum(cylinder)],
        Artefact::None => Vec::new(),
    }
}

fn round(cylinder: &Cylinder) -> Part {
    let from = Vector3::from(cylinder.centre_mm);
    let axis = unit_vector(Vector3::from(cylinder.axis)).unwrap_or(Vector3::z());
    let (to, radius) = (from + axis * cylinder.height_mm, cylinder.radius_mm);
    Part { name: "artefact".to_owned(), shape: Shape::Cylinder { from, to, radius }, touched: true }
}

/// One cylinder that encloses all sections and the face.
fn datum(cylinder: &DatumCylinder) -> Part {
    let foot = Vector3::from(cylinder.centre_mm);
    let axis = unit_vector(Vector3::from(cylinder.axis)).unwrap_or(Vector3::z());
    let sections = || cylinder.sections.iter().chain(&cylinder.face);
    let height = sections().map(|section| section.z_mm).fold(0.0, f64::max);
    let radius = sections().map(|section| section.radius_mm).fold(0.0, f64::max);
    let shape = Shape::Cylinder { from: foot, to: foot + axis * height, radius };
    Part { name: "artefact".to_owned(), shape, touched: false }
}

fn ball(ball: &Ball) -> Part {
    let (centre, radius) = (Vector3::from(ball.centre_mm), ball.radius_mm);
    Part { name: format!("ball {}", ball.id), shape: Shape::Ball { centre, radius }, touched: true }
}

fn stem(ball: &Ball) -> Option<Part> {
    let from = Vector3::from(ball.centre_mm);
    let to = from + unit_vector(Vector3::from(ball.stem)).unwrap_or_default() * ball.stem_length_mm;
    let radius = ball.stem_radius_mm;
    let declared = radius > 0.0 && from != to;
    declared.then(|| Part {
        name: format!("stem of ball {}", ball.id),
        shape: Shape::Cylinder { from, to, radius },
        touched: false,
    })
}
