//! A stop that holds a moving machine, even if the control is opened more than once. At rest it only ends the
//! check: an operator would have to reset a control that was held while idle.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use devices::controllers::HaltHandle;

/// Stop of a check, on request of the operator.
#[derive(Clone)]
pub struct CheckStop {
    /// Requests this stop; holds the control only during a motion.
    halt: HaltHandle,
    state: Arc<Mutex<CheckStopState>>,
}

/// State of a [`CheckStop`].
#[derive(Default)]
struct CheckStopState {
    /// Halt handle of the open control.
    control_halt: Option<HaltHandle>,
    /// Whether a motion may be in progress.
    is_moving: bool,
    /// Whether this stop has sent a hold to the control.
    has_sent_hold: bool,
}

impl CheckStopState {
    /// Holds the control if a motion may be in progress.
    fn hold_if_moving(&mut self) {
        if let (Some(control), true) = (&self.control_halt, self.is_moving) {
            self.has_sent_hold = true;
            control.trigger();
        }
    }
}

impl Default for CheckStop {
    fn default() -> Self {
        let state: Arc<Mutex<CheckStopState>> = Arc::default();
        let of_now = state.clone();
        let halt = HaltHandle::new(move || lock_state(&of_now).hold_if_moving());
        Self { halt, state }
    }
}

/// Locks the state; it is valid even if another thread has panicked.
fn lock_state(state: &Mutex<CheckStopState>) -> MutexGuard<'_, CheckStopState> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl CheckStop {
    /// Halt handle that requests this stop, for example from a signal handler.
    pub fn halt_handle(&self) -> HaltHandle {
        self.halt.clone()
    }

    pub fn is_requested(&self) -> bool {
        self.halt.is_halt_requested()
    }

    /// Whether the stop has held the control.
    pub(super) fn has_held_control(&self) -> bool {
        lock_state(&self.state).has_sent_hold
    }

    /// Sets the control that the stop holds.
    pub(super) fn set_control_halt(&self, control: HaltHandle) {
        lock_state(&self.state).control_halt = Some(control);
    }

    /// Begins a motion, which a stop holds until the guard is dropped. `None`: a stop was requested, and no
    /// motion may begin.
    pub(super) fn begin_motion(&self) -> Option<MotionGuard> {
        let mut state = lock_state(&self.state);
        state.is_moving = !self.is_requested();
        state.is_moving.then(|| MotionGuard(self.state.clone()))
    }
}

/// A motion that a stop would hold; dropped at the end of the motion.
pub(super) struct MotionGuard(Arc<Mutex<CheckStopState>>);

impl Drop for MotionGuard {
    fn drop(&mut self) {
        lock_state(&self.0).is_moving = false;
    }
}
