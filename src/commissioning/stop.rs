//! A stop that holds whatever moves, though the control may be opened more than once. While nothing moves
//! it only ends the check: a control that is held when it is idle has to be reset by a person.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use devices::controllers::Halt;

#[derive(Clone)]
pub struct Stop {
    halt: Halt,
    guarded: Arc<Mutex<Guarded>>,
}

#[derive(Default)]
struct Guarded {
    /// Of the open control.
    control: Option<Halt>,
    /// Something may move.
    moves: bool,
    /// The hold was sent.
    held: bool,
}

impl Guarded {
    fn hold(&mut self) {
        if let (Some(control), true) = (&self.control, self.moves) {
            self.held = true;
            control.now();
        }
    }
}

impl Default for Stop {
    fn default() -> Self {
        let guarded: Arc<Mutex<Guarded>> = Arc::default();
        let of_now = guarded.clone();
        let halt = Halt::new(move || lock(&of_now).hold());
        Self { halt, guarded }
    }
}

/// A halt is whole whatever panicked beside it.
fn lock(guarded: &Mutex<Guarded>) -> MutexGuard<'_, Guarded> {
    guarded.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Stop {
    /// For signals.
    pub fn halt(&self) -> Halt {
        self.halt.clone()
    }

    pub fn is_asked(&self) -> bool {
        self.halt.is_halted()
    }

    /// Whether it has held the control.
    pub(super) fn has_held(&self) -> bool {
        lock(&self.guarded).held
    }

    /// From now on it holds this control.
    pub(super) fn guards(&self, control: Halt) {
        lock(&self.guarded).control = Some(control);
    }

    /// Something may move until the guard is dropped, and a stop holds it. `None`: a stop was asked for, and
    /// nothing may move any more.
    pub(super) fn motion(&self) -> Option<Motion> {
        let mut guarded = lock(&self.guarded);
        guarded.moves = !self.is_asked();
        guarded.moves.then(|| Motion(self.guarded.clone()))
    }
}

pub(super) struct Motion(Arc<Mutex<Guarded>>);

impl Drop for Motion {
    fn drop(&mut self) {
        lock(&self.0).moves = false;
    }
}
