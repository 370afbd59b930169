//! In which order the indexations follow each other, and the balls at each.

use super::indexation::is_parallel;
use super::{Bench, Visit};
use crate::base::Axis;
use crate::methods::Refused;
use crate::planning::{self, Access};
use crate::record::machine::Machine;

/// The balls of each visit on a short way, the visits as they stand.
///
/// # Errors
/// A ball whose place cannot be computed.
pub fn balls_in_order(
    bench: &Bench<'_>,
    access: &Access,
    mut visits: Vec<Visit>,
) -> Result<Vec<Visit>, Refused> {
    let mut stations = Vec::new();
    for visit in &visits {
        let balls = visit.balls.iter().filter_map(|index| bench.balls.balls.get(*index));
        let places = balls.map(|ball| access.centre(ball, &visit.at)).collect::<Result<_, _>>();
        let places = places.map_err(|error| Refused {
            why: error.to_string(),
            instead: "correct [axes] in the machine file".to_owned(),
        })?;
        stations.push(planning::Visit { rotary: visit.at.clone(), places, follows: true });
    }
    for turn in planning::order(&stations, &bench.plan.machine) {
        if let Some(visit) = visits.get_mut(turn.visit) {
            let at = |place: &usize| visit.balls.get(*place).copied();
            visit.balls = turn.places.iter().filter_map(at).collect();
        }
    }
    Ok(visits)
}

/// Sorted by tilt; the axis parallel to the spindle sweeps forward at one tilt and back at the next,
/// so that backlash and drift do not side with its angle, and the spindle likewise within it.
pub fn in_order(machine: &Machine, visits: Vec<Visit>) -> Vec<Visit> {
    let mut axes: Vec<Axis> = machine.axes.keys().copied().filter(|a| !a.is_linear()).collect();
    axes.sort_by_key(|axis| (*axis == Axis::S, is_parallel(*axis, machine)));
    let mut sorted = visits;
    sweep(&mut sorted, &axes, &mut false);
    sorted
}

/// Sorts by the first of `axes`, and within equal positions by the others, each run the other way
/// round than the one before.
fn sweep(visits: &mut [Visit], axes: &[Axis], backward: &mut bool) {
    let Some((first, rest)) = axes.split_first() else { return };
    let at = |visit: &Visit| visit.at.at(*first);
    visits.sort_by(|a, b| at(a).total_cmp(&at(b)));
    let mut inner = false;
    for run in visits.chunk_by_mut(|a, b| at(a) == at(b)) {
        sweep(run, rest, &mut inner);
    }
    if *backward {
        visits.reverse();
    }
    *backward = !*backward;
}
