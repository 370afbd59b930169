//! Order of the balls of one indexation, for a short machine time.
//!
//! The order is an open tour: it begins at the position of the machine or at any ball, and does not return. From
//! each first ball, a nearest-neighbour tour is improved by 2-opt and Or-opt until neither helps. All decisions are
//! comparisons in a fixed order: the same input gives the same order.

use super::machine_time::motion_time_s;
use machine::record::machine::Machine;
use machine::{Axis, Position};

/// Times of the moves between places, s.
#[derive(Debug, Clone)]
pub struct TravelTimes {
    /// Time from each place (row) to each place (column).
    pub pairwise_s: Vec<Vec<f64>>,
    /// Time to each place from the position of the machine; `None`: the tour may begin at any place.
    pub from_start_s: Option<Vec<f64>>,
}

impl TravelTimes {
    /// Times between axis positions, for X and Y alone. `position`: start of the tour.
    pub fn from_xy_positions(places: &[Position], position: Option<&Position>, machine: &Machine) -> Self {
        let way = |from: &Position, to: &Position| {
            let over = |axis| matches!(axis, Axis::X | Axis::Y);
            motion_time_s(from, &to.filter_axes(over), None, machine)
        };
        let from = |from: &Position| places.iter().map(|to| way(from, to)).collect();
        Self { pairwise_s: places.iter().map(from).collect(), from_start_s: position.map(from) }
    }

    /// Indices of the places in visiting order. With a start position, only the `first_candidate_count` places
    /// nearest to the start are tried as first place; without, all places.
    pub fn visiting_order(&self, first_candidate_count: usize) -> Vec<usize> {
        let pairwise_s = &self.pairwise_s;
        let Some(from_start_s) = &self.from_start_s else {
            let all = 0..pairwise_s.len();
            let tours = all.map(|first| improve_tour(nearest_neighbour_tour(pairwise_s, vec![first]), 0, pairwise_s));
            return fastest_tour(tours, pairwise_s);
        };
        // Node 0 is the position of the machine.
        let mut nodes = vec![[&[0.0], &from_start_s[..]].concat()];
        nodes.extend(pairwise_s.iter().map(|row| [&[0.0], &row[..]].concat()));
        let mut order: Vec<usize> = (1..nodes.len()).collect();
        order.sort_by(|a, b| nodes[0][*a].total_cmp(&nodes[0][*b]));
        let begun =
            order.into_iter().take(first_candidate_count).map(|first| nearest_neighbour_tour(&nodes, vec![0, first]));
        let tour = fastest_tour(begun.map(|tour| improve_tour(tour, 1, &nodes)), &nodes);
        tour.into_iter().skip(1).map(|node| node - 1).collect()
    }
}

fn fastest_tour(tours: impl Iterator<Item = Vec<usize>>, pairwise_s: &[Vec<f64>]) -> Vec<usize> {
    let better = |a: &Vec<usize>, b: &Vec<usize>| tour_time_s(a, pairwise_s).total_cmp(&tour_time_s(b, pairwise_s));
    tours.min_by(better).unwrap_or_default()
}

fn travel_time_s(pairwise_s: &[Vec<f64>], from: usize, to: usize) -> f64 {
    pairwise_s.get(from).and_then(|row| row.get(to)).copied().unwrap_or(0.0)
}

fn tour_time_s(tour: &[usize], pairwise_s: &[Vec<f64>]) -> f64 {
    tour.iter().zip(tour.iter().skip(1)).map(|(from, to)| travel_time_s(pairwise_s, *from, *to)).sum()
}

/// Extends the tour to the nearest remaining node, until none remains.
fn nearest_neighbour_tour(pairwise_s: &[Vec<f64>], mut tour: Vec<usize>) -> Vec<usize> {
    let mut left: Vec<usize> = (0..pairwise_s.len()).filter(|node| !tour.contains(node)).collect();
    let mut here = tour.last().copied().unwrap_or_default();
    while !left.is_empty() {
        let nearer = |a: &(usize, &usize), b: &(usize, &usize)| {
            travel_time_s(pairwise_s, here, *a.1).total_cmp(&travel_time_s(pairwise_s, here, *b.1))
        };
        let next = left.iter().enumerate().min_by(nearer).map_or(0, |(index, _)| index);
        here = left.remove(next);
        tour.push(here);
    }
    tour
}

/// Applies 2-opt and Or-opt until neither helps; the first `fixed_count` nodes keep their place.
fn improve_tour(mut tour: Vec<usize>, fixed_count: usize, pairwise_s: &[Vec<f64>]) -> Vec<usize> {
    let mut best = tour_time_s(&tour, pairwise_s);
    // Minimum time saving that counts as an improvement, s; a smaller saving is rounding error.
    const MIN_TIME_SAVING_S: f64 = 1e-9;
    loop {
        let candidates = neighbour_tours(&tour, fixed_count);
        let better = candidates
            .map(|candidate| (tour_time_s(&candidate, pairwise_s), candidate))
            .find(|(length, _)| *length < best - MIN_TIME_SAVING_S);
        let Some((length, candidate)) = better else { return tour };
        (best, tour) = (length, candidate);
    }
}

/// All tours with one section reversed, or with a section of up to three nodes moved.
fn neighbour_tours(tour: &[usize], fixed_count: usize) -> impl Iterator<Item = Vec<usize>> + '_ {
    let count = tour.len();
    let sections = move |longest: usize| {
        (fixed_count..count)
            .flat_map(move |from| (from + 1..=count.min(from.saturating_add(longest))).map(move |to| (from, to)))
    };
    let with_reversed_section = sections(count).map(|(from, to)| {
        let (before, rest) = tour.split_at(from);
        let (section, after) = rest.split_at(to - from);
        before.iter().chain(section.iter().rev()).chain(after).copied().collect()
    });
    let with_moved_section = sections(3).flat_map(move |(from, to)| {
        let (before, rest) = tour.split_at(from);
        let (section, after) = rest.split_at(to - from);
        let others: Vec<usize> = before.iter().chain(after).copied().collect();
        (fixed_count..=others.len()).map(move |at| {
            let (before, after) = others.split_at(at);
            before.iter().chain(section).chain(after).copied().collect()
        })
    });
    with_reversed_section.chain(with_moved_section)
}
