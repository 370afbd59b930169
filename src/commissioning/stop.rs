//! A stop that holds whatever is open, though the control may be opened more than once.

use std::sync::{Arc, Mutex, PoisonError};

use devices::controllers::Halt;

#[derive(Clone)]
pub struct Stop {
    halt: Halt,
    open: Arc<Mutex<Option<Halt>>>,
}

impl Default for Stop {
    fn default() -> Self {
        let open: Arc<Mutex<Option<Halt>>> = Arc::default();
        let of_now = open.clone();
        let halt = Halt::new(move || {
            // A halt is whole whatever panicked beside it.
            if let Some(halt) = &*of_now.lock().unwrap_or_else(PoisonError::into_inner) {
                halt.now();
            }
        });
        Self { halt, open }
    }
}

impl Stop {
    /// For signals.
    pub fn halt(&self) -> Halt {
        self.halt.clone()
    }

    pub fn is_asked(&self) -> bool {
        self.halt.is_halted()
    }

    /// From now on it holds this control.
    pub(super) fn guards(&self, control: Halt) {
        *self.open.lock().unwrap_or_else(PoisonError::into_inner) = Some(control);
        if self.is_asked() {
            self.halt.now();
        }
    }
}
