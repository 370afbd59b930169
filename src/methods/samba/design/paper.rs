//! The design with the counts of paper 4, section 3: 32 triples of B, C and S, 109 balls; B at 0, ±10, ±30,
//! ±60 and ±90°, C in steps of 90° forward and reverse, S in steps of 90°.
//!
//! The paper does not list its triples. This is one assignment with exactly its counts. The tilts ascend. At
//! 0° C takes all four quarters forward and then in reverse. At each other tilt C takes three quarters,
//! alternately forward and in reverse, and the omitted quarter rotates. S advances by a quarter from triple
//! to triple, starts a quarter later at each tilt, and is opposite in the reverse pass at 0°, so that no
//! triple occurs twice. Of the accessible balls 109 are kept: repeatedly, from the triple with the most
//! balls, the ball that is measured most often is removed.

use super::{Candidates, DesignSetup};
use crate::Refused;
use crate::ball_measurement::{Visit, is_parallel, is_rotary, is_same};
use crate::samba::settings::Settings;
use machine::{Axis, Position};

const TILTS_DEG: [f64; 9] = [-90.0, -60.0, -30.0, -10.0, 0.0, 10.0, 30.0, 60.0, 90.0];
const QUARTERS_DEG: [f64; 4] = [0.0, 90.0, 180.0, 270.0];
const TRIPLES: usize = 32;
const BALLS: usize = 109;

/// Triples as indices into [`TILTS_DEG`] (B) and [`QUARTERS_DEG`] (C and S), in measuring order.
fn triples() -> Vec<[usize; 3]> {
    let mut triples = Vec::new();
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
        let triple = |(k, c): (usize, usize)| [tilt, c, (spindle(k, c) + tilt) % 4];
        triples.extend(turns.into_iter().enumerate().map(triple));
    }
    triples
}

/// The settings with the paper's positions.
pub fn settings(settings: &Settings) -> Settings {
    Settings {
        tilt_deg: TILTS_DEG.to_vec(),
        turn_deg: QUARTERS_DEG.to_vec(),
        spindle_deg: QUARTERS_DEG.to_vec(),
        ..settings.clone()
    }
}

/// The visits in measuring order.
///
/// # Errors
/// The machine lacks one tilting axis, one axis parallel to the spindle, or an oriented spindle; fewer than
/// 109 balls are accessible at these triples.
pub fn visits(bench: &DesignSetup<'_>, candidates: &Candidates) -> Result<Vec<Visit>, Refused> {
    let machine = &bench.plan.machine;
    let rotary: Vec<Axis> = machine.axes.keys().copied().filter(|a| is_rotary(*a)).collect();
    let of = |parallel: bool| rotary.iter().find(|axis| is_parallel(**axis, machine) == parallel);
    let (Some(tilt), Some(turn), 2, true) = (of(false), of(true), rotary.len(), bench.oriented)
    else {
        return Err(refused(
            "the paper's design needs one rotary axis that tilts, one parallel to the spindle, and a \
             spindle that is oriented (axis S)"
                .to_owned(),
        ));
    };
    let mut visits = Vec::new();
    for [b, c, s] in triples() {
        let wanted = [(*tilt, TILTS_DEG[b]), (*turn, QUARTERS_DEG[c]), (Axis::S, QUARTERS_DEG[s])];
        let stands = |at: &Position| {
            wanted.iter().all(|(axis, degree)| is_same(at.at(*axis), axis.from_edge(*degree)))
        };
        let Some(place) = candidates.at.iter().position(stands) else {
            let words = wanted.map(|(axis, degree)| format!("{axis}{degree}")).join(" ");
            return Err(refused(format!(
                "the machine does not reach {words} of the paper's design"
            )));
        };
        let there = candidates.sights.iter().filter(|sight| sight.indexation == place);
        let balls: Vec<usize> = there.map(|sight| sight.ball).collect();
        let at = candidates.at.get(place).cloned().unwrap_or_default();
        visits.push(Visit::new(at, balls));
    }
    let count = |visits: &[Visit]| visits.iter().map(|visit| visit.balls.len()).sum::<usize>();
    let accessible = count(&visits);
    if accessible < BALLS {
        return Err(refused(format!(
            "the paper's design measures {BALLS} balls at {TRIPLES} triples; of this artefact only \
             {accessible} are accessible there"
        )));
    }
    while count(&visits) > BALLS {
        leave_one_out(&mut visits);
    }
    Ok(visits)
}

fn leave_one_out(visits: &mut [Visit]) {
    let mut often = vec![0_usize; visits.iter().flat_map(|v| &v.balls).max().map_or(0, |b| b + 1)];
    for ball in visits.iter().flat_map(|visit| &visit.balls) {
        often[*ball] += 1;
    }
    // The first of equal visits.
    let fullest = visits.iter_mut().rev().max_by_key(|visit| visit.balls.len());
    let Some(visit) = fullest else { return };
    let most = visit.balls.iter().rev().copied().max_by_key(|ball| often[*ball]);
    visit.balls.retain(|ball| Some(*ball) != most);
}

fn refused(why: String) -> Refused {
    Refused { why, instead: "choose design = \"optimal\"".to_owned() }
}
