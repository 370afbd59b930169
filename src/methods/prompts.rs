//! Prompts of the machine file that the operator acknowledges before the first stage of any method. They are the first
//! steps of the plan. The wrapped method gets a plan without these steps. For planning, its steps are numbered from 0.

use std::borrow::Cow;

use super::{IdentifyError, Method, MethodRefusal, NextStage, ObjectPositionSource};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage, Step, StepKind};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

/// Prefix of the labels of prompts from the machine file; the prompts of a method have other labels.
const MACHINE_PROMPT_LABEL_PREFIX: &str = "ask/";

/// Returns `method` with a prompt for each of `texts` before its first stage.
pub fn with_prompts(method: Box<dyn Method>, texts: Vec<String>) -> Box<dyn Method> {
    Box::new(PromptedMethod { wrapped_method: method, prompt_texts: texts })
}

/// Wrapper that adds prompts of the machine file before the first stage of a method. The method gets plans without
/// these prompts.
pub(super) struct PromptedMethod {
    wrapped_method: Box<dyn Method>,
    /// Texts of the prompts to add before the first stage. Empty: only prompts that the plan already has are handled.
    prompt_texts: Vec<String>,
}

impl PromptedMethod {
    /// Adds no prompts, but handles the prompts that a plan already has.
    pub(super) fn without_new_prompts(method: Box<dyn Method>) -> Self {
        Self { wrapped_method: method, prompt_texts: Vec::new() }
    }

    /// Adds the prompts before the steps of the first stage.
    fn add_prompts_to_stage(&self, next: NextStage) -> NextStage {
        let NextStage::Stage { mut stage, new_steps } = next else { return next };
        let prompts = (0..).zip(&self.prompt_texts).map(|(id, text)| Step {
            id,
            stage: stage.id,
            ..Step::prompt(format!("{MACHINE_PROMPT_LABEL_PREFIX}{}", id + 1), text.clone())
        });
        let mut steps: Vec<Step> = prompts.collect();
        let count = steps.len() as u32;
        steps.extend(new_steps.into_iter().map(|step| Step { id: step.id + count, ..step }));
        let moves = stage.steps.iter().map(|id| id + count);
        stage.steps = (0..count).chain(moves).collect();
        NextStage::Stage { stage, new_steps: steps }
    }
}

/// Number of steps at the head of `plan` that are prompts of the machine file.
fn machine_prompt_count(plan: &Plan) -> usize {
    let is_machine_prompt =
        |step: &&Step| step.kind == StepKind::Prompt && step.label.starts_with(MACHINE_PROMPT_LABEL_PREFIX);
    plan.steps.iter().take_while(is_machine_prompt).count()
}

/// The plan without its first `count` steps; the other steps are numbered from 0.
fn without_first_steps(plan: &Plan, count: u32) -> Plan {
    let steps = plan.steps.iter().skip(count as usize).map(|step| Step { id: step.id - count, ..step.clone() });
    Plan { steps: steps.collect(), ..plan.clone() }
}

impl Method for PromptedMethod {
    fn settings(&self) -> serde_json::Value {
        self.wrapped_method.settings()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        readings: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        let count = match (machine_prompt_count(plan) as u32, done) {
            (_, []) => return Ok(self.add_prompts_to_stage(self.wrapped_method.next_stage(plan, done, readings)?)),
            (0, _) => return self.wrapped_method.next_stage(plan, done, readings),
            (count, _) => count,
        };
        let without_prompt_ids = |stage: &Stage| {
            let steps = stage.steps.iter().filter_map(|id| id.checked_sub(count));
            Stage { steps: steps.collect(), ..stage.clone() }
        };
        let renumbered = |reading: &Reading| Reading { step: reading.step.saturating_sub(count), ..reading.clone() };
        let stages: Vec<Stage> = done.iter().map(without_prompt_ids).collect();
        let measured: Vec<Reading>;
        let readings = match readings {
            ObjectPositionSource::Nominal => ObjectPositionSource::Nominal,
            ObjectPositionSource::Measured(all) => {
                measured = all.iter().map(renumbered).collect();
                ObjectPositionSource::Measured(&measured)
            }
        };
        let next = self.wrapped_method.next_stage(&without_first_steps(plan, count), &stages, readings)?;
        let NextStage::Stage { mut stage, mut new_steps } = next else { return Ok(next) };
        new_steps.iter_mut().for_each(|step| step.id += count);
        stage.steps.iter_mut().for_each(|id| *id += count);
        Ok(NextStage::Stage { stage, new_steps })
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, MethodRefusal> {
        self.wrapped_method.required_sensors(sensors)
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), MethodRefusal> {
        self.wrapped_method.check_priors(plan)
    }

    fn accepts_probe_map(&self) -> bool {
        self.wrapped_method.accepts_probe_map()
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, MethodRefusal> {
        self.wrapped_method.forecast(&without_machine_prompts(plan), machine_s)
    }

    /// The steps keep their numbers, so that messages name the steps by the numbers of the plan.
    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        self.wrapped_method.check_priors(plan)?;
        self.wrapped_method.identify(&without_machine_prompts(plan), readings)
    }
}

/// The plan without the prompts of the machine file; the other steps keep their numbers.
fn without_machine_prompts(plan: &Plan) -> Cow<'_, Plan> {
    match machine_prompt_count(plan) {
        0 => Cow::Borrowed(plan),
        count => Cow::Owned(Plan { steps: plan.steps[count..].to_vec(), ..plan.clone() }),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// Two stages with one new step each; the second stage also repeats the first step. New steps are
    /// numbered after those of the plan that the method gets.
    struct TwoStageMethod;

    impl Method for TwoStageMethod {
        fn settings(&self) -> serde_json::Value {
            json!({})
        }

        fn next_stage(
            &self,
            plan: &Plan,
            done: &[Stage],
            readings: ObjectPositionSource<'_>,
        ) -> Result<NextStage, MethodRefusal> {
            let ids: Vec<u32> = plan.steps.iter().map(|step| step.id).collect();
            assert_eq!(ids, (0..done.len() as u32).collect::<Vec<_>>());
            assert!(plan.steps.iter().all(|step| step.kind == StepKind::Touch));
            if let ObjectPositionSource::Measured(readings) = readings {
                assert_eq!(readings.iter().map(|reading| reading.step).collect::<Vec<_>>(), ids);
            }
            let id = plan.steps.len() as u32;
            if id == 2 {
                return Ok(NextStage::NoFurtherStage);
            }
            let name = id.to_string();
            let stage = Stage { id, name, repeat: 0, steps: (0..=id).collect(), found: None };
            Ok(NextStage::Stage { stage, new_steps: vec![touch_step(id)] })
        }

        fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
            assert!(plan.steps.iter().all(|step| step.kind == StepKind::Touch));
            assert!(plan.steps.iter().zip(readings).all(|(step, reading)| step.id == reading.step));
            Err(IdentifyError::UnknownStep { step: plan.steps[0].id })
        }
    }

    fn touch_step(id: u32) -> Step {
        let step = json!({"id": id, "stage": id, "kind": "touch", "label": "t", "from": {}, "to": {},
            "feed_mm_min": 1.0, "sensor": "probe", "normal": [1.0, 0.0, 0.0]});
        serde_json::from_value(step).unwrap()
    }

    fn reading_of_step(step: u32) -> Reading {
        serde_json::from_value(json!({"step": step, "repeat": 0, "position": {}, "sensor": "probe",
            "t_s": 0.0, "flag": "", "value_mm": null, "temperatures_c": {}}))
        .unwrap()
    }

    fn plan_without_steps() -> Plan {
        serde_json::from_value(json!({"trued_plan": 1, "method": "toy", "settings": {},
            "machine": {"name": "test", "topology": "w-C-b-Z-t", "tool_mm": [0.0, 0.0, 0.0], "axes": {}},
            "probe": {"ball_radius_mm": 3.0},
            "artefact": {"kind": "cylinder", "centre_mm": [0.0, 0.0, 0.0], "axis": [0.0, 0.0, 1.0],
                "radius_mm": 1.0}}))
        .unwrap()
    }

    #[test]
    fn prompts_are_invisible_to_the_method() {
        let method = with_prompts(Box::new(TwoStageMethod), vec!["clean it".to_owned(), "cap off".to_owned()]);
        // A process that resumes the run gets the prompts from the plan alone.
        let later = PromptedMethod::without_new_prompts(Box::new(TwoStageMethod));
        let (mut plan, mut done, mut readings) = (plan_without_steps(), Vec::new(), Vec::new());
        let method: [&dyn Method; 3] = [method.as_ref(), &later, &later];
        for method in method {
            let source = ObjectPositionSource::Measured(&readings);
            let NextStage::Stage { stage, new_steps } = method.next_stage(&plan, &done, source).unwrap() else {
                break;
            };
            let touches = new_steps.iter().filter(|step| step.kind == StepKind::Touch);
            readings.extend(touches.map(|step| reading_of_step(step.id)));
            plan.steps.extend(new_steps);
            done.push(stage);
        }
        let ids: Vec<u32> = plan.steps.iter().map(|step| step.id).collect();
        assert_eq!(ids, [0, 1, 2, 3]);
        assert_eq!((&done[0].steps[..], &done[1].steps[..]), (&[0, 1, 2][..], &[2, 3][..]));
        let texts: Vec<_> = plan.steps.iter().map(|step| step.text.as_deref()).collect();
        assert_eq!(texts, [Some("clean it"), Some("cap off"), None, None]);
        let moves = |step: &Step| step.from != step.to || step.stage != 0;
        assert!(!plan.steps[..2].iter().any(moves));
        // The error names the step by its number in the plan.
        let told = later.identify(&plan, &readings).unwrap_err();
        assert_eq!(told, IdentifyError::UnknownStep { step: 2 });
        let (nominal, stages) = super::super::plan_nominal_stages(method[0], plan_without_steps()).unwrap();
        assert_eq!((nominal.steps, stages), (plan.steps, done));
    }
}
