//! Prompts of a stage, which come before any motion of the stage.

use super::PlanningError;
use machine::record::plan::{Plan, Step, StepKind};

/// A prompt step and its text.
type Question<'p> = (&'p Step, &'p str);

/// Splits the steps of a stage, given by their ids, into the prompts and the steps that move.
///
/// # Errors
/// A prompt comes after a step that moves, has no text, or has a target position.
pub fn asked_first<'p, 's>(
    plan: &'p Plan,
    steps: &'s [u32],
) -> Result<(Vec<Question<'p>>, &'s [u32]), PlanningError> {
    let prompt =
        |id: &u32| plan.steps.iter().find(|step| step.id == *id && step.kind == StepKind::Prompt);
    let asked: Vec<&Step> = steps.iter().map_while(prompt).collect();
    let (_, rest) = steps.split_at(asked.len());
    if let Some(late) = rest.iter().find_map(prompt) {
        return Err(PlanningError::LatePrompt { step: late.id });
    }
    let asked: Result<_, _> = asked.into_iter().map(question).collect();
    Ok((asked?, rest))
}

fn question(step: &Step) -> Result<Question<'_>, PlanningError> {
    let bad = |why| PlanningError::NotAPrompt { step: step.id, why };
    if step.from != step.to || step.scan.is_some() {
        return Err(bad("it goes somewhere"));
    }
    let text = step.text.as_deref().map(str::trim).filter(|text| !text.is_empty());
    Ok((step, text.ok_or(bad("it has no text"))?))
}
