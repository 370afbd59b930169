//! In which order: indexations, and balls within them, for a short machine time.
//!
//! A tour that begins at the first visit's place in the list or anywhere, and does not return. Nearest
//! neighbour, then 2-opt and Or-opt as long as they help. Visits that must follow one another (an axis
//! that comes to each of its positions from the same side) travel as one chain that is never turned
//! round. Everything is decided by comparison in a fixed order: the same input gives the same order.

use super::time::motion_s;
use crate::base::{Axis, Position};
use crate::record::machine::Machine;

/// One indexation: what is measured there stands at these X, Y, Z.
#[derive(Debug, Clone, PartialEq)]
pub struct Visit {
    /// Rotary axes, and S if it is oriented.
    pub rotary: Position,
    /// Axis positions of the ball centres ([`super::Access::centre`]), at least one.
    pub places: Vec<Position>,
    /// It comes directly behind the visit before it in the list.
    pub follows: bool,
}

/// An indexation's turn: its number in the list, and the numbers of its places in their order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Turn {
    pub visit: usize,
    pub places: Vec<usize>,
}

/// The order of `visits`, from wherever is best.
pub fn order(visits: &[Visit], machine: &Machine) -> Vec<Turn> {
    let chains = chains(visits);
    let middles: Vec<Position> = visits.iter().map(middle).collect();
    let between: Vec<Vec<f64>> = chains
        .iter()
        .map(|one| {
            let to = |other: &Vec<usize>| match (one.last(), other.first()) {
                (Some(&end), Some(&begin)) => turn_s(&middles, visits, (end, begin), machine),
                _ => 0.0,
            };
            chains.iter().map(to).collect()
        })
        .collect();
    let tour = shortest(&between);
    let in_order = tour.iter().filter_map(|chain| chains.get(*chain)).flatten();
    let mut stands: Option<Position> = None;
    let mut turns = Vec::new();
    for &visit in in_order {
        let Some(here) = visits.get(visit) else { continue };
        let places = through(&here.places, stands.as_ref(), machine);
        stands = places.last().and_then(|last| here.places.get(*last)).cloned().or(stands);
        turns.push(Turn { visit, places });
    }
    turns
}

/// Visits that follow one another, numbers in the list.
fn chains(visits: &[Visit]) -> Vec<Vec<usize>> {
    let mut chains: Vec<Vec<usize>> = Vec::new();
    for (number, visit) in visits.iter().enumerate() {
        match chains.last_mut().filter(|_| visit.follows) {
            Some(chain) => chain.push(number),
            None => chains.push(vec![number]),
        }
    }
    chains
}

fn middle(visit: &Visit) -> Position {
    let share = 1.0 / visit.places.len().max(1) as f64;
    let mean = |axis: Axis| visit.places.iter().map(|place| place.at(axis)).sum::<f64>() * share;
    [Axis::X, Axis::Y].into_iter().map(|axis| (axis, mean(axis))).collect()
}

/// From one visit to the other: rotary axes, X and Y together, then the spindle.
fn turn_s(
    middles: &[Position],
    visits: &[Visit],
    (from, to): (usize, usize),
    machine: &Machine,
) -> f64 {
    let at = |number: usize| {
        let rotary = visits.get(number).map(|visit| visit.rotary.clone()).unwrap_or_default();
        middles.get(number).map_or(rotary.clone(), |middle| rotary.updated_by(middle))
    };
    let (from, to) = (at(from), at(to));
    let part = |keep: fn(Axis) -> bool| motion_s(&from, &to.only(keep), None, machine);
    part(|axis| axis != Axis::S) + part(|axis| axis == Axis::S)
}

/// The places of one visit, from where the machine stands.
fn through(places: &[Position], stands: Option<&Position>, machine: &Machine) -> Vec<usize> {
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
