//! Which ball can be measured at which indexation.
use glam::DVec3;

use super::bench::Bench;
use crate::base::{Axis, Position};
use crate::record::artefact::Ball;

/// `Err`: why not.
pub fn accessible(bench: &Bench<'_>, at: &Position, ball: &Ball) -> Result<(), String> {
    let on = bench.on_ball(at, ball).map_err(|refused| refused.why)?;
    let probe = bench.plan.probe.ball_radius_mm;
    let away = ball.radius_mm + probe + bench.settings.standoff_mm + bench.balls.uncertainty_mm;
    for axis in Axis::LINEAR {
        let Some(spec) = bench.plan.machine.axes.get(&axis) else { continue };
        let value = on.at(axis);
        if value - away < spec.min || value + away > spec.max {
            return Err(format!("{axis} would go to {value:.1} mm, too near to its limits"));
        }
    }
    let chain = bench.model.chain();
    let table = chain.machine_from_table(at, &[]).matrix3.transpose();
    let up = table * chain.machine_from_spindle(at, &[]).matrix3 * DVec3::Z;
    let stem = DVec3::from_array(ball.stem).normalize_or_zero();
    if stem.dot(up) > 0.05 {
        return Err("the stem stands in the way of the stylus".to_owned());
    }
    let centre = DVec3::from_array(ball.centre_mm);
    for other in bench.balls.balls.iter().filter(|other| other.id != ball.id) {
        let apart = DVec3::from_array(other.centre_mm) - centre;
        let along = apart.dot(up).max(0.0);
        if (apart - up * along).length() < other.radius_mm + away + probe {
            return Err(format!("ball {} stands in the way", other.id));
        }
    }
    Ok(())
}
