//! A step of the machine where the measurement was interrupted.

use nalgebra::Vector3;

use super::{Draw, Shape, UncertaintySource, repeatability, spread};
use crate::decision::references::{Limits, Pair, Scatter, Shift, places};
use crate::samba::observe::Sight;
use machine::Axis;
use machine::record::plan::Plan;

pub const STEP: &str = "steps at interruptions";

/// All that was measured after an interruption may lie apart from what was measured before, in X, Y and
/// Z, by as much as the references that were measured again are allowed to. That whole limit counts as standard
/// uncertainty: nobody knows how steps spread, and one near the limit in all three axes is still covered.
pub fn steps(plan: &Plan, sights: &[Sight]) -> UncertaintySource {
    let draws = plan.gaps_s.iter().flat_map(|gap_s| at(plan, sights, *gap_s)).collect();
    UncertaintySource { name: STEP, shape: Shape::Normal, draws, shown: true }
}

/// None, unless something was measured on either side.
fn at(plan: &Plan, sights: &[Sight], gap_s: f64) -> Vec<Draw> {
    let times = || sights.iter().map(|sight| sight.t_s);
    let before = times().filter(|t_s| *t_s <= gap_s).reduce(f64::max);
    let after = times().filter(|t_s| *t_s > gap_s).reduce(f64::min);
    let (Some(before), Some(after)) = (before, after) else { return Vec::new() };
    let step = |axis: Axis| {
        let u = limit(plan, axis, [before, after]);
        spread(
            sights,
            |sight| if sight.t_s > gap_s { axis.direction() * u } else { Vector3::zeros() },
        )
    };
    Axis::LINEAR.into_iter().map(step).collect()
}

/// Of a reference that is touched along the axis, mm.
fn limit(plan: &Plan, axis: Axis, t_s: [f64; 2]) -> f64 {
    let spec = plan.machine.axes.get(&axis);
    let pair = Pair {
        label: String::new(),
        position_mm: [0.0; 2],
        t_s,
        resolution_mm: spec.map_or(0.0, |spec| spec.resolution_um * 1e-3),
    };
    let scatter = Scatter::Declared { u_mm: repeatability(plan) };
    let drift_mm_per_s = plan.machine.drift_um_per_h * 1e-3 / 3600.0;
    Shift::of(&pair, &Limits::new(scatter, places(plan), drift_mm_per_s)).limit_mm
}
