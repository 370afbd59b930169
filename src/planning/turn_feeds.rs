//! Maximum feeds while no touch has verified the position of the machine.

use nalgebra::Vector3;

use super::obstacle_body::ObstacleBody;
use machine::artefact;
use machine::kinematics::KinematicChain;
use machine::record::machine::Carrier;
use machine::record::plan::Plan;
use machine::record::sensor::{Sensor, SensorMount};
use machine::{Axis, Position};

/// Latency from contact, or from a sensor's first distance, to the hold, s. No control checks the probe while an axis
/// turns, but its status reports show the contact. They are polled at least five times per second, and the driver must
/// answer them with a hold (devices: `MAX_POSITIONING_POLL_INTERVAL` of grbl, `ModbusTimeouts::poll_interval` of
/// modbus).
const CONTACT_TO_HOLD_LATENCY_S: f64 = 0.3;

/// Speed, mm/s, from which a hold stops within `within_mm` at the acceleration `a`, mm/s²: v = √(2a(within −
/// v·latency)).
pub(super) fn max_stoppable_speed_mm_s(a: f64, within_mm: f64) -> f64 {
    a * ((CONTACT_TO_HOLD_LATENCY_S.powi(2) + 2.0 * within_mm / a).sqrt() - CONTACT_TO_HOLD_LATENCY_S)
}

/// Maximum feed of `axis` at `position`, degrees/min. From this feed, the parts that the axis carries stop within
/// the probe's overtravel ([`max_stoppable_speed_mm_s`]), wherever on their surface the stylus meets them, and they
/// are no faster than a guarded move. At most the rapid speed; 0 if the machine does not have the axis.
pub(super) fn max_turn_feed_deg_min(plan: &Plan, chain: &KinematicChain, axis: Axis, position: &Position) -> f64 {
    let Some(spec) = plan.machine.axes.get(&axis) else { return 0.0 };
    let lever = max_lever_mm(plan, chain, axis, position);
    let a = axis.to_mm_or_rad(spec.acceleration_per_s2) * lever;
    let stops = max_stoppable_speed_mm_s(a, plan.probe.overtravel_mm);
    let surface = stops.min(plan.probe.guarded_feed_mm_min / 60.0);
    let turn = axis.to_mm_or_deg(surface / lever) * 60.0;
    // The feed is not finite if no body is off the axis: then no surface moves.
    if turn.is_finite() { turn.min(spec.rapid_per_min) } else { spec.rapid_per_min }
}

/// Maximum distance between the line of `axis` and any point of the declared bodies that it carries, mm.
fn max_lever_mm(plan: &Plan, chain: &KinematicChain, axis: Axis, position: &Position) -> f64 {
    let Some(line) = chain.axis_line(axis, position) else { return 0.0 };
    let commands = Axis::ALL.map(|axis| position.get_or_zero(axis));
    let parts = artefact::artefact_bodies(&plan.artefact).into_iter();
    let parts = parts.map(|part| (Carrier::Table, ObstacleBody::BallOrCylinder(part.shape)));
    let solids = plan.solids.iter().map(|solid| (solid.on, ObstacleBody::from_solid(solid)));
    let (ball, tip) = (plan.probe.ball_radius_mm, Vector3::from(plan.machine.tool_mm));
    let stylus = artefact::BodyShape::Ball { centre: tip, radius: ball };
    let on_table = plan.sensors.iter().filter(|sensor| sensor.mount == SensorMount::Table);
    let sensors = on_table.map(|sensor| (Carrier::Table, sensor_body(sensor)));
    let bodies = parts.chain(solids).chain(sensors);
    let bodies = bodies.chain([(Carrier::Spindle, ObstacleBody::BallOrCylinder(stylus))]);
    let reach = |(on, body): (Carrier, ObstacleBody)| {
        let carried = chain.carrier_chain(on).filter(|carried| carried.axes().any(|moves| moves == axis));
        let pose = carried?.pose(&commands);
        let (points, radius) = body.hull_points_and_radius();
        let off = points.iter().map(|point| {
            let off = pose.transform_point(&(*point).into()).coords - line.point;
            (off - line.direction * off.dot(&line.direction)).norm()
        });
        Some(off.fold(0.0, f64::max) + radius)
    };
    bodies.filter_map(reach).fold(0.0, f64::max)
}

fn sensor_body(sensor: &Sensor) -> ObstacleBody {
    let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
    let from = zero - along * sensor.stand_off_mm;
    let (to, radius) = (from - along * sensor.body_length_mm, sensor.body_radius_mm);
    ObstacleBody::BallOrCylinder(artefact::BodyShape::Cylinder { from, to, radius })
}
