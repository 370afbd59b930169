//! Obstacles around the tool, and the height at which the tool passes them.
//!
//! The tool points along +Z of the machine frame: the stylus ball, and above it cylinders without an upper end. The
//! bounds are conservative; the proof decides whether an obstacle blocks the path.

use nalgebra::Vector3;

use super::PlanningError;
use super::obstacle_body::ObstacleBody;
use super::tool_parts::{ToolPart, sensor_range_as_tool_part, tool_parts};
use machine::artefact;
use machine::frame::{Point, Pose, SpindleFrame};
use machine::kinematics::{CarrierChain, KinematicChain, KinematicsError, MachineSide};
use machine::record::artefact::Artefact;
use machine::record::machine::Carrier;
use machine::record::plan::Plan;
use machine::record::sensor::{Sensor, SensorMount};
use machine::{Axis, Position};

/// Planned clearance of the tool from everything that it does not touch, during the touch of a ball and on paths
/// around a ball, mm. Slightly more than the proof requires of guarded moves.
pub(super) const MIN_TOOL_CLEARANCE_MM: f64 = 0.6;

/// A body of the artefact, a solid or a keep-out box that the tool must pass. Solids on the tool side are not
/// obstacles.
#[derive(Debug, Clone)]
pub(super) struct Obstacle {
    pub name: String,
    /// Index in the list of the obstacles' carriers.
    carrier_index: usize,
    /// In the frame of its carrier, mm.
    pub body: ObstacleBody,
    pub is_artefact_part: bool,
    /// Maximum distance from the expected position, mm.
    pub max_misplacement_mm: f64,
}

/// All obstacles, and the machine.
#[derive(Debug, Clone)]
pub(super) struct Surroundings {
    pub chain: KinematicChain,
    /// Centre of the stylus ball.
    pub tip: Point<SpindleFrame>,
    /// The stylus ball is always the first part.
    tool_parts: Vec<ToolPart>,
    /// Measuring range of each displacement sensor in the spindle, as a part of the tool.
    sensor_ranges: Vec<ToolPart>,
    pub obstacles: Vec<Obstacle>,
    /// Carriers of the obstacles.
    obstacle_carriers: Vec<CarrierChain>,
    /// For each sensor on the table, the line from one end of its range to the other.
    measuring_lines: Vec<Obstacle>,
    pub stylus_ball_radius_mm: f64,
    /// Maximum distance of the artefact from its expected position, mm.
    pub max_artefact_misplacement_mm: f64,
    /// Upper end of Z, mm.
    pub max_z: f64,
}

/// Positions of the stylus ball and of all carriers of obstacles, machine frame.
struct TipAndCarrierPoses {
    tip: Vector3<f64>,
    carrier_poses: Vec<Pose>,
}

/// An obstacle to which the tool would come too near, or that would be within a sensor's range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TooNearPair {
    /// Name of the part of the tool, or of the sensor.
    pub tool_or_sensor_name: String,
    pub obstacle_name: String,
}

impl Surroundings {
    /// Builds the surroundings with `artefact` at its expected position.
    pub fn new(plan: &Plan, artefact: &Artefact) -> Result<Self, PlanningError> {
        let chain = KinematicChain::new(&plan.machine)?;
        let uncertainty_mm = artefact::max_misplacement_mm(artefact);
        let (mut obstacles, mut carriers) = (Vec::new(), Vec::new());
        let mut add = |name: &str, on: Carrier, body: ObstacleBody, is_artefact_part: bool| {
            if let Some(carried) = chain.carrier_chain(on).filter(|on| on.side != MachineSide::Tool) {
                let carrier_index = find_or_add_carrier(&mut carriers, carried);
                let max_misplacement_mm = if is_artefact_part { uncertainty_mm } else { 0.0 };
                let name = name.to_owned();
                obstacles.push(Obstacle { name, carrier_index, body, is_artefact_part, max_misplacement_mm });
            }
        };
        for part in artefact::artefact_bodies(artefact) {
            add(&part.name, Carrier::Table, ObstacleBody::BallOrCylinder(part.shape), true);
        }
        for solid in &plan.solids {
            add(&solid.name, solid.on, ObstacleBody::from_solid(solid), false);
        }
        for keepout in &plan.keepout {
            let body = ObstacleBody::cuboid(keepout.min_mm, keepout.max_mm);
            add(&keepout.name, Carrier::Bed, body, false);
        }
        let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
        let max_z = plan.machine.axes.get(&Axis::Z).map_or(f64::INFINITY, |spec| spec.max);
        let (tool, ball_radius) = (tool_parts(plan), plan.probe.ball_radius_mm);
        let in_spindle = plan.sensors.iter().filter(|sensor| sensor.mount.is_spindle());
        let sensor_ranges = in_spindle.map(|sensor| sensor_range_as_tool_part(sensor, &tip.mm)).collect();
        let on_table = plan.sensors.iter().filter(|sensor| sensor.mount == SensorMount::Table);
        let mut line = |sensor: &Sensor| {
            let table = find_or_add_carrier(&mut carriers, chain.carrier_chain(Carrier::Table)?);
            Some(measuring_line(sensor, table))
        };
        let measuring_lines = on_table.filter_map(&mut line).collect();
        Ok(Self {
            chain,
            tip,
            tool_parts: tool,
            sensor_ranges,
            obstacles,
            obstacle_carriers: carriers,
            measuring_lines,
            stylus_ball_radius_mm: ball_radius,
            max_artefact_misplacement_mm: uncertainty_mm,
            max_z,
        })
    }

    /// Position at which the centre of the stylus ball is at `target_mm`, table frame, with the rotary axes as in
    /// `rotary`.
    ///
    /// # Errors
    /// The linear axes of the machine do not span space.
    pub fn position_at_table_point(
        &self,
        target_mm: Vector3<f64>,
        rotary: &Position,
    ) -> Result<Position, KinematicsError> {
        let rotary = rotary.filter_axes(|axis| !axis.is_linear());
        let linear = self.chain.solve_linear_axes(Point::from_vec(target_mm), self.tip, &rotary, &[])?;
        Ok(rotary.updated_by(&linear))
    }

    /// Centre of the stylus ball, machine frame.
    pub fn tip_in_machine(&self, position: &Position) -> Vector3<f64> {
        self.chain.machine_from_spindle(position, &[]).transform_point(&self.tip.mm.into()).coords
    }

    /// Z command from which on the stylus ball is `margin` higher than everything that Z can pass over, with the
    /// rotary axes as in `pose`, at any position of the other axes. Solids and keep-out boxes that are too high for Z
    /// are ignored. `Err`: the artefact is higher than Z reaches; the value is the required Z.
    pub fn clear_z_command_everywhere(&self, pose: &Position, margin: f64) -> Result<f64, f64> {
        let (here, higher) = self.present_and_raised_positions(pose);
        let mut needed = f64::NEG_INFINITY;
        for obstacle in &self.obstacles {
            let body = here.obstacle_in_machine_directions(obstacle);
            let height = body.top_z() + obstacle.max_misplacement_mm + margin + self.stylus_ball_radius_mm;
            let z = z_command_for_height(pose.get_or_zero(Axis::Z), [&here, &higher], obstacle, height);
            let Some(z) = z else { continue };
            if z <= self.max_z {
                needed = needed.max(z);
            } else if obstacle.is_artefact_part {
                return Err(z);
            }
        }
        Ok(needed)
    }

    /// Z command from which on the tool is `margin` clear of everything that Z can pass over, on the straight path in
    /// X and Y between two positions with the same rotary axes. Heights below `to` are not considered; −∞ if the tool
    /// is clear there.
    pub fn clear_z_command_on_path(&self, from: &Position, to: &Position, margin: f64) -> f64 {
        let highest = self.highest_clear_z_command(&self.tool_parts, &self.obstacles, [from, to], margin, self.max_z);
        highest.map_or(f64::NEG_INFINITY, |(z, _)| z)
    }

    /// Z command from which on no declared body is within the range of a displacement sensor in the spindle, and
    /// the stylus ball is not within the range of any sensor on the table, on the straight path in X and Y between
    /// two positions with the same rotary axes. The stylus ball counts as a vertical cylinder without an upper end.
    ///
    /// # Errors
    /// Z does not reach that height; the value is the sensor and the body within its range.
    pub fn out_of_range_z(&self, from: &Position, to: &Position, margin: f64) -> Result<f64, TooNearPair> {
        let ball = self.tool_parts.get(..1).unwrap_or_default();
        let clearance =
            |parts, obstacles| self.highest_clear_z_command(parts, obstacles, [from, to], margin, f64::INFINITY);
        let of_spindle = clearance(&self.sensor_ranges, &self.obstacles);
        let of_table = clearance(ball, &self.measuring_lines).map(|(z, [ball, line])| (z, [line, ball]));
        let both = of_spindle.into_iter().chain(of_table);
        let Some((z, [tool, obstacle])) = both.reduce(|one, other| if other.0 > one.0 { other } else { one }) else {
            return Ok(f64::NEG_INFINITY);
        };
        if z <= self.max_z {
            return Ok(z);
        }
        Err(TooNearPair { tool_or_sensor_name: tool.to_owned(), obstacle_name: obstacle.to_owned() })
    }

    /// Highest Z command, at most `max_z`, that is needed for one of `parts` to be `margin` clear of one of
    /// `obstacles` on the path, with the names of the two.
    fn highest_clear_z_command<'a>(
        &self,
        parts: &'a [ToolPart],
        obstacles: &'a [Obstacle],
        [from, to]: [&Position; 2],
        margin: f64,
        max_z: f64,
    ) -> Option<(f64, [&'a str; 2])> {
        let level = from.updated_by(&to.filter_axes(|axis| !matches!(axis, Axis::X | Axis::Y)));
        let (begin, (end, higher)) = (self.tip_and_carrier_poses(&level), self.present_and_raised_positions(to));
        let mut highest = None;
        for obstacle in obstacles {
            let path_ends = [&begin, &end].map(|at| at.tip_offset_from_carrier(obstacle));
            let (body, margin) = (end.obstacle_in_machine_directions(obstacle), margin + obstacle.max_misplacement_mm);
            let z_after_rise = |rise: f64| {
                z_command_for_height(to.get_or_zero(Axis::Z), [&end, &higher], obstacle, path_ends[1].z + rise)
            };
            for part in parts.iter().filter(|part| part.may_collide(&path_ends, &body, margin)) {
                let is_higher = |z: &f64| highest.is_none_or(|(highest, _)| *z > highest);
                // The exact rise needs a bisection; it is computed only if its bound exceeds the highest Z so far.
                let bound = z_after_rise(part.rise_over_top_mm(&path_ends, &body, margin));
                let exact = || z_after_rise(part.rise_until_clear_mm(&path_ends, &body, margin));
                let z = bound.filter(is_higher).and_then(|_| exact()).filter(is_higher).filter(|z| *z <= max_z);
                if let Some(z) = z {
                    highest = Some((z, [part.name.as_str(), obstacle.name.as_str()]));
                }
            }
        }
        highest
    }

    /// First obstacle to which the tool is nearer than `margin` on the straight path in X, Y, Z between two
    /// positions with the same rotary axes, or on the straight descent to it. The ball with the name `touched_ball` is
    /// the target: only the parts above the stylus ball must stay clear of it.
    pub fn find_near_obstacle(
        &self,
        from: &Position,
        to: &Position,
        margin: f64,
        touched_ball: &str,
    ) -> Option<TooNearPair> {
        let ends = [from, to].map(|at| self.tip_and_carrier_poses(at));
        self.obstacles.iter().find_map(|obstacle| {
            let own = obstacle.name == touched_ball;
            let path_ends = ends.each_ref().map(|at| at.tip_offset_from_carrier(obstacle));
            let body = ends[1].obstacle_in_machine_directions(obstacle);
            // A misplacement of the touched ball shifts the contact equally, so this ball needs no margin.
            let margin = if own { 0.0 } else { margin + obstacle.max_misplacement_mm };
            let mut parts = self.tool_parts.iter().skip(usize::from(own));
            let near = parts.find(|part| !part.is_clear(path_ends, &body, margin))?;
            Some(TooNearPair { tool_or_sensor_name: near.name.clone(), obstacle_name: obstacle.name.clone() })
        })
    }

    /// Distance of two positions in X and Y of the machine frame, with the rotary axes as in `to`, mm.
    pub fn xy_distance_mm(&self, from: &Position, to: &Position) -> f64 {
        let level = from.updated_by(&to.filter_axes(|axis| !axis.is_linear()));
        let [from, to] = [&level, to].map(|at| self.chain.tip_in_table(at, self.tip, &[]).mm);
        let table = self.chain.machine_from_table(&level, &[]).rotation;
        (table * (to - from)).xy().norm()
    }

    /// Whether the tool is `margin` clear of everything.
    pub fn is_tool_clear(&self, at: &Position, margin: f64) -> bool {
        self.find_near_obstacle(at, at, margin, "").is_none()
    }

    /// Whether the straight path in X, Y, Z between two positions with the same rotary axes is free for a guarded
    /// move. The ball with the name `circled_ball` is not checked against ball and stem of the stylus, because the path
    /// leads round it.
    pub fn is_path_free(&self, from: &Position, to: &Position, circled_ball: &str) -> bool {
        let ends = [from, to].map(|at| self.tip_and_carrier_poses(at));
        self.obstacles.iter().all(|obstacle| {
            let path_ends = ends.each_ref().map(|at| at.tip_offset_from_carrier(obstacle));
            let body = ends[1].obstacle_in_machine_directions(obstacle);
            let margin = MIN_TOOL_CLEARANCE_MM + obstacle.max_misplacement_mm;
            let own = obstacle.name == circled_ball;
            let mut parts = self.tool_parts.iter().filter(|part| !(own && part.is_contact_detected));
            parts.all(|part| part.is_clear(path_ends, &body, margin))
        })
    }

    /// Whether a positive Z command moves the tool away from the table.
    pub fn does_positive_z_lift_tool(&self) -> bool {
        let at = |z: f64| Position::new().with(Axis::Z, z);
        let over_table = |position: &Position| {
            let table = self.chain.machine_from_table(position, &[]);
            self.tip_in_machine(position).z - table.translation.vector.z
        };
        over_table(&at(1.0)) > over_table(&at(0.0))
    }

    /// Whether the spindle's axis points along +Z of the machine frame in `pose`.
    pub fn is_spindle_upright(&self, pose: &Position) -> bool {
        let axis = self.chain.machine_from_spindle(pose, &[]).rotation * Vector3::z();
        axis.z > 1.0 - 1e-9
    }

    fn tip_and_carrier_poses(&self, at: &Position) -> TipAndCarrierPoses {
        let commands = Axis::ALL.map(|axis| at.get_or_zero(axis));
        let carriers = self.obstacle_carriers.iter().map(|carried| carried.pose(&commands)).collect();
        TipAndCarrierPoses { tip: self.tip_in_machine(at), carrier_poses: carriers }
    }

    /// Tip and carrier poses at a position, and with Z 1 mm higher.
    fn present_and_raised_positions(&self, at: &Position) -> (TipAndCarrierPoses, TipAndCarrierPoses) {
        let higher = at.clone().with(Axis::Z, at.get_or_zero(Axis::Z) + 1.0);
        (self.tip_and_carrier_poses(at), self.tip_and_carrier_poses(&higher))
    }
}

impl TipAndCarrierPoses {
    /// Vector from the origin of the obstacle's carrier to the centre of the stylus ball, machine directions.
    fn tip_offset_from_carrier(&self, obstacle: &Obstacle) -> Vector3<f64> {
        self.tip - self.carrier_poses[obstacle.carrier_index].translation.vector
    }

    /// The obstacle in machine directions, relative to the origin of its carrier.
    fn obstacle_in_machine_directions(&self, obstacle: &Obstacle) -> ObstacleBody {
        obstacle.body.rotated(&self.carrier_poses[obstacle.carrier_index].rotation)
    }
}

/// Z command that holds the stylus ball's centre at `height` above the obstacle's carrier, extrapolated from the
/// present Z and from 1 mm higher; `None` if Z does not lift the ball off.
fn z_command_for_height(
    z: f64,
    [here, higher]: [&TipAndCarrierPoses; 2],
    obstacle: &Obstacle,
    height: f64,
) -> Option<f64> {
    let present_z = here.tip_offset_from_carrier(obstacle).z;
    let lift = higher.tip_offset_from_carrier(obstacle).z - present_z;
    (lift > 0.5).then(|| z + (height - present_z) / lift)
}

/// Index of a carrier in the list; a new carrier is appended.
fn find_or_add_carrier(carriers: &mut Vec<CarrierChain>, carried: CarrierChain) -> usize {
    let known = carriers.iter().position(|known| known.has_same_axes_as(&carried));
    known.unwrap_or_else(|| {
        carriers.push(carried);
        carriers.len() - 1
    })
}

/// Line from one end of the range of `sensor` to the other.
fn measuring_line(sensor: &Sensor, carrier_index: usize) -> Obstacle {
    let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
    let [from, to] = sensor.range_mm.map(|distance| zero + along * distance);
    let body = ObstacleBody::BallOrCylinder(artefact::BodyShape::Cylinder { from, to, radius: 0.0 });
    Obstacle { name: sensor.name.clone(), carrier_index, body, is_artefact_part: false, max_misplacement_mm: 0.0 }
}
