//! Prompts of a stage, which come before any motion of the stage.

use super::PlanningError;
use machine::record::plan::{Plan, Step, StepKind};

/// A prompt step and its text.
type PromptStepAndText<'p> = (&'p Step, &'p str);

/// Splits the steps of a stage, given by their ids, into the prompts and the steps that move.
///
/// # Errors
/// A prompt comes after a step that moves, has no text, or has a target position.
pub fn split_prompts<'p, 's>(
    plan: &'p Plan,
    steps: &'s [u32],
) -> Result<(Vec<PromptStepAndText<'p>>, &'s [u32]), PlanningError> {
    let prompt = |id: &u32| plan.steps.iter().find(|step| step.id == *id && step.kind == StepKind::Prompt);
    let prompts: Vec<&Step> = steps.iter().map_while(prompt).collect();
    let (_, rest) = steps.split_at(prompts.len());
    if let Some(late) = rest.iter().find_map(prompt) {
        return Err(PlanningError::PromptAfterMotion { step: late.id });
    }
    let prompts: Result<_, _> = prompts.into_iter().map(checked_prompt_with_text).collect();
    Ok((prompts?, rest))
}

fn checked_prompt_with_text(step: &Step) -> Result<PromptStepAndText<'_>, PlanningError> {
    let bad = |reason| PlanningError::InvalidPrompt { step: step.id, reason };
    if step.from != step.to || step.scan.is_some() {
        return Err(bad("`from` and `to` differ, or the step has a scan"));
    }
    let text = step.text.as_deref().map(str::trim).filter(|text| !text.is_empty());
    Ok((step, text.ok_or(bad("`text` is empty"))?))
}
