//! Prompts to the operator, before a stage is proven. Nothing is sent to the control until the operator has
//! confirmed the prompt. The wait has no timeout; a halt ends it. Meanwhile the sensors that the prompt names
//! are read.

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use tokio::time::{Instant, sleep};

use super::{Run, RunError};
use devices::controllers::ControllerError;
use machine::Position;
use machine::record::event::RunEvent;
use machine::record::plan::{Stage, Step, StepKind};
use machine::record::watched_sensors::WatchedSensor;
use planning::{TouchedDirections, split_prompts};

/// Polling period for an answer and for a halt.
const ANSWER_POLL_PERIOD: Duration = Duration::from_millis(50);
/// Minimum time between two readings of the watched sensors.
const MIN_LIVE_VALUES_INTERVAL: Duration = Duration::from_millis(250);

/// Prompt without an answer: its text, and its step and repeat in the plan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenPrompt {
    pub step_id: u32,
    pub repeat_number: u32,
    pub text: String,
}

/// Returns the name of the person who has confirmed the prompt, `None` before that.
type PollAnswer = dyn Fn(&OpenPrompt) -> Option<String> + Send + Sync;

/// Source of the answers to prompts; `None`: no operator is available. Cloneable.
#[derive(Clone)]
pub struct PromptAnswerSource(Option<Arc<PollAnswer>>);

impl PromptAnswerSource {
    /// `poll` is called repeatedly while the run waits, and must not block. It returns the name of the person who has
    /// confirmed the prompt, or `None` before that.
    pub fn new(poll: impl Fn(&OpenPrompt) -> Option<String> + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(poll)))
    }

    /// No operator is available: a run with a prompt is refused.
    pub fn without_operator() -> Self {
        Self(None)
    }

    /// Name of the person who has confirmed the prompt; `None` before the confirmation, and always without an operator.
    pub fn poll(&self, prompt: &OpenPrompt) -> Option<String> {
        self.0.as_ref().and_then(|poll| poll(prompt))
    }
}

/// Answered prompts as (step id, repeat number).
pub(super) fn answered_prompt_steps_and_repeats(events: &[(Timestamp, RunEvent)]) -> Vec<(u32, u32)> {
    let answer = |(_, event): &(_, RunEvent)| match event {
        RunEvent::PromptConfirmed { step, repeat, .. } => Some((*step, *repeat)),
        _ => None,
    };
    events.iter().filter_map(answer).collect()
}

/// Text of the first prompt among `steps`.
pub(super) fn first_prompt_text(steps: &[Step]) -> Option<&str> {
    let prompt = steps.iter().find(|step| step.kind == StepKind::Prompt)?;
    Some(prompt.text.as_deref().unwrap_or_default())
}

impl Run<'_> {
    /// Prompts of `stage` that are not answered yet.
    pub(super) fn open_prompts(&self, stage: &Stage) -> Result<Vec<OpenPrompt>, RunError> {
        let (asked, _) = split_prompts(&self.plan, &stage.steps)?;
        let repeat = stage.repeat;
        let open =
            asked.into_iter().filter(|(step, _)| !self.answered_prompt_steps_and_repeats.contains(&(step.id, repeat)));
        let asked = |(step, text): (&Step, &str)| {
            let (step, text) = (step.id, text.to_owned());
            OpenPrompt { step_id: step, repeat_number: repeat, text }
        };
        Ok(open.map(asked).collect())
    }

    /// Checks before any motion that a prompt can be answered.
    pub(super) fn check_operator_available(&self, prompt_text: Option<&str>) -> Result<(), RunError> {
        match (prompt_text, &self.prompt_answer_source.0) {
            (Some(text), None) => Err(RunError::NoOperator { text: text.to_owned() }),
            _ => Ok(()),
        }
    }

    /// Shows the prompts at the head of `stage` and waits for the answers. Returns the position of the machine
    /// afterwards.
    ///
    /// # Errors
    /// No operator is available, the machine is halted, or the control is not ready after the answer.
    pub(super) async fn wait_for_prompts(
        &mut self,
        stage: &Stage,
        machine_position: Option<Position>,
    ) -> Result<Option<Position>, RunError> {
        let open = self.open_prompts(stage)?;
        if open.is_empty() {
            return Ok(machine_position);
        }
        for prompt in open {
            let step = self.plan.steps.iter().find(|step| step.id == prompt.step_id);
            let mount = step.and_then(|step| step.mount);
            let watched_sensors = step.map_or(Vec::new(), |step| step.watch.clone());
            self.wait_for_prompt(prompt, &watched_sensors).await?;
            mount.into_iter().for_each(|mount| self.devices.remount_simulated_datum_cylinder(mount));
        }
        // The operator may have moved the machine, and changed modes, offsets or overrides.
        self.confirmed_directions = TouchedDirections::default();
        Ok(Some(self.devices.open_controller.prepare().await?.position))
    }

    async fn wait_for_prompt(&mut self, prompt: OpenPrompt, watched_sensors: &[WatchedSensor]) -> Result<(), RunError> {
        self.check_operator_available(Some(&prompt.text))?;
        let OpenPrompt { step_id: step, repeat_number: repeat, text } = prompt.clone();
        self.record_event(RunEvent::PromptStarted { step, repeat, text }).await?;
        let halt = self.devices.open_controller.halt_handle();
        let mut next_values = Instant::now();
        let who = loop {
            if halt.is_halt_requested() {
                return Err(ControllerError::Halted.into());
            }
            if let Some(who) = self.prompt_answer_source.poll(&prompt) {
                break who;
            }
            if !watched_sensors.is_empty() && Instant::now() >= next_values {
                let values = self.read_live_values(watched_sensors).await;
                (self.on_event)(&RunEvent::Watched { values });
                next_values = Instant::now() + MIN_LIVE_VALUES_INTERVAL;
            }
            sleep(ANSWER_POLL_PERIOD).await;
        };
        self.answered_prompt_steps_and_repeats.push((step, repeat));
        self.record_event(RunEvent::PromptConfirmed { step, repeat, who }).await
    }
}
