//! State of a machine, for programs.

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::ServedMachine;
use super::newest_result::NewestResult;
use super::openapi::schemas::{LiveValuesSchema, ParameterSchema, VerdictSchema};
use crate::run::OpenPrompt;
use crate::service::machine_state::{RunFailure, ServiceState};
use machine::record::estimate::{Parameter, Verdict};
use machine::record::watched_sensors::LiveValues;

#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MachineStatus {
    pub name: String,
    pub state: &'static str,
    /// Whether the machine's worker has missed its heartbeat: the values of the run may be out of date.
    #[serde(rename = "late")]
    pub is_worker_late: bool,
    /// Result of the newest finished run in the journal, whichever process measured it; null before the first.
    pub result: Option<NewestResult>,
    /// Newest completely measured run, if it has no estimate: `result` is outdated. Null otherwise.
    pub not_identified: Option<i64>,
    /// Verdict of `run`, once it has ended.
    #[schema(value_type = Option<VerdictSchema>)]
    pub verdict: Option<Verdict>,
    pub cycle: u16,
    /// Number of the run of this cycle; 0 until the cycle has a run.
    pub run: u32,
    pub progress_percent: u16,
    pub stage: String,
    pub step: String,
    /// Remaining machine time, s: the planned time before the first step, then as the run reports it; null if unknown.
    pub remaining_s: Option<f64>,
    #[serde(rename = "measured")]
    pub stored_touch_and_scan_count: u32,
    pub refusal: Option<String>,
    /// Why the last cycle was not completed.
    pub failure: Option<RunFailure>,
    /// While the machine is held: whether another process holds its lock and may move it.
    #[serde(rename = "elsewhere")]
    pub is_locked_by_other_process: bool,
    /// Open prompt: the run waits until a person has done the requested action and answers.
    #[serde(rename = "asked")]
    pub open_prompt: Option<PromptStatus>,
    #[schema(value_type = Vec<ParameterSchema>)]
    pub parameters: Vec<Parameter>,
    pub cycles: Vec<StartableCycle>,
}

#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct StartableCycle {
    pub number: u16,
    pub method: String,
}

#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PromptStatus {
    pub step: u32,
    pub repeat: u32,
    pub text: String,
    /// Live values of the sensors that the prompt names, updated a few times a second; absent where it names none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false, value_type = Option<LiveValuesSchema>)]
    pub live: Option<LiveValues>,
}

impl MachineStatus {
    pub fn from_machine(machine: &ServedMachine) -> Self {
        let now = machine.gate.machine_state();
        let config = &machine.gate.config;
        let cycles = config.cycles.iter();
        let cycles = cycles.map(|c| StartableCycle { number: c.number, method: c.method.clone() });
        let prompt = |OpenPrompt { step_id: step, repeat_number: repeat, text }| PromptStatus {
            step,
            repeat,
            text,
            live: now.live_values,
        };
        Self {
            name: machine.name.clone(),
            state: now.state.label(),
            is_worker_late: machine.gate.is_progress_late(),
            result: NewestResult::from_newest_runs(&now.newest_runs, config.verdict_validity, Timestamp::now()),
            not_identified: now.newest_runs.newer_run_without_estimate.map(|run| run.0),
            verdict: now.verdict,
            cycle: now.cycle,
            run: now.run,
            progress_percent: now.progress_percent,
            stage: now.stage_name,
            step: now.step_label,
            remaining_s: now.remaining_s,
            stored_touch_and_scan_count: now.stored_touch_and_scan_count,
            refusal: now.last_refusal.map(|why| why.to_string()),
            failure: now.failure,
            is_locked_by_other_process: now.is_locked_by_other_process,
            open_prompt: now.open_prompt.filter(|_| now.state == ServiceState::Running).map(prompt),
            parameters: now.estimated_parameters,
            cycles: cycles.collect(),
        }
    }
}
