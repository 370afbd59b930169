//! The design with the counts of paper 4, section 3: 32 positions of B, C and S, 109 balls; B at 0, ±10, ±30,
//! ±60 and ±90°, C in steps of 90° forward and reverse, S in steps of 90°.
//!
//! The paper does not list its positions. The design here is one assignment with exactly the counts of the paper. The
//! tilts ascend. At 0° C takes all four quarters forward and then in reverse. At each other tilt C takes three
//! quarters, alternately forward and in reverse, and the omitted quarter rotates. S advances by a quarter from
//! position to position, starts a quarter later at each tilt, and is opposite in the reverse pass at 0°, so that no
//! position occurs twice. Of the accessible balls 109 are kept: repeatedly, from the position with the most balls,
//! the ball that is measured most often is removed.

use super::{DesignCandidates, DesignSetup};
use crate::MethodRefusal;
use crate::ball_measurement::{BallVisit, is_parallel_to_spindle, is_rotary_except_spindle, is_same_angle};
use crate::samba::settings::SambaSettings;
use machine::{Axis, Position};

/// Angles of the tilting axis (B in the paper), in measuring order.
const TILTS_DEG: [f64; 9] = [-90.0, -60.0, -30.0, -10.0, 0.0, 10.0, 30.0, 60.0, 90.0];
/// Angles of the turning axis (C in the paper) and of the spindle S.
const QUARTERS_DEG: [f64; 4] = [0.0, 90.0, 180.0, 270.0];
/// Number of positions of B, C and S.
const ROTARY_POSITION_COUNT: usize = 32;
/// Number of balls measured, summed over all positions.
const BALL_MEASUREMENT_COUNT: usize = 109;

/// Positions of B, C and S as indices into [`TILTS_DEG`] (B) and [`QUARTERS_DEG`] (C and S), in measuring order.
fn rotary_angle_indices() -> Vec<[usize; 3]> {
    let mut angle_indices = Vec::new();
    for (tilt, tilt_deg) in TILTS_DEG.into_iter().enumerate() {
        let forward = (0..4_usize).filter(|c| tilt_deg == 0.0 || *c != tilt % 4);
        let forward: Vec<usize> = forward.collect();
        let reverse = forward.iter().rev();
        let turns: Vec<usize> = match tilt {
            _ if tilt_deg == 0.0 => forward.iter().chain(reverse).copied().collect(),
            even if even.is_multiple_of(2) => forward,
            _ => reverse.copied().collect(),
        };
        // In the reverse pass at 0° the spindle is opposite to the forward pass.
        let spindle = |k: usize, c: usize| if k < 4 { k } else { c + 2 };
        let indices = |(k, c): (usize, usize)| [tilt, c, (spindle(k, c) + tilt) % 4];
        angle_indices.extend(turns.into_iter().enumerate().map(indices));
    }
    angle_indices
}

/// The settings with the paper's positions.
pub fn paper_settings(settings: &SambaSettings) -> SambaSettings {
    SambaSettings {
        tilt_deg: TILTS_DEG.to_vec(),
        turn_deg: QUARTERS_DEG.to_vec(),
        spindle_deg: QUARTERS_DEG.to_vec(),
        ..settings.clone()
    }
}

/// The visits in measuring order.
///
/// # Errors
/// The machine lacks one tilting axis, one axis parallel to the spindle, or an oriented spindle; it does not reach a
/// position; fewer than 109 balls are accessible at these positions.
pub fn paper_visits(setup: &DesignSetup<'_>, candidates: &DesignCandidates) -> Result<Vec<BallVisit>, MethodRefusal> {
    let machine = &setup.plan.machine;
    let rotary: Vec<Axis> = machine.axes.keys().copied().filter(|a| is_rotary_except_spindle(*a)).collect();
    let find_axis = |parallel: bool| rotary.iter().find(|axis| is_parallel_to_spindle(**axis, machine) == parallel);
    let (Some(tilt), Some(turn), 2, true) =
        (find_axis(false), find_axis(true), rotary.len(), setup.is_spindle_oriented)
    else {
        return Err(refuse_paper_design(
            "the paper's design needs one rotary axis that tilts, one parallel to the spindle, and a spindle that \
            is oriented (axis S)",
        ));
    };
    let mut visits = Vec::new();
    for [b, c, s] in rotary_angle_indices() {
        let angles = [(*tilt, TILTS_DEG[b]), (*turn, QUARTERS_DEG[c]), (Axis::S, QUARTERS_DEG[s])];
        let is_rotary_position = |at: &Position| {
            angles.iter().all(|(axis, degree)| is_same_angle(at.get_or_zero(*axis), axis.to_mm_or_rad(*degree)))
        };
        let Some(index) = candidates.rotary_positions.iter().position(is_rotary_position) else {
            let names = angles.map(|(axis, degree)| format!("{axis}{degree}")).join(" ");
            return Err(refuse_paper_design(format!("the machine does not reach {names} of the paper's design")));
        };
        let measurements = candidates.measurements.iter().filter(|measurement| measurement.indexation_index == index);
        let balls: Vec<usize> = measurements.map(|measurement| measurement.ball_index).collect();
        let at = candidates.rotary_positions.get(index).cloned().unwrap_or_default();
        visits.push(BallVisit::new(at, balls));
    }
    let count = |visits: &[BallVisit]| visits.iter().map(|visit| visit.ball_indices.len()).sum::<usize>();
    let accessible = count(&visits);
    if accessible < BALL_MEASUREMENT_COUNT {
        return Err(refuse_paper_design(format!(
            "the paper's design measures {BALL_MEASUREMENT_COUNT} balls at {ROTARY_POSITION_COUNT} positions of B, C \
             and S; of this artefact only {accessible} are accessible there"
        )));
    }
    while count(&visits) > BALL_MEASUREMENT_COUNT {
        remove_redundant_measurement(&mut visits);
    }
    Ok(visits)
}

/// Removes one ball from the visit with the most balls: the one that is measured most often in all visits.
fn remove_redundant_measurement(visits: &mut [BallVisit]) {
    let mut counts = vec![0_usize; visits.iter().flat_map(|v| &v.ball_indices).max().map_or(0, |b| b + 1)];
    for ball in visits.iter().flat_map(|visit| &visit.ball_indices) {
        counts[*ball] += 1;
    }
    // Of visits with equal counts, the first one is chosen.
    let fullest = visits.iter_mut().rev().max_by_key(|visit| visit.ball_indices.len());
    let Some(visit) = fullest else { return };
    let most = visit.ball_indices.iter().rev().copied().max_by_key(|ball| counts[*ball]);
    visit.ball_indices.retain(|ball| Some(*ball) != most);
}

fn refuse_paper_design(reason: impl Into<String>) -> MethodRefusal {
    MethodRefusal::new(reason, "choose design = \"optimal\"")
}
