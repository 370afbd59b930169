//! The bodies of an artefact.

use nalgebra::Vector3;

use crate::frame::unit_vector;
use crate::record::artefact::{Artefact, Ball, Balls, Cylinder, DatumCylinder};

/// One body of an artefact.
#[derive(Debug, Clone, PartialEq)]
pub struct ArtefactBody {
    /// e.g. `artefact`, `ball 3`, `stem of ball 3`.
    pub name: String,
    pub shape: BodyShape,
    /// Whether the probe may touch the body; false for a stem and for a datum cylinder.
    pub is_touchable: bool,
}

/// Shape of a body, table frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BodyShape {
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

impl BodyShape {
    /// Farthest extent of the body along the unit vector `up`, from the origin, mm.
    pub fn max_extent_along(&self, up: Vector3<f64>) -> f64 {
        match *self {
            BodyShape::Ball { centre, radius } => centre.dot(&up) + radius,
            BodyShape::Cylinder { from, to, radius } => {
                let axis = unit_vector(to - from).unwrap_or_default();
                // The rim contributes the component of `up` across the axis.
                from.dot(&up).max(to.dot(&up)) + radius * (up - axis * axis.dot(&up)).norm()
            }
        }
    }

    /// Distance from the surface to a point, mm; negative inside the body.
    pub fn distance_to_surface_mm(&self, point: Vector3<f64>) -> f64 {
        match *self {
            BodyShape::Ball { centre, radius } => (point - centre).norm() - radius,
            BodyShape::Cylinder { from, to, radius } => {
                let axis = unit_vector(to - from).unwrap_or_default();
                let height = axis.dot(&(point - from));
                let beyond_side = (point - from - axis * height).norm() - radius;
                let beyond_end = (-height).max(height - (to - from).norm());
                beyond_side.max(0.0).hypot(beyond_end.max(0.0)) + beyond_side.max(beyond_end).min(0.0)
            }
        }
    }
}

/// Bodies of an artefact, without stems that are not declared; those that the probe touches come first.
pub fn artefact_bodies(artefact: &Artefact) -> Vec<ArtefactBody> {
    match artefact {
        Artefact::Cylinder(cylinder) => vec![cylinder_body(cylinder)],
        Artefact::Balls(Balls { balls, .. }) => {
            balls.iter().map(ball_body).chain(balls.iter().filter_map(stem_body)).collect()
        }
        Artefact::DatumCylinder(cylinder) => vec![datum_cylinder_body(cylinder)],
        Artefact::None => Vec::new(),
    }
}

fn cylinder_body(cylinder: &Cylinder) -> ArtefactBody {
    let from = Vector3::from(cylinder.foot_mm);
    let axis = unit_vector(Vector3::from(cylinder.axis)).unwrap_or(Vector3::z());
    let (to, radius) = (from + axis * cylinder.height_mm, cylinder.radius_mm);
    ArtefactBody { name: "artefact".to_owned(), shape: BodyShape::Cylinder { from, to, radius }, is_touchable: true }
}

/// One cylinder that encloses all sections and the face.
fn datum_cylinder_body(cylinder: &DatumCylinder) -> ArtefactBody {
    let foot = Vector3::from(cylinder.foot_mm);
    let axis = unit_vector(Vector3::from(cylinder.axis)).unwrap_or(Vector3::z());
    let sections = || cylinder.sections.iter().chain(&cylinder.face);
    let height = sections().map(|section| section.z_mm).fold(0.0, f64::max);
    let radius = sections().map(|section| section.radius_mm).fold(0.0, f64::max);
    let shape = BodyShape::Cylinder { from: foot, to: foot + axis * height, radius };
    ArtefactBody { name: "artefact".to_owned(), shape, is_touchable: false }
}

fn ball_body(ball: &Ball) -> ArtefactBody {
    let (centre, radius) = (Vector3::from(ball.centre_mm), ball.radius_mm);
    ArtefactBody { name: format!("ball {}", ball.id), shape: BodyShape::Ball { centre, radius }, is_touchable: true }
}

/// Stem of a ball; `None`: not declared, that is, radius or length is 0.
fn stem_body(ball: &Ball) -> Option<ArtefactBody> {
    let from = Vector3::from(ball.centre_mm);
    let to = from + unit_vector(Vector3::from(ball.stem)).unwrap_or_default() * ball.stem_length_mm;
    let radius = ball.stem_radius_mm;
    let is_declared = radius > 0.0 && from != to;
    let (name, shape) = (format!("stem of ball {}", ball.id), BodyShape::Cylinder { from, to, radius });
    is_declared.then_some(ArtefactBody { name, shape, is_touchable: false })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_to_a_ball_and_a_cylinder_agree_with_distances_by_hand() {
        let point = |x, z| Vector3::new(x, 0.0, z);
        let ball = BodyShape::Ball { centre: point(0.0, 5.0), radius: 2.0 };
        let cylinder = BodyShape::Cylinder { from: point(0.0, 0.0), to: point(0.0, 30.0), radius: 10.0 };
        // Outside and inside of the ball; beside, above, diagonally above the rim, inside near the side and near the
        // end.
        let cases = [
            (ball, point(3.0, 9.0), 3.0),
            (ball, point(0.0, 4.0), -1.0),
            (cylinder, point(-12.5, 15.0), 2.5),
            (cylinder, point(4.0, 31.0), 1.0),
            (cylinder, point(13.0, -4.0), 5.0),
            (cylinder, point(9.0, 15.0), -1.0),
            (cylinder, point(1.0, 29.5), -0.5),
        ];
        for (body, point, distance_mm) in cases {
            assert!((body.distance_to_surface_mm(point) - distance_mm).abs() < 1e-12, "{body:?} {point}");
        }
    }
}
