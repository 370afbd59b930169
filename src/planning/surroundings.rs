//! Obstacles around the tool, and the height at which the tool passes them.
//!
//! The tool is upright along Z: the stylus ball, and above it cylinders without an upper end. The bounds are
//! conservative; the proof decides whether an obstacle blocks the path.

use nalgebra::Vector3;

use super::PlanningError;
use super::hull::Body;
use super::tool::{Element, range, tool};
use machine::artefact;
use machine::frame::{Point, Pose, Spindle};
use machine::kinematics::{CarrierChain, Chain, Side};
use machine::record::artefact::Artefact;
use machine::record::machine::Carrier;
use machine::record::plan::Plan;
use machine::record::sensor::{Mount, Sensor};
use machine::{Axis, Position};

/// Clearance of the tool from everything that it does not touch, mm. Slightly more than the proof requires.
pub(super) const CLEAR: f64 = 0.6;

#[derive(Debug, Clone)]
pub(super) struct Obstacle {
    pub name: String,
    /// Index of the carrier.
    carrier: usize,
    pub body: Body,
    pub of_artefact: bool,
    /// Maximum distance from the expected position, mm.
    pub loose: f64,
}

/// All obstacles, and the machine.
#[derive(Debug, Clone)]
pub(super) struct Surroundings {
    pub chain: Chain,
    pub tip: Point<Spindle>,
    tool: Vec<Element>,
    /// Measuring range of each displacement sensor: a surface there is within its range.
    ranges: Vec<Element>,
    pub obstacles: Vec<Obstacle>,
    /// Carriers of the obstacles.
    carriers: Vec<CarrierChain>,
    /// For each sensor on the table, the line from one end of its range to the other.
    measuring_lines: Vec<Obstacle>,
    pub ball_radius: f64,
    /// Maximum distance of the artefact from its expected position, mm.
    pub loose: f64,
    /// Upper end of Z, mm.
    pub max_z: f64,
}

/// Positions of the stylus ball and of all carriers of obstacles, machine frame.
struct Standing {
    tip: Vector3<f64>,
    carriers: Vec<Pose>,
}

/// An obstacle to which the tool would come too near, or that would be within a sensor's range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Near {
    pub tool: String,
    pub obstacle: String,
}

impl Surroundings {
    /// Builds the surroundings with `artefact` at its expected position.
    pub fn new(plan: &Plan, artefact: &Artefact) -> Result<Self, PlanningError> {
        let chain = Chain::new(&plan.machine)?;
        let loose = artefact::uncertainty_mm(artefact);
        let (mut obstacles, mut carriers) = (Vec::new(), Vec::new());
        let mut add = |name: &str, on: Carrier, body: Body, of_artefact: bool| {
            if let Some(carried) = chain.carried(on).filter(|on| on.side() != Side::Tool) {
                let carrier = number_of(&mut carriers, carried);
                let (name, loose) = (name.to_owned(), if of_artefact { loose } else { 0.0 });
                obstacles.push(Obstacle { name, carrier, body, of_artefact, loose });
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
        let mut line = |sensor: &Sensor| {
            let table = number_of(&mut carriers, chain.carried(Carrier::Table)?);
            Some(measuring_line(sensor, table))
        };
        let measuring_lines = on_table.filter_map(&mut line).collect();
        Ok(Self {
            chain,
            tip,
            tool,
            ranges,
            obstacles,
            carriers,
            measuring_lines,
            ball_radius,
            loose,
            max_z,
        })
    }

    /// Centre of the stylus ball, machine frame.
    pub fn tip_at(&self, position: &Position) -> Vector3<f64> {
        self.chain.machine_from_spindle(position, &[]).transform_point(&self.tip.mm.into()).coords
    }

    /// Z command from which on the stylus ball is `margin` higher than everything that Z can pass over, with the
    /// rotary axes as in `pose`, at any position of the other axes. `Err`: the artefact is higher than Z reaches;
    /// the value is the required Z.
    pub fn z_over_all(&self, pose: &Position, margin: f64) -> Result<f64, f64> {
        let (here, higher) = self.here_and_higher(pose);
        let mut needed = f64::NEG_INFINITY;
        for obstacle in &self.obstacles {
            let seen = here.seen(obstacle);
            let height = seen.top() + obstacle.loose + margin + self.ball_radius;
            let z = z_command(pose.at(Axis::Z), [&here, &higher], obstacle, height);
            let Some(z) = z else { continue };
            if z <= self.max_z {
                needed = needed.max(z);
            } else if obstacle.of_artefact {
                return Err(z);
            }
        }
        Ok(needed)
    }

    /// Z command from which on the tool is `margin` clear of everything that Z can pass over, on the straight path
    /// in X and Y between two positions with the same rotary axes. Heights below `to` are not considered.
    pub fn z_between(&self, from: &Position, to: &Position, margin: f64) -> f64 {
        let needed = self.heights(&self.tool, &self.obstacles, [from, to], margin);
        let needed = needed.into_iter().map(|(z, _)| z);
        needed.filter(|z| *z <= self.max_z).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Z command from which on no declared body is within the range of a displacement sensor in the spindle, and
    /// the stylus ball is not within the range of any sensor on the table, on the straight path in X and Y between
    /// two positions with the same rotary axes. The ball counts as a cylinder that ends below it.
    ///
    /// # Errors
    /// Z does not reach that height; the value is the sensor and the body within its range.
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

    /// Z commands from which on each of `parts` is `margin` clear of each of `obstacles` on the path.
    fn heights(
        &self,
        parts: &[Element],
        obstacles: &[Obstacle],
        [from, to]: [&Position; 2],
        margin: f64,
    ) -> Vec<(f64, Near)> {
        let level = from.updated_by(&to.only(|axis| !matches!(axis, Axis::X | Axis::Y)));
        let (begin, (end, higher)) = (self.standing(&level), self.here_and_higher(to));
        let mut heights = Vec::new();
        for obstacle in obstacles {
            let way = [&begin, &end].map(|at| at.tip_from(obstacle));
            let (body, margin) = (end.seen(obstacle), margin + obstacle.loose);
            for part in parts.iter().filter(|part| part.might_meet(&way, &body, margin)) {
                let height = way[1].z + part.rise(&way, &body, margin);
                let near = Near { tool: part.name.clone(), obstacle: obstacle.name.clone() };
                let z = z_command(to.at(Axis::Z), [&end, &higher], obstacle, height);
                heights.extend(z.map(|z| (z, near)));
            }
        }
        heights
    }

    /// First obstacle to which the tool is nearer than `margin` on the straight path in X, Y, Z between two
    /// positions with the same rotary axes, or on the straight descent to it. The ball with the name `touched` is
    /// the target: only the parts above the stylus ball must stay clear of it.
    pub fn near(&self, from: &Position, to: &Position, margin: f64, touched: &str) -> Option<Near> {
        let ends = [from, to].map(|at| self.standing(at));
        self.obstacles.iter().find_map(|obstacle| {
            let own = obstacle.name == touched;
            let way = ends.each_ref().map(|at| at.tip_from(obstacle));
            let body = ends[1].seen(obstacle);
            // The offset of this ball also shifts the point at which the touch stops.
            let margin = if own { 0.0 } else { margin + obstacle.loose };
            let mut parts = self.tool.iter().skip(usize::from(own));
            let near = parts.find(|part| !part.is_clear(way, &body, margin));
            near.map(|part| Near { tool: part.name.clone(), obstacle: obstacle.name.clone() })
        })
    }

    /// Distance of two positions seen along the spindle, with the rotary axes as in `to`, mm.
    pub fn apart_from_above(&self, from: &Position, to: &Position) -> f64 {
        let level = from.updated_by(&to.only(|axis| !axis.is_linear()));
        let [from, to] = [&level, to].map(|at| self.chain.tip_in_table(at, self.tip, &[]).mm);
        let table = self.chain.machine_from_table(&level, &[]).rotation;
        (table * (to - from)).xy().norm()
    }

    /// Whether the tool is `margin` clear of everything.
    pub fn is_clear(&self, at: &Position, margin: f64) -> bool {
        self.near(at, at, margin, "").is_none()
    }

    /// Whether the straight path in X, Y, Z between two positions with the same rotary axes is free for a guarded
    /// move. The ball with the name `round` is not checked against ball and stem of the stylus, because the path
    /// leads round it.
    pub fn passes(&self, from: &Position, to: &Position, round: &str) -> bool {
        let ends = [from, to].map(|at| self.standing(at));
        self.obstacles.iter().all(|obstacle| {
            let way = ends.each_ref().map(|at| at.tip_from(obstacle));
            let (body, margin) = (ends[1].seen(obstacle), CLEAR + obstacle.loose);
            let own = obstacle.name == round;
            let mut parts = self.tool.iter().filter(|part| !(own && part.felt));
            parts.all(|part| part.is_clear(way, &body, margin))
        })
    }

    /// Whether a positive Z command moves the tool away from the table.
    pub fn z_lifts(&self) -> bool {
        let at = |z: f64| Position::new().with(Axis::Z, z);
        let over_table = |position: &Position| {
            let table = self.chain.machine_from_table(position, &[]);
            self.tip_at(position).z - table.translation.vector.z
        };
        over_table(&at(1.0)) > over_table(&at(0.0))
    }

    /// Whether the spindle is upright.
    pub fn upright(&self, pose: &Position) -> bool {
        let axis = self.chain.machine_from_spindle(pose, &[]).rotation * Vector3::z();
        axis.z > 1.0 - 1e-9
    }

    fn standing(&self, at: &Position) -> Standing {
        let commands = Axis::ALL.map(|axis| at.at(axis));
        let carriers = self.carriers.iter().map(|carried| carried.pose(&commands)).collect();
        Standing { tip: self.tip_at(at), carriers }
    }

    /// State at a position, and with Z 1 mm higher.
    fn here_and_higher(&self, at: &Position) -> (Standing, Standing) {
        let higher = at.clone().with(Axis::Z, at.at(Axis::Z) + 1.0);
        (self.standing(at), self.standing(&higher))
    }
}

impl Standing {
    /// Vector from the origin of the obstacle's carrier to the centre of the stylus ball, machine directions.
    fn tip_from(&self, obstacle: &Obstacle) -> Vector3<f64> {
        self.tip - self.carriers[obstacle.carrier].translation.vector
    }

    /// The obstacle in machine directions, relative to the origin of its carrier.
    fn seen(&self, obstacle: &Obstacle) -> Body {
        obstacle.body.turned(&self.carriers[obstacle.carrier].rotation)
    }
}

/// Z command that holds the stylus ball's centre at `height` above the obstacle's carrier, extrapolated from the
/// present Z and from 1 mm higher; `None` if Z does not lift the ball off.
fn z_command(
    z: f64,
    [here, higher]: [&Standing; 2],
    obstacle: &Obstacle,
    height: f64,
) -> Option<f64> {
    let stands = here.tip_from(obstacle).z;
    let lift = higher.tip_from(obstacle).z - stands;
    (lift > 0.5).then(|| z + (height - stands) / lift)
}

/// Index of a carrier in the list; a new carrier is appended.
fn number_of(carriers: &mut Vec<CarrierChain>, carried: CarrierChain) -> usize {
    let known = carriers.iter().position(|known| known.moves_as(&carried));
    known.unwrap_or_else(|| {
        carriers.push(carried);
        carriers.len() - 1
    })
}

fn measuring_line(sensor: &Sensor, carrier: usize) -> Obstacle {
    let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
    let [from, to] = sensor.range_mm.map(|distance| zero + along * distance);
    let body = Body::Round(artefact::Shape::Cylinder { from, to, radius: 0.0 });
    Obstacle { name: sensor.name.clone(), carrier, body, of_artefact: false, loose: 0.0 }
}
