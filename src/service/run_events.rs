//! Publishes the events of a run in the log and in the machine state.

use std::time::Duration;

use tracing::debug;

use super::Log;
use super::command_gate::CommandGate;
use super::machine_state::MachineState;
use crate::run::OpenPrompt;
use machine::record::event::RunEvent;

/// Publishes the events of one run, and derives its progress from them.
pub(super) struct RunEventPublisher<'a> {
    gate: &'a CommandGate,
    log: &'a Log,
    /// Maximum time between two events; after that, the run counts as hung.
    max_event_interval: Duration,
    /// Longest remaining machine time that the run has reported, s.
    max_remaining_s: f64,
    /// Progress, %; it decreases only if the remaining time exceeds `max_remaining_s`.
    progress_percent: u16,
}

impl<'a> RunEventPublisher<'a> {
    pub(super) fn new(gate: &'a CommandGate, log: &'a Log, max_event_interval: Duration) -> Self {
        Self { gate, log, max_event_interval, max_remaining_s: 0.0, progress_percent: 0 }
    }

    /// Reports progress of the worker with each event, also with one that is neither logged nor part of the machine
    /// state.
    pub(super) fn publish_event(&mut self, event: &RunEvent) {
        self.gate.report_progress(self.max_event_interval);
        match event {
            RunEvent::ControlPrepared { identity: text } | RunEvent::OperatorMessage { text } => self.log.info(text),
            RunEvent::StageStarted { stage } => {
                self.log.info(&format!("{}: {} touches", stage.name, stage.steps.len()));
                self.gate.update_machine_state(|machine_state| machine_state.stage_name.clone_from(&stage.name));
            }
            RunEvent::StepStarted { step, remaining_s, label, .. } => {
                debug!(step, "{label}");
                let percent = self.update_progress_percent(*remaining_s);
                self.gate.update_machine_state(|machine_state: &mut MachineState| {
                    machine_state.progress_percent = percent;
                    machine_state.remaining_s = Some(*remaining_s);
                    machine_state.step_label.clone_from(label);
                });
            }
            RunEvent::PromptStarted { step, repeat, text } => {
                self.log.info(&format!("prompt: {text}"));
                let prompt = OpenPrompt { step_id: *step, repeat_number: *repeat, text: text.clone() };
                self.gate.update_machine_state(|machine_state| {
                    (machine_state.open_prompt, machine_state.live_values) = (Some(prompt), None)
                });
            }
            RunEvent::Watched { values } => {
                self.gate.update_machine_state(|machine_state| machine_state.live_values = Some(values.clone()));
            }
            RunEvent::PromptConfirmed { who, .. } => self.log.info(&format!("prompt answered by {who}")),
            RunEvent::ReadingStored { .. } | RunEvent::ScanStored { .. } => {
                self.gate.update_machine_state(|machine_state| {
                    machine_state.stored_touch_and_scan_count += 1;
                    machine_state.counters.reading_count += 1;
                });
            }
            _ => {}
        }
    }

    /// Updates and returns the progress, %, from the remaining machine time; at most 99, as 100 is reserved for the
    /// end.
    fn update_progress_percent(&mut self, remaining_s: f64) -> u16 {
        if remaining_s > self.max_remaining_s {
            // After a stop, the reference checks run on their own; the remaining time is known only after them.
            (self.max_remaining_s, self.progress_percent) = (remaining_s, 0);
        }
        let done = 100.0 * (1.0 - remaining_s / self.max_remaining_s.max(f64::MIN_POSITIVE));
        self.progress_percent = self.progress_percent.max(done.clamp(0.0, 99.0) as u16);
        self.progress_percent
    }
}
