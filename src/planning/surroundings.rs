//! What stands about the tool, and how high the tool must be to pass.
//!
//! The tool stands upright along Z: the stylus ball, and above it cylinders without an upper end.
//! Bounds are on the safe side; whether something is in the way indeed is for the proof to say.

use std::f64::consts::PI;

use nalgebra::{Vector2, Vector3};

use super::PlanningError;
use super::gjk::Support;
use super::hull::{Body, Upright, apart_by};
use machine::artefact;
use machine::kinematics::{Carried, Chain, Side};
use machine::record::artefact::Artefact;
use machine::record::machine::{Carrier, Solid};
use machine::record::plan::Plan;
use machine::record::sensor::{Mount, Sensor};
use machine::{Axis, Position, frame::Point, frame::Spindle};

/// What the tool keeps from all that it is not there to touch, mm. A little more than the proof asks.
pub(super) const CLEAR: f64 = 0.6;
/// Directions across which two bodies are looked at from above.
const DIRECTIONS: u32 = 16;
/// Heights are found to within this, mm.
const FOUND_WITHIN: f64 = 0.1;

/// The tool's shape from below.
#[derive(Debug, Clone)]
struct Element {
    name: String,
    /// Ball and stem of the stylus, which the probe feels.
    felt: bool,
    radius: f64,
    /// Of the lower end, from the centre of the stylus ball.
    bottom: f64,
}

#[derive(Debug, Clone)]
pub(super) struct Obstacle {
    pub name: String,
    carried: Carried,
    pub body: Body,
    pub of_artefact: bool,
    /// It may stand off its place by this.
    pub loose: f64,
}

/// All of them, with the machine.
#[derive(Debug, Clone)]
pub(super) struct Surroundings {
    pub chain: Chain,
    pub tip: Point<Spindle>,
    tool: Vec<Element>,
    /// Where each displacement sensor measures: a surface there is within its range.
    ranges: Vec<Element>,
    pub obstacles: Vec<Obstacle>,
    /// Of each sensor on the table the line from one end of its range to the other.
    measuring_lines: Vec<Obstacle>,
    pub ball_radius: f64,
    /// The artefact may stand off its place by this, mm.
    pub loose: f64,
    /// Z ends here.
    pub max_z: f64,
}

/// Something that the tool would come too near to, or that would be within a sensor's range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Near {
    pub tool: String,
    pub obstacle: String,
}

impl Surroundings {
    /// `artefact` as it is thought to stand.
    pub fn new(plan: &Plan, artefact: &Artefact) -> Result<Self, PlanningError> {
        let chain = Chain::new(&plan.machine)?;
        let loose = artefact::uncertainty_mm(artefact);
        let mut obstacles = Vec::new();
        let mut add = |name: &str, on: Carrier, body: Body, of_artefact: bool| {
            if let Some(carried) = chain.carried(on).filter(|on| on.side() != Side::Tool) {
                let (name, loose) = (name.to_owned(), if of_artefact { loose } else { 0.0 });
                obstacles.push(Obstacle { name, carried, body, of_artefact, loose });
            }
        };
        for part in artefact::parts(artefact) {
            add(&part.name, Carrier::Table, Body::Round(part.shape), true);
        }
        for solid in &plan.solids {
            add(&solid.name, solid.on, Body::of(solid), false);
        }
        for keepout in &plan.keepout {
            let body = Body::cuboid(keepout.min_mm, keepout.max_mm);
            add(&keepout.name, Carrier::Bed, body, false);
        }
        let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
        let max_z = plan.machine.axes.get(&Axis::Z).map_or(f64::INFINITY, |spec| spec.max);
        let (tool, ball_radius) = (tool(plan), plan.probe.ball_radius_mm);
        let in_spindle = plan.sensors.iter().filter(|sensor| sensor.mount.is_spindle());
        let ranges = in_spindle.map(|sensor| range(sensor, &tip.mm)).collect();
        let on_table = plan.sensors.iter().filter(|sensor| sensor.mount == Mount::Table);
        let line = |sensor: &Sensor| Some(measuring_line(sensor, chain.carried(Carrier::Table)?));
        let measuring_lines = on_table.filter_map(line).collect();
        Ok(Self { chain, tip, tool, ranges, obstacles, measuring_lines, ball_radius, loose, max_z })
    }

    /// Centre of the stylus ball in the machine frame.
    pub fn tip_at(&self, position: &Position) -> Vector3<f64> {
        self.chain.machine_from_spindle(position, &[]).transform_point(&self.tip.mm.into()).coords
    }

    /// Z command from which on the stylus ball is `margin` higher than all that Z can pass over, the
    /// rotary axes as in `pose`, wherever the other axes stand. `Err`: what is on the table is
    /// higher than Z reaches; the value is the Z needed.
    pub fn z_over_all(&self, pose: &Position, margin: f64) -> Result<f64, f64> {
        let mut needed = f64::NEG_INFINITY;
        for obstacle in &self.obstacles {
            let seen = obstacle.seen(pose);
            let height = seen.top() + obstacle.loose + margin + self.ball_radius;
            let Some(z) = self.z_command(obstacle, pose, height) else { continue };
            if z <= self.max_z {
                needed = needed.max(z);
            } else if obstacle.of_artefact {
                return Err(z);
            }
        }
        Ok(needed)
    }

    /// Z command from which on the tool is `margin` clear of all that Z can pass over, on the straight
    /// way in X and Y between two positions with the same rotary axes. Nothing lower than `to` is
    /// looked for.
    pub fn z_between(&self, from: &Position, to: &Position, margin: f64) -> f64 {
        let needed = self.heights(&self.tool, &self.obstacles, [from, to], margin);
        let needed = needed.into_iter().map(|(z, _)| z);
        needed.filter(|z| *z <= self.max_z).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Z command from which on nothing declared is within the range of a displacement sensor in the
    /// spindle, and the stylus ball is within that of none on the table, on the straight way in X and Y
    /// between two positions with the same rotary axes. The ball counts as a cylinder that ends below it.
    ///
    /// # Errors
    /// Z does not reach so high; the sensor and what is within its range.
    pub fn z_out_of_range(&self, from: &Position, to: &Position, margin: f64) -> Result<f64, Near> {
        let mut needed = self.heights(&self.ranges, &self.obstacles, [from, to], margin);
        let ball = self.tool.get(..1).unwrap_or_default();
        let of_table = self.heights(ball, &self.measuring_lines, [from, to], margin);
        needed.extend(
            of_table
                .into_iter()
                .map(|(z, Near { tool, obstacle })| (z, Near { tool: obstacle, obstacle: tool })),
        );
        let (z, near) = needed.into_iter().fold((f64::NEG_INFINITY, None), |highest, (z, near)| {
            if z > highest.0 { (z, Some(near)) } else { highest }
        });
        near.filter(|_| z > self.max_z).map_or(Ok(z), Err)
    }

    /// Z commands from which on each of `parts` is `margin` clear of each of `obstacles` that is on the way.
    fn heights(
        &self,
        parts: &[Element],
        obstacles: &[Obstacle],
        [from, to]: [&Position; 2],
        margin: f64,
    ) -> Vec<(f64, Near)> {
        let level = from.updated_by(&to.only(|axis| !matches!(axis, Axis::X | Axis::Y)));
        let mut heights = Vec::new();
        for obstacle in obstacles {
            let way = [&level, to].map(|at| self.as_seen_by(obstacle, at));
            let (body, margin) = (obstacle.seen(to), margin + obstacle.loose);
            for part in parts.iter().filter(|part| part.might_meet(&way, &body, margin)) {
                let height = way[1].z + part.rise(&way, &body, margin);
                let near = Near { tool: part.name.clone(), obstacle: obstacle.name.clone() };
                heights.extend(self.z_command(obstacle, to, height).map(|z| (z, near)));
            }
        }
        heights
    }

    /// What the tool comes nearer to than `margin` on the straight way in X, Y, Z between two positions
    /// with the same rotary axes, or had come to on its way straight down to it. The ball of that
    /// name is there to be touched: only what is above the stylus ball must stay clear of it.
    pub fn near(&self, from: &Position, to: &Position, margin: f64, touched: &str) -> Option<Near> {
        self.obstacles.iter().find_map(|obstacle| {
            let own = obstacle.name == touched;
            let way = [from, to].map(|at| self.as_seen_by(obstacle, at));
            let body = obstacle.seen(to);
            // What is loose moves with the ball that stops the touch.
            let margin = if own { 0.0 } else { margin + obstacle.loose };
            let mut parts = self.tool.iter().skip(usize::from(own));
            let near = parts.find(|part| !part.is_clear(way, &body, margin));
            near.map(|part| Near { tool: part.name.clone(), obstacle: obstacle.name.clone() })
        })
    }

    /// How far two places are apart seen along the spindle, the rotary axes as in `to`, mm.
    pub fn apart_from_above(&self, from: &Position, to: &Position) -> f64 {
        let level = from.updated_by(&to.only(|axis| !axis.is_linear()));
        let [from, to] = [&level, to].map(|at| self.chain.tip_in_table(at, self.tip, &[]).mm);
        let table = self.chain.machine_from_table(&level, &[]).rotation;
        (table * (to - from)).xy().norm()
    }

    /// Is the tool `margin` clear of everything?
    pub fn is_clear(&self, at: &Position, margin: f64) -> bool {
        self.near(at, at, margin, "").is_none()
    }

    /// Is the straight way in X, Y, Z between two places with the same rotary axes free for a guarded
    /// move? The ball of that name is not looked at against ball and stem of the stylus: the way was
    /// laid about it.
    pub fn passes(&self, from: &Position, to: &Position, round: &str) -> bool {
        self.obstacles.iter().all(|obstacle| {
            let way = [from, to].map(|at| self.as_seen_by(obstacle, at));
            let (body, margin) = (obstacle.seen(to), CLEAR + obstacle.loose);
            let own = obstacle.name == round;
            let mut parts = self.tool.iter().filter(|part| !(own && part.felt));
            parts.all(|part| part.is_clear(way, &body, margin))
        })
    }

    /// Does a positive Z command lift the tool off the table?
    pub fn z_lifts(&self) -> bool {
        let at = |z: f64| Position::new().with(Axis::Z, z);
        let over_table = |position: &Position| {
            let table = self.chain.machine_from_table(position, &[]);
            self.tip_at(position).z - table.translation.vector.z
        };
        over_table(&at(1.0)) > over_table(&at(0.0))
    }

    /// Does the spindle stand upright?
    pub fn upright(&self, pose: &Position) -> bool {
        let axis = self.chain.machine_from_spindle(pose, &[]).rotation * Vector3::z();
        axis.z > 1.0 - 1e-9
    }

    /// Z command that holds the stylus ball's centre at a height over the obstacle's carrier; `None`
    /// if Z does not lift it off.
    fn z_command(&self, obstacle: &Obstacle, at: &Position, height: f64) -> Option<f64> {
        let z = at.at(Axis::Z);
        let here = self.as_seen_by(obstacle, at).z;
        let higher = at.clone().with(Axis::Z, z + 1.0);
        let lift = self.as_seen_by(obstacle, &higher).z - here;
        (lift > 0.5).then(|| z + (height - here) / lift)
    }

    /// Centre of the stylus ball from the origin of the obstacle's carrier, machine directions.
    fn as_seen_by(&self, obstacle: &Obstacle, position: &Position) -> Vector3<f64> {
        self.tip_at(position) - obstacle.carried.pose(&commands(position)).translation.vector
    }
}

/// Of the parts of the tool that the probe does not feel: how wide they are, and how far above the centre
/// of the stylus ball the lowest begins, mm. `None`: none is declared.
pub(super) fn overhang(plan: &Plan) -> Option<(f64, f64)> {
    let tool = tool(plan);
    let unfelt = tool.iter().filter(|part| !part.felt).map(|part| (part.radius, part.bottom));
    unfelt.reduce(|(wide, low), (radius, bottom)| (wide.max(radius), low.min(bottom)))
}

fn commands(position: &Position) -> [f64; Axis::ALL.len()] {
    Axis::ALL.map(|axis| position.at(axis))
}

/// From the spindle's solids those that it carries itself: what else rides on the tool's side is
/// for the proof.
fn tool(plan: &Plan) -> Vec<Element> {
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
        // The stylus may stand beside the spindle's axis, and S turns it about that.
        let aside = |p: &Vector3<f64>| p.xy().norm() + tip.xy().norm();
        let wide = points.iter().map(aside).fold(0.0, f64::max) + radius;
        let bottom = body.support(-Vector3::z()).z - tip.z;
        tool.push(part(&solid.name, false, wide, bottom));
    }
    tool
}

/// Where `sensor` measures, as an upright cylinder about the stylus ball at `tip`, whichever way the
/// spindle stands.
fn range(sensor: &Sensor, tip: &Vector3<f64>) -> Element {
    let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
    let ends = sensor.range_mm.map(|distance| zero + along * distance);
    let radius = ends.iter().map(|end| end.xy().norm()).fold(0.0, f64::max) + tip.xy().norm();
    let bottom = ends.iter().map(|end| end.z - tip.z).fold(f64::INFINITY, f64::min);
    Element { name: sensor.name.clone(), felt: false, radius, bottom }
}

fn measuring_line(sensor: &Sensor, carried: Carried) -> Obstacle {
    let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
    let [from, to] = sensor.range_mm.map(|distance| zero + along * distance);
    let body = Body::Round(artefact::Shape::Cylinder { from, to, radius: 0.0 });
    Obstacle { name: sensor.name.clone(), carried, body, of_artefact: false, loose: 0.0 }
}

impl Obstacle {
    /// Turned as it stands, from the origin of its carrier.
    fn seen(&self, position: &Position) -> Body {
        self.body.turned(&self.carried.pose(&commands(position)).rotation)
    }
}

impl Element {
    /// On a way of the stylus ball, higher by `rise`.
    fn on(&self, way: [Vector3<f64>; 2], rise: f64) -> Upright {
        Upright { way: way.map(|at| at + Vector3::z() * (self.bottom + rise)), radius: self.radius }
    }

    /// Quickly: neither above the body nor beside it.
    fn might_meet(&self, way: &[Vector3<f64>; 2], body: &Body, margin: f64) -> bool {
        let lowest = way[0].z.min(way[1].z) + self.bottom;
        lowest < body.top() + margin && beside(way, body) < self.radius + margin
    }

    fn is_clear(&self, way: [Vector3<f64>; 2], body: &Body, margin: f64) -> bool {
        !self.might_meet(&way, body, margin) || apart_by(&self.on(way, 0.0), body, margin)
    }

    /// How much higher it must go to be clear of the body by `margin`: by halving, to the upper side.
    fn rise(&self, way: &[Vector3<f64>; 2], body: &Body, margin: f64) -> f64 {
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

/// A body is at least this far from a straight way, seen from above: across the direction that shows
/// most.
fn beside(way: &[Vector3<f64>; 2], body: &Body) -> f64 {
    let (points, radius) = body.points();
    let across = |k: u32| {
        let (sin, cos) = (2.0 * PI * f64::from(k) / f64::from(DIRECTIONS)).sin_cos();
        Vector2::new(cos, sin)
    };
    let between = |u: Vector2<f64>| {
        let near = points.iter().map(|p| p.xy().dot(&u)).fold(f64::INFINITY, f64::min);
        near - way[0].xy().dot(&u).max(way[1].xy().dot(&u))
    };
    (0..DIRECTIONS).map(across).map(between).fold(f64::NEG_INFINITY, f64::max) - radius
}
