//! A stop that holds a moving machine, even if the control is opened more than once. At rest it only ends the
//! check: an operator would have to reset a control that was held while idle.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use devices::controllers::Halt;

#[derive(Clone)]
pub struct Stop {
    halt: Halt,
    guarded: Arc<Mutex<Guarded>>,
}

#[derive(Default)]
struct Guarded {
    /// Halt handle of the open control.
    control: Option<Halt>,
    /// Whether a motion may be in progress.
    moves: bool,
    /// Whether the hold was sent.
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

/// Locks the state; it is valid even if another thread has panicked.
fn lock(guarded: &Mutex<Guarded>) -> MutexGuard<'_, Guarded> {
    guarded.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Stop {
    /// Halt handle for signals.
    pub fn halt(&self) -> Halt {
        self.halt.clone()
    }

    pub fn is_asked(&self) -> bool {
        self.halt.is_halted()
    }

    /// Whether the stop has held the control.
    pub(super) fn has_held(&self) -> bool {
        lock(&self.guarded).held
    }

    /// Sets the control that the stop holds.
    pub(super) fn guards(&self, control: Halt) {
        lock(&self.guarded).control = Some(control);
    }

    /// Begins a motion, which a stop holds until the guard is dropped. `None`: a stop was requested, and no
    /// motion may begin.
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
