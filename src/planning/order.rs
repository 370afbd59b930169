//! In which order the balls of one indexation, for a short machine time.
//!
//! A tour that begins where the machine stands or anywhere, and does not return. Nearest neighbour, then
//! 2-opt and Or-opt as long as they help. Everything is decided by comparison in a fixed order: the
//! same input gives the same order.

use super::time::motion_s;
use machine::record::machine::Machine;
use machine::{Axis, Position};

/// Numbers of the `places` in the order in which to go through them: axis positions, X and Y count.
/// `stands`: where the machine comes from; `None`: begin wherever is best.
pub fn tour(places: &[Position], stands: Option<&Position>, machine: &Machine) -> Vec<usize> {
    let way = |from: &Position, to: &Position| {
        let over = |axis| matches!(axis, Axis::X | Axis::Y);
        motion_s(from, &to.only(over), None, machine)
    };
    // The first node is where the machine stands.
    let mut nodes: Vec<&Position> = stands.into_iter().collect();
    nodes.extend(places);
    let between: Vec<Vec<f64>> =
        nodes.iter().map(|a| nodes.iter().map(|b| way(a, b)).collect()).collect();
    match stands {
        None => shortest(&between),
        Some(_) => from_first(&between).into_iter().skip(1).map(|node| node - 1).collect(),
    }
}

/// The best of the tours from each node.
fn shortest(between: &[Vec<f64>]) -> Vec<usize> {
    let tours = (0..between.len()).map(|first| improved(nearest(between, first), 0, between));
    let better = |a: &Vec<usize>, b: &Vec<usize>| length(a, between).total_cmp(&length(b, between));
    tours.min_by(better).unwrap_or_default()
}

/// The tour that begins at the first node.
fn from_first(between: &[Vec<f64>]) -> Vec<usize> {
    improved(nearest(between, 0), 1, between)
}

fn cost(between: &[Vec<f64>], from: usize, to: usize) -> f64 {
    between.get(from).and_then(|row| row.get(to)).copied().unwrap_or(0.0)
}

fn length(tour: &[usize], between: &[Vec<f64>]) -> f64 {
    tour.iter().zip(tour.iter().skip(1)).map(|(from, to)| cost(between, *from, *to)).sum()
}

fn nearest(between: &[Vec<f64>], first: usize) -> Vec<usize> {
    let mut left: Vec<usize> = (0..between.len()).filter(|node| *node != first).collect();
    let mut tour = vec![first];
    let mut here = first;
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

/// 2-opt and Or-opt until neither helps; the first `fixed` nodes keep their place.
fn improved(mut tour: Vec<usize>, fixed: usize, between: &[Vec<f64>]) -> Vec<usize> {
    let mut best = length(&tour, between);
    // A step that gains less than this is rounding.
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

/// All tours with one piece turned round, or one of up to three nodes put elsewhere.
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
