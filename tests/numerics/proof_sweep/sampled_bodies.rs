//! Balls on stems and a probe between them, represented by points.

use std::cell::OnceCell;

use machine::record::plan::Plan;
use serde_json::json;

use super::{
    Axes, Matrix, Point, RandomNumbers, Solid, TestMachine, length, map_point, map_point_back, relative_pose, subtract,
};

/// A rod with flat ends, or a ball, with its distance function.
#[derive(Clone)]
pub enum Body {
    Ball(Point, f64),
    Rod(Solid),
}

impl Body {
    fn rod(from: Point, to: Point, radius: f64) -> Self {
        Body::Rod(Solid { from, to, cylinder_radius: Some(radius) })
    }

    pub fn bounding_sphere(&self) -> (Point, f64) {
        match self {
            Body::Ball(centre, radius) => (*centre, *radius),
            Body::Rod(solid) => (solid.middle(), solid.bounding_radius()),
        }
    }

    /// Points, and a radius about each, that nearly cover the surface of the body.
    fn covering_points_and_radius(&self, spacing: f64) -> (Vec<Point>, f64) {
        match self {
            Body::Ball(centre, radius) => (vec![*centre], *radius),
            Body::Rod(solid) => (solid.surface_points(spacing), 0.0),
        }
    }

    fn distance(&self, p: Point) -> f64 {
        match self {
            Body::Ball(centre, radius) => length(subtract(p, *centre)) - radius,
            Body::Rod(solid) => solid.distance(p),
        }
    }
}

/// A body with its points, which are computed once, when another body comes near.
pub struct SampledBody<'a> {
    body: &'a Body,
    spacing: f64,
    points_and_radius: OnceCell<(Vec<Point>, f64)>,
}

impl<'a> SampledBody<'a> {
    pub fn new(body: &'a Body, spacing: f64) -> Self {
        Self { body, spacing, points_and_radius: OnceCell::new() }
    }

    /// Smallest of these distances over the body's points, minus the radius about them.
    fn min_distance_over_points(&self, of: impl Fn(Point) -> f64) -> f64 {
        let (points, radius) =
            self.points_and_radius.get_or_init(|| self.body.covering_points_and_radius(self.spacing));
        points.iter().map(|p| of(*p)).fold(f64::INFINITY, f64::min) - radius
    }
}

/// All bodies of a random machine, sampled.
pub struct SampledBodies<'a> {
    /// Ball, stem and body of the probe.
    pub stylus: [SampledBody<'a>; 3],
    /// Each ball with its stem.
    pub balls: Vec<[SampledBody<'a>; 2]>,
}

/// Bodies in the frames of the spindle and of the table.
pub struct RandomMachine {
    pub kind: TestMachine,
    /// Ball, stem and body of the probe.
    pub stylus: [Body; 3],
    /// Each ball with its stem.
    pub balls: Vec<[Body; 2]>,
    stem_directions: Vec<Point>,
    pub ball_uncertainty_mm: f64,
}

pub const STYLUS_TIP_MM: Point = [0.0, 0.0, -100.0];

impl RandomMachine {
    pub fn new(dice: &mut RandomNumbers, kind: TestMachine) -> Self {
        let [x, y, z] = STYLUS_TIP_MM;
        let stem = dice.uniform_rounded(30.0, 60.0);
        let high = |h: f64| [x, y, z + h];
        let stylus = [
            Body::Ball(STYLUS_TIP_MM, dice.uniform_rounded(1.0, 4.0)),
            Body::rod(STYLUS_TIP_MM, high(stem), dice.uniform_rounded(0.5, 1.0)),
            Body::rod(high(stem), high(stem + 30.0), dice.uniform_rounded(8.0, 25.0)),
        ];
        let count = dice.uniform(2.0, 5.0) as usize;
        let (mut balls, mut stems) = (Vec::new(), Vec::new());
        for _ in 0..count {
            let place = |dice: &mut RandomNumbers| dice.uniform_rounded(-80.0, 80.0);
            let centre = [place(dice), place(dice), dice.uniform_rounded(20.0, 90.0)];
            let radius = dice.uniform_rounded(5.0, 13.0);
            let lean = |dice: &mut RandomNumbers| dice.uniform_rounded(-0.7, 0.7);
            let way = [lean(dice), lean(dice), -1.0];
            let long = dice.uniform_rounded(20.0, 70.0) / length(way);
            let foot = std::array::from_fn(|i| centre[i] + long * way[i]);
            let stem = Body::rod(centre, foot, dice.uniform_rounded(1.0, 0.4 * radius));
            balls.push([Body::Ball(centre, radius), stem]);
            stems.push(way);
        }
        Self { kind, stylus, balls, stem_directions: stems, ball_uncertainty_mm: dice.uniform_rounded(0.0, 1.0) }
    }

    pub fn touch_plan(&self, [from, to]: [Axes; 2], normal: Point) -> Plan {
        let rod = |body: &Body| match body {
            Body::Rod(Solid { from, to, cylinder_radius: radius }) => (radius.unwrap(), length(subtract(*to, *from))),
            Body::Ball(_, radius) => (*radius, 0.0),
        };
        let balls = self.balls.iter().zip(&self.stem_directions).enumerate().map(|(k, (ball, way))| {
            let ((centre, radius), (stem, long)) = (ball[0].bounding_sphere(), rod(&ball[1]));
            json!({"id": k.to_string(), "centre_mm": centre, "radius_mm": radius, "stem": way,
                "stem_radius_mm": stem, "stem_length_mm": long})
        });
        let balls: Vec<_> = balls.collect();
        let ([ball, stem, body], at) =
            (self.stylus.each_ref().map(rod), |[x, y, z, b, c]: Axes| json!({"X": x, "Y": y, "Z": z, "B": b, "C": c}));
        serde_json::from_value(json!({
            "trued_plan": 1, "method": "test", "settings": {},
            "machine": {"name": "m", "topology": self.kind.topology(), "tool_mm": STYLUS_TIP_MM,
                "axes": self.kind.axes_json()},
            "probe": {"ball_radius_mm": ball.0, "stem_radius_mm": stem.0, "stem_length_mm": stem.1,
                "body_radius_mm": body.0, "body_length_mm": body.1},
            "artefact": {"kind": "balls", "balls": balls, "uncertainty_mm": self.ball_uncertainty_mm},
            "steps": [{"id": 0, "stage": 0, "kind": "touch", "label": "t", "from": at(from),
                "to": at(to), "feed_mm_min": 30.0, "sensor": "probe", "normal": normal}],
        }))
        .unwrap()
    }

    pub fn sample_bodies(&self, spacing: f64) -> SampledBodies<'_> {
        let sampled = |body| SampledBody::new(body, spacing);
        let balls = self.balls.iter().map(|ball| ball.each_ref().map(sampled)).collect();
        SampledBodies { stylus: self.stylus.each_ref().map(sampled), balls }
    }

    pub fn poses_at(&self, from: Axes, to: Axes, share: f64) -> [Matrix; 2] {
        let axes = std::array::from_fn(|i| from[i] + share * (to[i] - from[i]));
        [self.kind.spindle(axes), self.kind.table(axes)]
    }

    /// Position of the tip in the table's frame.
    pub fn tip_in_table_frame(&self, at: &[Matrix; 2]) -> Point {
        map_point_back(&at[1], map_point(&at[0], STYLUS_TIP_MM))
    }

    /// Linear axis positions for a tip position (table frame), which is linear in them.
    pub fn axes_for_tip_position(&self, tip: Point, b: f64, c: f64) -> Axes {
        let tip_at = |axes: Axes| self.tip_in_table_frame(&self.poses_at(axes, axes, 0.0));
        let zero = tip_at([0.0, 0.0, 0.0, b, c]);
        let unit = |k: usize| {
            let mut axes = [0.0, 0.0, 0.0, b, c];
            axes[k] = 1.0;
            subtract(tip_at(axes), zero)
        };
        // The three directions are orthonormal.
        let off = subtract(tip, zero);
        let dot = |k: usize| (0..3).map(|i| unit(k)[i] * off[i]).sum::<f64>();
        [dot(0), dot(1), dot(2), b, c].map(|value| (value * 1e4).round() / 1e4)
    }
}

/// Distance of a body of the stylus from one of the artefact, the latter shifted by `shift` (table frame);
/// distances of `far` or more are not computed exactly.
pub fn least_distance(at: &[Matrix; 2], [tool, work]: [&SampledBody; 2], shift: Point, far: f64) -> f64 {
    let (to_table, to_tool) = (relative_pose(&at[0], &at[1]), relative_pose(&at[1], &at[0]));
    let to_table = |p: Point| subtract(map_point(&to_table, p), shift);
    let to_tool = |p: Point| map_point(&to_tool, std::array::from_fn(|i| p[i] + shift[i]));
    let ((a, reach), (b, other)) = (tool.body.bounding_sphere(), work.body.bounding_sphere());
    let loose = length(subtract(to_table(a), b)) - reach - other;
    if loose > far {
        return loose;
    }
    let there = tool.min_distance_over_points(|p| work.body.distance(to_table(p)));
    let back = work.min_distance_over_points(|p| tool.body.distance(to_tool(p)));
    there.min(back)
}
