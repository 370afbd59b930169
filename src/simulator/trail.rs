//! Past positions of the axes: the output of a sensor with latency belongs to an earlier position.

use std::collections::VecDeque;

use super::path::Path;

/// Number of moves that are kept.
const MAX_STORED_MOVES: usize = 64;

/// The last moves, in the order of time.
#[derive(Debug, Clone, Default)]
pub(super) struct MotionHistory {
    moves: VecDeque<Move>,
}

#[derive(Debug, Clone)]
struct Move {
    begins_s: f64,
    path: Path,
    /// Path fraction at which the axes came to rest.
    ends: f64,
}

impl MotionHistory {
    pub fn went(&mut self, begins_s: f64, path: &Path, ends: f64) {
        if self.moves.len() == MAX_STORED_MOVES {
            self.moves.pop_front();
        }
        self.moves.push_back(Move { begins_s, path: path.clone(), ends });
    }

    /// The path that was last begun before `t_s`, and the path fraction at `t_s`; before the first move, its start.
    pub fn at(&self, t_s: f64) -> Option<(&Path, f64)> {
        let begun = self.moves.iter().rev().find(|one| one.begins_s <= t_s);
        let Move { begins_s, path, ends } = begun.or(self.moves.front())?;
        Some((path, path.ramp().later(0.0, t_s - begins_s).min(*ends)))
    }
}
