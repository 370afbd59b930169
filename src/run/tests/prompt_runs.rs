//! Runs with prompts.

use super::*;
use machine::record::estimate::Estimate;
use machine::record::plan::{Step, StepKind};
use methods::{IdentifyError, MethodRefusal};
use planning::PlanningError;

/// A method that asks the operator to turn the part. Its prompt is at the head of the cycle's first stage, or
/// after the touches of that stage, where no prompt is allowed.
struct PromptingMethod {
    inner: Box<dyn Method>,
    is_prompt_after_touches: bool,
}

impl Method for PromptingMethod {
    fn settings(&self) -> serde_json::Value {
        self.inner.settings()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        readings: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        let next = self.inner.next_stage(plan, done, readings)?;
        let NextStage::Stage { mut stage, mut new_steps } = next else { return Ok(next) };
        if done.len() == 1 {
            let last = new_steps.last().unwrap().clone();
            let prompt = Step {
                id: last.id + 1,
                kind: StepKind::Prompt,
                label: "turn".to_owned(),
                from: Position::new(),
                to: Position::new(),
                text: Some("turn the part".to_owned()),
                mount: None,
                ..last
            };
            let place = if self.is_prompt_after_touches { stage.steps.len() } else { 0 };
            stage.steps.insert(place, prompt.id);
            new_steps.push(prompt);
        }
        Ok(NextStage::Stage { stage, new_steps })
    }

    fn identify(&self, _: &Plan, _: &[Reading]) -> Result<Estimate, IdentifyError> {
        Err(IdentifyError::IdentificationFailed("nobody asks for it".to_owned()))
    }
}

/// Prompts (step, repeat) and answers in their order.
fn prompt_events_with_steps_and_repeats(stored: &StoredRun) -> Vec<(&'static str, u32, u32)> {
    let told = |event: &RunEvent| match event {
        RunEvent::PromptStarted { step, repeat, .. } => Some(("asked", *step, *repeat)),
        RunEvent::PromptConfirmed { step, repeat, .. } => Some(("answered", *step, *repeat)),
        _ => None,
    };
    stored.events.iter().filter_map(|(_, event)| told(event)).collect()
}

const TWO_PROMPTS: &str = "[[prompt]]\ntext = \"the part is clean\"\n[[prompt]]\ntext = \"so is the stylus\"\n\
                   methods = [\"self-calibration\"]\n[[prompt]]\ntext = \"no\"\nmethods = [\"samba\"]\n";

#[tokio::test]
async fn nothing_is_sent_before_the_answer_and_then_the_state_is_read_again() {
    let shop = RunWorkspace::new(TWO_PROMPTS);
    let (method, _) = shop.method_and_plan();
    let (calls, seen) = (shop.calls.clone(), CallLog::default());
    let note = {
        let (calls, seen) = (calls.clone(), seen.clone());
        move || seen.lock().unwrap().extend(calls.lock().unwrap().last())
    };
    let looks = Mutex::new(0);
    let answers = |_| {
        let note = note.clone();
        PromptAnswerSource::new(move |_| {
            note();
            let mut looks = looks.lock().unwrap();
            *looks += 1;
            (*looks % 3 == 0).then(|| "Ada".to_owned())
        })
    };
    let told = |event: &RunEvent, _: &HaltHandle| match event {
        RunEvent::PromptStarted { .. } | RunEvent::PromptConfirmed { .. } => note(),
        _ => {}
    };
    let (ended, stored) = shop.run_method(method.as_ref(), answers, told).await;
    ended.unwrap();
    // For each of the two prompts: prompt, three polls, answer. Until then the control received only `prepare`.
    assert_eq!(*seen.lock().unwrap(), ["prepare"; 10]);
    // The operator was at the machine, so the control is prepared again.
    assert_eq!(shop.calls()[..3], ["prepare", "prepare", "execute"]);
    let asked = [("asked", 0, 0), ("answered", 0, 0), ("asked", 1, 0), ("answered", 1, 0)];
    assert_eq!(prompt_events_with_steps_and_repeats(&stored), asked);
    let ids: Vec<u32> = stored.plan.steps.iter().map(|step| step.id).collect();
    assert_eq!(ids, (0..ids.len() as u32).collect::<Vec<_>>());
    assert_eq!(stored.plan.steps[1].text.as_deref(), Some("so is the stylus"));
    let proven = |(_, event): &(_, RunEvent)| matches!(event, RunEvent::StageProven { .. });
    let before = stored.events.iter().take_while(|event| !proven(event)).count();
    assert!(
        prompt_events_with_steps_and_repeats(&StoredRun { events: stored.events[before..].to_vec(), ..stored })
            .is_empty()
    );
}

#[tokio::test]
async fn halt_ends_the_wait_and_no_run_starts_without_operator() {
    let shop = RunWorkspace::new(TWO_PROMPTS);
    let (method, _) = shop.method_and_plan();
    let nobody = |_| PromptAnswerSource::without_operator();
    let (refused, stored) = shop.run_method(method.as_ref(), nobody, |_, _| {}).await;
    assert!(matches!(refused, Err(RunError::NoOperator { .. })), "{refused:?}");
    assert_eq!((shop.calls(), stored.summary.state), (vec![], RunState::Failed));

    let stops = |halt: HaltHandle| {
        PromptAnswerSource::new(move |_| {
            halt.trigger();
            None
        })
    };
    let (held, stored) = shop.run_method(method.as_ref(), stops, |_, _| {}).await;
    assert!(held.unwrap_err().is_requested_stop());
    assert_eq!((shop.calls(), stored.summary.state), (vec!["prepare"], RunState::Held));
    assert_eq!(prompt_events_with_steps_and_repeats(&stored), [("asked", 0, 0)]);
}

#[tokio::test]
async fn prompt_after_a_touch_is_refused_before_motion() {
    let shop = RunWorkspace::new("");
    let method = PromptingMethod { inner: shop.method_and_plan().0, is_prompt_after_touches: true };
    let (refused, _) = shop.run_method(&method, |_| answers_by_operator(), |_, _| {}).await;
    let late = matches!(refused, Err(RunError::Planning(PlanningError::PromptAfterMotion { .. })));
    assert!(late && shop.calls().is_empty(), "{refused:?}");
}

/// The cycle's second repeat prompts again. A run stopped during the wait repeats the prompt when it is
/// resumed; a run stopped after the answer does not.
#[tokio::test]
async fn answered_prompts_are_not_repeated_after_a_stop() {
    let shop = RunWorkspace::new("");
    let method = PromptingMethod { inner: shop.method_and_plan().0, is_prompt_after_touches: false };
    let stops = |halt: HaltHandle| {
        PromptAnswerSource::new(move |asked| {
            if asked.repeat_number == 1 {
                halt.trigger();
            }
            (asked.repeat_number == 0).then(|| "Ada".to_owned())
        })
    };
    let (held, stored) = shop.run_method(&method, stops, |_, _| {}).await;
    assert!(held.unwrap_err().is_requested_stop());
    let prompt = stored.plan.steps.last().unwrap().id;
    let first = [("asked", prompt, 0), ("answered", prompt, 0), ("asked", prompt, 1)];
    assert_eq!((prompt_events_with_steps_and_repeats(&stored), stored.summary.state), (first.to_vec(), RunState::Held));

    let after_one = |event: &RunEvent, halt: &HaltHandle| match event {
        RunEvent::ReadingStored { reading } if reading.repeat == 1 => halt.trigger(),
        _ => {}
    };
    let (held, stored) = shop.resume(&method, stored, after_one).await;
    assert!(held.unwrap_err().is_requested_stop());
    let again = [("asked", prompt, 1), ("answered", prompt, 1)];
    assert_eq!(prompt_events_with_steps_and_repeats(&stored), [&first[..], &again].concat());

    let (ended, finished) = shop.resume(&method, stored.clone(), |_, _| {}).await;
    ended.unwrap();
    assert_eq!(prompt_events_with_steps_and_repeats(&finished), prompt_events_with_steps_and_repeats(&stored));
    assert_eq!(finished.summary.state, RunState::NotIdentified);
    drop(shop.journal_folder);
}
