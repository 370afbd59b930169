//! The tool as a stack of upright parts, and their distance from bodies beside the path.

use std::f64::consts::PI;
use std::sync::LazyLock;

use nalgebra::{Vector2, Vector3};

use super::gjk::Support;
use super::hull::{Body, ToolSweep, apart_by};
use machine::Axis;
use machine::record::machine::{Carrier, Solid};
use machine::record::plan::Plan;
use machine::record::sensor::Sensor;

/// Directions, seen from above, in which the distance of two bodies is evaluated.
static DIRECTIONS: LazyLock<[Vector2<f64>; 16]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let (sin, cos) = (PI * k as f64 / 8.0).sin_cos();
        Vector2::new(cos, sin)
    })
});
/// Accuracy of heights, mm.
const FOUND_WITHIN: f64 = 0.1;

/// Shape of one part of the tool, seen from below.
#[derive(Debug, Clone)]
pub(super) struct Element {
    pub name: String,
    /// Whether the probe detects its contact: ball and stem of the stylus.
    pub felt: bool,
    radius: f64,
    /// Height of the lower end relative to the centre of the stylus ball, mm.
    bottom: f64,
}

impl Element {
    /// Space of the part on a path of the stylus ball that is raised by `rise`.
    fn on(&self, way: [Vector3<f64>; 2], rise: f64) -> ToolSweep {
        ToolSweep {
            way: way.map(|at| at + Vector3::z() * (self.bottom + rise)),
            radius: self.radius,
        }
    }

    /// Fast check: false if the part passes above the body or beside it.
    pub fn might_meet(&self, way: &[Vector3<f64>; 2], body: &Body, margin: f64) -> bool {
        let lowest = way[0].z.min(way[1].z) + self.bottom;
        lowest < body.top() + margin && beside(way, body) < self.radius + margin
    }

    pub fn is_clear(&self, way: [Vector3<f64>; 2], body: &Body, margin: f64) -> bool {
        !self.might_meet(&way, body, margin) || apart_by(&self.on(way, 0.0), body, margin)
    }

    /// Rise at which the part is clear of the body by `margin`, mm; found by bisection and rounded up.
    pub fn rise(&self, way: &[Vector3<f64>; 2], body: &Body, margin: f64) -> f64 {
        if apart_by(&self.on(*way, 0.0), body, margin) {
            return f64::NEG_INFINITY;
        }
        let over = body.top() + margin - self.bottom - way[0].z.min(way[1].z);
        let (mut low, mut high) = (0.0, over.max(0.0));
        while high - low > FOUND_WITHIN {
            let middle = (low + high) / 2.0;
            let clear = apart_by(&self.on(*way, middle), body, margin);
            if clear { high = middle } else { low = middle }
        }
        high
    }
}

/// Lower bound of the distance of a body from a straight path, seen from above: the largest over all directions.
fn beside(way: &[Vector3<f64>; 2], body: &Body) -> f64 {
    let (points, radius) = body.points();
    let between = |u: &Vector2<f64>| {
        let near = points.iter().map(|p| p.xy().dot(u)).fold(f64::INFINITY, f64::min);
        near - way[0].xy().dot(u).max(way[1].xy().dot(u))
    };
    DIRECTIONS.iter().map(between).fold(f64::NEG_INFINITY, f64::max) - radius
}

/// Parts of the tool whose contact the probe does not detect: their maximum radius, and the height of the lowest
/// above the centre of the stylus ball, mm. `None` if none is declared.
pub(super) fn overhang(plan: &Plan) -> Option<(f64, f64)> {
    let tool = tool(plan);
    let unfelt = tool.iter().filter(|part| !part.felt).map(|part| (part.radius, part.bottom));
    unfelt.reduce(|(wide, low), (radius, bottom)| (wide.max(radius), low.min(bottom)))
}

/// Parts of the tool. Of the solids, only those that the spindle carries are included: the proof checks the other
/// solids of the tool side.
pub(super) fn tool(plan: &Plan) -> Vec<Element> {
    let probe = &plan.probe;
    let part = |name: &str, felt, radius, bottom| {
        let name = name.to_owned();
        Element { name, felt, radius, bottom }
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
        let body = Body::of(solid);
        let (points, radius) = body.points();
        // The stylus may be beside the spindle's axis, and S turns it about that axis.
        let aside = |p: &Vector3<f64>| p.xy().norm() + tip.xy().norm();
        let wide = points.iter().map(aside).fold(0.0, f64::max) + radius;
        let bottom = body.support(-Vector3::z()).z - tip.z;
        tool.push(part(&solid.name, false, wide, bottom));
    }
    tool
}

/// Measuring range of `sensor`, as an upright cylinder about the stylus ball at `tip` that covers every orientation
/// of the spindle.
pub(super) fn range(sensor: &Sensor, tip: &Vector3<f64>) -> Element {
    let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
    let ends = sensor.range_mm.map(|distance| zero + along * distance);
    let radius = ends.iter().map(|end| end.xy().norm()).fold(0.0, f64::max) + tip.xy().norm();
    let bottom = ends.iter().map(|end| end.z - tip.z).fold(f64::INFINITY, f64::min);
    Element { name: sensor.name.clone(), felt: false, radius, bottom }
}
