//! Publishes the events of a run in the log and in the machine state.

use std::time::Duration;

use tracing::debug;

use super::Log;
use super::command_gate::CommandGate;
use super::machine_state::MachineState;
use crate::run::Asked;
use machine::record::event::Event;

/// Receiver of the events of one run.
pub(super) struct RunEvents<'a> {
    gate: &'a CommandGate,
    log: &'a Log,
    /// Maximum time to the next event.
    patience: Duration,
    /// Longest machine time left that the run has stated, s.
    whole_s: f64,
    /// Progress, %; it decreases only if the remaining time exceeds `whole_s`.
    percent: u16,
}

impl<'a> RunEvents<'a> {
    pub(super) fn new(gate: &'a CommandGate, log: &'a Log, patience: Duration) -> Self {
        Self { gate, log, patience, whole_s: 0.0, percent: 0 }
    }

    pub(super) fn publish(&mut self, event: &Event) {
        self.gate.report_progress(self.patience);
        match event {
            Event::Announced { text } => self.log.say(text),
            Event::StageStarted { stage } => {
                self.log.say(&format!("{}: {} touches", stage.name, stage.steps.len()));
                self.gate.update(|machine_state| machine_state.stage.clone_from(&stage.name));
            }
            Event::StepStarted { step, remaining_s, label, .. } => {
                debug!(step, "{label}");
                let percent = self.progress(*remaining_s);
                self.gate.update(|machine_state: &mut MachineState| {
                    machine_state.progress_percent = percent;
                    machine_state.remaining_s = Some(*remaining_s);
                    machine_state.step.clone_from(label);
                });
            }
            Event::Asked { step, repeat, text } => {
                self.log.say(&format!("a person is asked: {text}"));
                let asked = Asked { step: *step, repeat: *repeat, text: text.clone() };
                self.gate.update(|machine_state| {
                    (machine_state.asked, machine_state.live) = (Some(asked), None)
                });
            }
            Event::Watched { values } => {
                self.gate.update(|machine_state| machine_state.live = Some(values.clone()));
            }
            Event::Answered { who, .. } => self.log.say(&format!("done, says {who}")),
            Event::ReadingStored { .. } | Event::ScanStored { .. } => {
                self.gate.update(|machine_state| {
                    machine_state.measured += 1;
                    machine_state.counters.readings += 1;
                });
            }
            _ => {}
        }
    }

    /// Progress, %; 100 is reserved for the end.
    fn progress(&mut self, remaining_s: f64) -> u16 {
        if remaining_s > self.whole_s {
            // After a stop, the reference checks run on their own; the remaining time is known only after them.
            (self.whole_s, self.percent) = (remaining_s, 0);
        }
        let done = 100.0 * (1.0 - remaining_s / self.whole_s.max(f64::MIN_POSITIVE));
        self.percent = self.percent.max(done.clamp(0.0, 99.0) as u16);
        self.percent
    }
}
