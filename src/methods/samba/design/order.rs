//! In which order the indexations follow each other.

use super::Visit;
use super::indexation::is_parallel;
use crate::base::Axis;
use crate::record::machine::Machine;

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
