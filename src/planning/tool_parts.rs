//! The tool as a stack of parts along Z, and their distance from bodies beside the path.

use std::f64::consts::PI;
use std::sync::LazyLock;

use nalgebra::{Vector2, Vector3};

use super::gjk::SupportMapping;
use super::obstacle_body::{ObstacleBody, SweptToolSpace, are_apart_by};
use machine::Axis;
use machine::record::machine::{Carrier, Solid};
use machine::record::plan::Plan;
use machine::record::sensor::Sensor;

/// Directions, seen from above, in which the distance of two bodies is evaluated.
static GAP_DIRECTIONS: LazyLock<[Vector2<f64>; 16]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let (sin, cos) = (PI * k as f64 / 8.0).sin_cos();
        Vector2::new(cos, sin)
    })
});
/// Accuracy of [`ToolPart::rise_until_clear_mm`], mm.
const CLEARANCE_RISE_ACCURACY_MM: f64 = 0.1;

/// One part of the tool: a cylinder along Z without an upper end.
#[derive(Debug, Clone)]
pub(super) struct ToolPart {
    pub name: String,
    /// Whether the probe detects its contact: ball and stem of the stylus.
    pub is_contact_detected: bool,
    /// Radius about the stylus ball's vertical line, mm; for a solid of the spindle, large enough for every
    /// orientation of S.
    radius: f64,
    /// Height of the lower end relative to the centre of the stylus ball, mm.
    bottom_height_mm: f64,
}

impl ToolPart {
    /// Space of the part on a path of the stylus ball that is raised by `rise`.
    fn swept_space(&self, path_ends: [Vector3<f64>; 2], rise: f64) -> SweptToolSpace {
        SweptToolSpace {
            bottom_centre_path_ends: path_ends.map(|at| at + Vector3::z() * (self.bottom_height_mm + rise)),
            radius: self.radius,
        }
    }

    /// Fast check: false if the part passes above the body or beside it.
    pub fn may_collide(&self, path_ends: &[Vector3<f64>; 2], body: &ObstacleBody, margin: f64) -> bool {
        let lowest = path_ends[0].z.min(path_ends[1].z) + self.bottom_height_mm;
        lowest < body.top_z() + margin && xy_gap_mm(path_ends, body) < self.radius + margin
    }

    /// Whether the part is `margin` clear of the body on the path; false if this cannot be proven.
    pub fn is_clear(&self, path_ends: [Vector3<f64>; 2], body: &ObstacleBody, margin: f64) -> bool {
        !self.may_collide(&path_ends, body, margin) || are_apart_by(&self.swept_space(path_ends, 0.0), body, margin)
    }

    /// Rise at which the lower end of the part is `margin` above the top of the body, mm; 0 if it is there already.
    pub fn rise_over_top_mm(&self, path_ends: &[Vector3<f64>; 2], body: &ObstacleBody, margin: f64) -> f64 {
        (body.top_z() + margin - self.bottom_height_mm - path_ends[0].z.min(path_ends[1].z)).max(0.0)
    }

    /// Rise at which the part is clear of the body by `margin`, mm, by bisection, rounded up; −∞ if clear already.
    pub fn rise_until_clear_mm(&self, path_ends: &[Vector3<f64>; 2], body: &ObstacleBody, margin: f64) -> f64 {
        if are_apart_by(&self.swept_space(*path_ends, 0.0), body, margin) {
            return f64::NEG_INFINITY;
        }
        let (mut low, mut high) = (0.0, self.rise_over_top_mm(path_ends, body, margin));
        while high - low > CLEARANCE_RISE_ACCURACY_MM {
            let middle = (low + high) / 2.0;
            let clear = are_apart_by(&self.swept_space(*path_ends, middle), body, margin);
            if clear { high = middle } else { low = middle }
        }
        high
    }
}

/// Lower bound of the distance of a body from a straight path in X and Y: the largest over all directions.
fn xy_gap_mm(path_ends: &[Vector3<f64>; 2], body: &ObstacleBody) -> f64 {
    let (points, radius) = body.hull_points_and_radius();
    let between = |u: &Vector2<f64>| {
        let near = points.iter().map(|p| p.xy().dot(u)).fold(f64::INFINITY, f64::min);
        near - path_ends[0].xy().dot(u).max(path_ends[1].xy().dot(u))
    };
    GAP_DIRECTIONS.iter().map(between).fold(f64::NEG_INFINITY, f64::max) - radius
}

/// Parts of the tool whose contact the probe does not detect: their maximum radius, and the height of the lowest
/// above the centre of the stylus ball, mm. `None` if none is declared.
pub(super) fn undetected_parts_radius_and_height_mm(plan: &Plan) -> Option<(f64, f64)> {
    let tool = tool_parts(plan);
    let undetected =
        tool.iter().filter(|part| !part.is_contact_detected).map(|part| (part.radius, part.bottom_height_mm));
    undetected.reduce(|(wide, low), (radius, bottom)| (wide.max(radius), low.min(bottom)))
}

/// Parts of the tool. Of the solids, only those that the spindle carries are included: the proof checks the other
/// solids of the tool side.
pub(super) fn tool_parts(plan: &Plan) -> Vec<ToolPart> {
    let probe = &plan.probe;
    let part = |name: &str, is_contact_detected, radius, bottom| {
        let name = name.to_owned();
        ToolPart { name, is_contact_detected, radius, bottom_height_mm: bottom }
    };
    let mut tool = vec![part("stylus ball", true, probe.ball_radius_mm, -probe.ball_radius_mm)];
    if probe.stem_radius_mm > 0.0 {
        tool.push(part("stylus stem", true, probe.stem_radius_mm, 0.0));
    }
    if probe.body_radius_mm > 0.0 {
        tool.push(part("probe body", false, probe.body_radius_mm, probe.stem_length_mm));
    }
    let tip = Vector3::from(plan.machine.tool_mm);
    let carried = |solid: &&Solid| matches!(solid.on, Carrier::Spindle | Carrier::Axis(Axis::S));
    for solid in plan.solids.iter().filter(carried) {
        let body = ObstacleBody::from_solid(solid);
        let (points, radius) = body.hull_points_and_radius();
        // The stylus may be beside the spindle's axis, and S turns it about that axis.
        let aside = |p: &Vector3<f64>| p.xy().norm() + tip.xy().norm();
        let wide = points.iter().map(aside).fold(0.0, f64::max) + radius;
        let bottom = body.support(-Vector3::z()).z - tip.z;
        tool.push(part(&solid.name, false, wide, bottom));
    }
    tool
}

/// Measuring range of `sensor`, as a cylinder along Z about the stylus ball at `tip` that covers every orientation
/// of the spindle.
pub(super) fn sensor_range_as_tool_part(sensor: &Sensor, tip: &Vector3<f64>) -> ToolPart {
    let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
    let ends = sensor.range_mm.map(|distance| zero + along * distance);
    let radius = ends.iter().map(|end| end.xy().norm()).fold(0.0, f64::max) + tip.xy().norm();
    let bottom = ends.iter().map(|end| end.z - tip.z).fold(f64::INFINITY, f64::min);
    ToolPart { name: sensor.name.clone(), is_contact_detected: false, radius, bottom_height_mm: bottom }
}
