//! Interpretation of a line of text by a simulated control, and the motion that follows: modes, offsets, and one job
//! for each line. The transport (a serial protocol, registers) belongs to the firmware. The G-code reader that checks
//! programs before execution (`proof`) shares no code with this module.

mod apply_word;
mod job;
mod line;
mod modal;
mod words;

use std::collections::BTreeMap;

pub use job::{ActiveJob, Job, JobResult, ProbeInputFault, SimulationPace};
use modal::ModalState;
pub use words::{GrblErrorCode, is_blank};

use machine::record::machine::Machine;
use machine::{Axis, Position};

/// Axes and travel of one control, and its modal state.
#[derive(Debug, Clone)]
pub struct Interpreter {
    /// Axes of the control, in the order of the reports.
    pub(crate) axes: Vec<Axis>,
    /// Minimum and maximum, mm or rad.
    travel_limits: BTreeMap<Axis, (f64, f64)>,
    pub(crate) modal_state: ModalState,
}

/// Action that a line requests.
#[derive(Debug, Clone)]
pub enum LineAction {
    /// No motion and no other job: only modes or offsets change.
    NoMotion,
    /// A move, probing move, spindle orientation or dwell.
    Execute(Job),
    /// A target beyond the limits of travel; the modes of the line apply nevertheless.
    OutOfTravel,
}

impl Interpreter {
    /// Interpreter for the control of `machine`: its travel and all its axes except S, which the control can
    /// only orient.
    pub fn for_machine(machine: &Machine) -> Self {
        let controlled_axes = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S);
        let limits: BTreeMap<Axis, (f64, f64)> = controlled_axes
            .map(|(axis, spec)| (*axis, (axis.to_mm_or_rad(spec.min), axis.to_mm_or_rad(spec.max))))
            .collect();
        Self { axes: limits.keys().copied().collect(), travel_limits: limits, modal_state: ModalState::default() }
    }

    /// Action that `line` requests. `here`: position of the machine after all earlier motion.
    ///
    /// # Errors
    /// Grbl's error code for the line; a line in error does not change the modal state.
    pub fn interpret_line(&mut self, line: &str, here: &Position) -> Result<LineAction, GrblErrorCode> {
        let words = words::parse_words(line)?;
        Ok(match self.modal_state.interpret_words(&words, here, &self.axes)? {
            None => LineAction::NoMotion,
            Some(job) if job.target().is_some_and(|to| !self.is_within_limits(to)) => LineAction::OutOfTravel,
            Some(job) => LineAction::Execute(job),
        })
    }

    /// Whether `to` is within the travel of all axes that have limits; the limits are inclusive.
    pub fn is_within_limits(&self, to: &Position) -> bool {
        // The tolerance covers the rounding of the text.
        let is_within = |(axis, value): (Axis, f64)| {
            let limits = self.travel_limits.get(&axis);
            limits.is_none_or(|(min, max)| (min - 1e-6..=max + 1e-6).contains(&value))
        };
        to.iter().all(is_within)
    }
}
