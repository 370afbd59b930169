//! How a simulated control understands a line of text and moves the machine: modes, offsets, and one
//! job a line. What speaks to it (a serial protocol, registers) is the firmware's own matter; what
//! reads back our text for the proof shares none of this.

mod job;
mod line;
mod modal;
mod sort;
mod words;

use std::collections::BTreeMap;

pub use job::{Active, Done, Job, Pace, Sham};
use modal::Modal;
pub use words::{Code, is_blank};

use machine::record::machine::Machine;
use machine::{Axis, Position};

/// Axes and travel of one control, and what it remembers from line to line.
#[derive(Debug, Clone)]
pub struct Interpreter {
    axes: Vec<Axis>,
    limits: BTreeMap<Axis, (f64, f64)>,
    modal: Modal,
}

/// What a line asks for.
#[derive(Debug, Clone)]
pub enum Act {
    /// Nothing moves.
    Nothing,
    Do(Job),
    /// A target beyond the limits of travel.
    OutOfTravel,
}

impl Interpreter {
    /// The control of `machine`: all its axes but S, which it can only orient, and their travel.
    pub fn of(machine: &Machine) -> Self {
        let turning = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S);
        let limits: BTreeMap<Axis, (f64, f64)> = turning
            .map(|(axis, spec)| (*axis, (axis.from_edge(spec.min), axis.from_edge(spec.max))))
            .collect();
        Self { axes: limits.keys().copied().collect(), limits, modal: Modal::default() }
    }

    /// Axis words, in the order of reports.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// What `line` asks of a machine that stands at `here` when all before is done.
    ///
    /// # Errors
    /// Grbl's number of what is wrong with the line; nothing is remembered of it.
    pub fn line(&mut self, line: &str, here: &Position) -> Result<Act, Code> {
        let words = words::words(line)?;
        Ok(match self.modal.block(&words, here, &self.axes)? {
            None => Act::Nothing,
            Some(job) if job.target().is_some_and(|to| !self.within_limits(to)) => Act::OutOfTravel,
            Some(job) => Act::Do(job),
        })
    }

    /// The modes in force, as Grbl's `$G` tells them, without the brackets.
    pub fn modes(&self) -> String {
        self.modal.report()
    }

    /// Names and offsets, as Grbl's `$#` tells them.
    pub fn offsets(&self) -> Vec<(String, Position)> {
        self.modal.offsets()
    }

    /// Within the travel of all axes.
    pub fn within_limits(&self, to: &Position) -> bool {
        // A hair of rounding in the text is no breach.
        let within = |(axis, value): (Axis, f64)| {
            let limits = self.limits.get(&axis);
            limits.is_none_or(|(min, max)| (min - 1e-6..=max + 1e-6).contains(&value))
        };
        to.iter().all(within)
    }
}
