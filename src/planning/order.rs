//! Order of the balls of one indexation, for a short machine time.
//!
//! The order is an open tour: it begins at the position of the machine or at any ball, and does not return. From
//! each first ball, a nearest-neighbour tour is improved by 2-opt and Or-opt until neither helps. All decisions are
//! comparisons in a fixed order: the same input gives the same order.

use super::time::motion_s;
use machine::record::machine::Machine;
use machine::{Axis, Position};

/// Times of the moves between places, s.
#[derive(Debug, Clone)]
pub struct TravelTimes {
    /// Time from each place to each.
    pub between: Vec<Vec<f64>>,
    /// Time to each place from the position of the machine; `None`: the tour may begin at any place.
    pub from_stand: Option<Vec<f64>>,
}

impl TravelTimes {
    /// Times between axis positions, for X and Y alone.
    pub fn in_xy(places: &[Position], stands: Option<&Position>, machine: &Machine) -> Self {
        let way = |from: &Position, to: &Position| {
            let over = |axis| matches!(axis, Axis::X | Axis::Y);
            motion_s(from, &to.only(over), None, machine)
        };
        let from = |from: &Position| places.iter().map(|to| way(from, to)).collect();
        Self { between: places.iter().map(from).collect(), from_stand: stands.map(from) }
    }

    /// Indices of the places in visiting order. With a start position, `firsts` first places are tried, the nearest
    /// first.
    pub fn tour(&self, firsts: usize) -> Vec<usize> {
        let between = &self.between;
        let Some(from_stand) = &self.from_stand else {
            let all = 0..between.len();
            let tours = all.map(|first| improved(nearest(between, vec![first]), 0, between));
            return shortest(tours, between);
        };
        // Node 0 is the position of the machine.
        let mut nodes = vec![[&[0.0], &from_stand[..]].concat()];
        nodes.extend(between.iter().map(|row| [&[0.0], &row[..]].concat()));
        let mut order: Vec<usize> = (1..nodes.len()).collect();
        order.sort_by(|a, b| nodes[0][*a].total_cmp(&nodes[0][*b]));
        let begun = order.into_iter().take(firsts).map(|first| nearest(&nodes, vec![0, first]));
        let tour = shortest(begun.map(|tour| improved(tour, 1, &nodes)), &nodes);
        tour.into_iter().skip(1).map(|node| node - 1).collect()
    }
}

fn shortest(tours: impl Iterator<Item = Vec<usize>>, between: &[Vec<f64>]) -> Vec<usize> {
    let better = |a: &Vec<usize>, b: &Vec<usize>| length(a, between).total_cmp(&length(b, between));
    tours.min_by(better).unwrap_or_default()
}

fn cost(between: &[Vec<f64>], from: usize, to: usize) -> f64 {
    between.get(from).and_then(|row| row.get(to)).copied().unwrap_or(0.0)
}

fn length(tour: &[usize], between: &[Vec<f64>]) -> f64 {
    tour.iter().zip(tour.iter().skip(1)).map(|(from, to)| cost(between, *from, *to)).sum()
}

/// Extends the tour to the nearest remaining node, until none remains.
fn nearest(between: &[Vec<f64>], mut tour: Vec<usize>) -> Vec<usize> {
    let mut left: Vec<usize> = (0..between.len()).filter(|node| !tour.contains(node)).collect();
    let mut here = tour.last().copied().unwrap_or_default();
    while !left.is_empty() {
        let nearer = |a: &(usize, &usize), b: &(usize, &usize)| {
            cost(between, here, *a.1).total_cmp(&cost(between, here, *b.1))
        };
        let next = left.iter().enumerate().min_by(nearer).map_or(0, |(index, _)| index);
        here = left.remove(next);
        tour.push(here);
    }
    tour
}

/// Applies 2-opt and Or-opt until neither helps; the first `fixed` nodes keep their place.
fn improved(mut tour: Vec<usize>, fixed: usize, between: &[Vec<f64>]) -> Vec<usize> {
    let mut best = length(&tour, between);
    // Minimum gain of a step, s; a smaller gain is rounding.
    const GAIN_S: f64 = 1e-9;
    loop {
        let candidates = neighbours(&tour, fixed);
        let better = candidates
            .map(|candidate| (length(&candidate, between), candidate))
            .find(|(length, _)| *length < best - GAIN_S);
        let Some((length, candidate)) = better else { return tour };
        (best, tour) = (length, candidate);
    }
}

/// All tours with one section reversed, or with a section of up to three nodes moved.
fn neighbours(tour: &[usize], fixed: usize) -> impl Iterator<Item = Vec<usize>> + '_ {
    let count = tour.len();
    let pieces = move |longest: usize| {
        (fixed..count).flat_map(move |from| {
            (from + 1..=count.min(from.saturating_add(longest))).map(move |to| (from, to))
        })
    };
    let turned = pieces(count).map(|(from, to)| {
        let (before, rest) = tour.split_at(from);
        let (piece, after) = rest.split_at(to - from);
        before.iter().chain(piece.iter().rev()).chain(after).copied().collect()
    });
    let moved = pieces(3).flat_map(move |(from, to)| {
        let (before, rest) = tour.split_at(from);
        let (piece, after) = rest.split_at(to - from);
        let others: Vec<usize> = before.iter().chain(after).copied().collect();
        (fixed..=others.len()).map(move |at| {
            let (before, after) = others.split_at(at);
            before.iter().chain(piece).chain(after).copied().collect()
        })
    });
    turned.chain(moved)
}
