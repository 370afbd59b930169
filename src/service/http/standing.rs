//! How a machine stands, as a program reads it.

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::Shown;
use super::openapi::views::{LiveValuesView, ParameterView, VerdictView};
use super::results::Told;
use crate::run::Asked;
use crate::service::board::{Board, Failure, State};
use machine::record::estimate::{Parameter, Verdict};
use machine::record::watch::LiveValues;

#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Standing {
    pub name: String,
    pub state: &'static str,
    /// Whoever works at the machine has given no sign of life in its time: nothing that is said of the run is
    /// known to be so now.
    pub late: bool,
    /// What the newest finished run in the journal has told, whoever measured it; null before there is one.
    pub result: Option<Told>,
    /// The newest run that was measured to its end, if it has no estimate: `result` is outdated. Null otherwise.
    pub not_identified: Option<i64>,
    /// Of `run`, when it has come to its end.
    #[schema(value_type = Option<VerdictView>)]
    pub verdict: Option<Verdict>,
    pub cycle: u16,
    /// 0 before there is one.
    pub run: u32,
    pub progress_percent: u16,
    pub stage: String,
    pub step: String,
    /// By its plan before it moves; null where nobody knows.
    pub remaining_s: Option<f64>,
    pub measured: u32,
    pub refusal: Option<String>,
    /// Why the last cycle did not come to its end.
    pub failure: Option<Failure>,
    /// While held: another program has the machine, and may move it.
    pub elsewhere: bool,
    /// The run waits until a person has done this.
    pub asked: Option<Question>,
    #[schema(value_type = Vec<ParameterView>)]
    pub parameters: Vec<Parameter>,
    pub cycles: Vec<Startable>,
}

#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Startable {
    pub number: u16,
    pub method: String,
}

#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Question {
    pub step: u32,
    pub repeat: u32,
    pub text: String,
    /// What the prompt's sensors read, a few times a second; absent where it watches none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false, value_type = Option<LiveValuesView>)]
    pub live: Option<LiveValues>,
}

pub fn state(state: State) -> &'static str {
    state.word()
}

impl Standing {
    pub fn of(machine: &Shown) -> Self {
        let Board {
            state: now,
            progress_percent,
            verdict,
            cycle,
            run,
            refusal,
            deviations,
            stage,
            step,
            remaining_s,
            measured,
            failure,
            elsewhere,
            asked,
            live,
            ..
        } = machine.desk.board();
        let cycles = machine.cycles.iter();
        let cycles = cycles.map(|c| Startable { number: c.number, method: c.method.clone() });
        Self {
            name: machine.name.clone(),
            state: state(now),
            late: machine.desk.pulse().is_late(),
            result: machine.last.at(Timestamp::now()).map(|(told, _)| told),
            not_identified: machine.last.not_identified().map(|run| run.0),
            verdict,
            cycle,
            run,
            progress_percent,
            stage,
            step,
            remaining_s,
            measured,
            refusal: refusal.map(|why| why.to_string()),
            failure,
            elsewhere,
            asked: asked.map(|Asked { step, repeat, text }| Question { step, repeat, text, live }),
            parameters: deviations,
            cycles: cycles.collect(),
        }
    }
}
