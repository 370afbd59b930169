//! How fast axes may move while no touch has confirmed where the machine stands.

use nalgebra::Vector3;

use super::hull::Body;
use machine::artefact;
use machine::kinematics::Chain;
use machine::record::machine::Carrier;
use machine::record::plan::Plan;
use machine::record::sensor::{Mount, Sensor};
use machine::{Axis, Position};

/// From contact, or a sensor's first distance, to the hold. No control looks at the probe while an axis
/// turns: its reports show the contact. They are asked for five times a second at least, and what they
/// show must come back as a hold (devices: `FREE_MOVE_POLL` of grbl, `Patience::poll` of modbus).
const LATENCY_S: f64 = 0.3;

/// The speed, mm/s, from which a hold stops within `within_mm` at the acceleration `a`, mm/s²:
/// v = √(2a(within − v·latency)).
pub(super) fn stopping_speed(a: f64, within_mm: f64) -> f64 {
    a * ((LATENCY_S.powi(2) + 2.0 * within_mm / a).sqrt() - LATENCY_S)
}

/// Degrees a minute, from where the axes stand: what `axis` carries comes to rest within the probe's
/// overtravel ([`stopping_speed`]), wherever on its surface the stylus met it, and is no faster than a
/// guarded move.
pub(super) fn feed_at_most(plan: &Plan, chain: &Chain, axis: Axis, stands: &Position) -> f64 {
    let Some(spec) = plan.machine.axes.get(&axis) else { return 0.0 };
    let lever = lever_mm(plan, chain, axis, stands);
    let a = axis.from_edge(spec.acceleration_per_s2) * lever;
    let stops = stopping_speed(a, plan.probe.overtravel_mm);
    let surface = stops.min(plan.probe.guarded_feed_mm_min / 60.0);
    let turn = axis.to_edge(surface / lever) * 60.0;
    // Nothing stands off the axis: there is no surface that moves.
    if turn.is_finite() { turn.min(spec.rapid_per_min) } else { spec.rapid_per_min }
}

/// The farthest that anything declared which the axis carries reaches from its line, mm.
fn lever_mm(plan: &Plan, chain: &Chain, axis: Axis, stands: &Position) -> f64 {
    let Some(line) = chain.axis_line(axis, stands) else { return 0.0 };
    let commands = Axis::ALL.map(|axis| stands.at(axis));
    let parts = artefact::parts(&plan.artefact).into_iter();
    let parts = parts.map(|part| (Carrier::Table, Body::Round(part.shape)));
    let solids = plan.solids.iter().map(|solid| (solid.on, Body::of(solid)));
    let (ball, tip) = (plan.probe.ball_radius_mm, Vector3::from(plan.machine.tool_mm));
    let stylus = artefact::Shape::Ball { centre: tip, radius: ball };
    let on_table = plan.sensors.iter().filter(|sensor| sensor.mount == Mount::Table);
    let sensors = on_table.map(|sensor| (Carrier::Table, sensor_body(sensor)));
    let bodies = parts.chain(solids).chain(sensors);
    let bodies = bodies.chain([(Carrier::Spindle, Body::Round(stylus))]);
    let reach = |(on, body): (Carrier, Body)| {
        let carried = chain.carried(on).filter(|carried| carried.axes().any(|moves| moves == axis));
        let pose = carried?.pose(&commands);
        let (points, radius) = body.points();
        let off = points.iter().map(|point| {
            let off = pose.transform_point(&(*point).into()).coords - line.point;
            (off - line.direction * off.dot(&line.direction)).norm()
        });
        Some(off.fold(0.0, f64::max) + radius)
    };
    bodies.filter_map(reach).fold(0.0, f64::max)
}

fn sensor_body(sensor: &Sensor) -> Body {
    let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
    let from = zero - along * sensor.stand_off_mm;
    let (to, radius) = (from - along * sensor.body_length_mm, sensor.body_radius_mm);
    Body::Round(artefact::Shape::Cylinder { from, to, radius })
}
