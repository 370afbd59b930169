//! Past positions of the axes: the output of a sensor with latency belongs to an earlier position.

use std::collections::VecDeque;

use super::straight_move::MovePath;

/// Number of moves that are kept.
const MAX_STORED_MOVES: usize = 64;

/// The last moves, in the order of time.
#[derive(Debug, Clone, Default)]
pub(super) struct MotionHistory {
    moves: VecDeque<RecordedMove>,
}

/// A move that was made, possibly stopped before its target.
#[derive(Debug, Clone)]
struct RecordedMove {
    /// Simulated time of the start.
    start_s: f64,
    path: MovePath,
    /// Path fraction at which the axes came to rest.
    fraction_at_rest: f64,
}

impl MotionHistory {
    /// Adds a move that came to rest at `end_fraction` of its path; the oldest of too many moves is dropped.
    pub fn record_move(&mut self, start_s: f64, path: &MovePath, end_fraction: f64) {
        if self.moves.len() == MAX_STORED_MOVES {
            self.moves.pop_front();
        }
        self.moves.push_back(RecordedMove { start_s, path: path.clone(), fraction_at_rest: end_fraction });
    }

    /// Path of the last move that began at or before `t_s`, and the path fraction at `t_s`. Before the first stored
    /// move: the start of its path. `None`: no move is recorded.
    pub fn path_and_fraction_at(&self, t_s: f64) -> Option<(&MovePath, f64)> {
        let last_begun = self.moves.iter().rev().find(|recorded| recorded.start_s <= t_s);
        let RecordedMove { start_s, path, fraction_at_rest: end_fraction } = last_begun.or(self.moves.front())?;
        Some((path, path.velocity_profile.fraction_after(0.0, t_s - start_s).min(*end_fraction)))
    }
}
