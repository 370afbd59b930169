//! State of a machine, for the triggers, the web page and the HTTP API.

use std::collections::BTreeMap;
use std::sync::Arc;

use jiff::Zoned;
use serde::Serialize;
use utoipa::ToSchema;

use super::config::StartInterlock;
use crate::run::OpenPrompt;
use crate::store::NewestMeasuredRuns;
use machine::record::estimate::{Estimate, Parameter, Verdict};
use machine::record::watched_sensors::LiveValues;

/// State of the service for one machine. The numbers are the values of the Modbus register `state`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ServiceState {
    /// The cycles are being rehearsed; no command is accepted yet.
    #[default]
    Starting = 0,
    /// The machine waits for a start; only in this state is a start accepted.
    Waiting = 1,
    /// A cycle was accepted (started or resumed) and has not ended; its run may not have begun yet.
    Running = 2,
    /// The machine is held, or an unfinished run exists; a person must act.
    Held = 3,
    /// The last cycle ended without an estimate and without a held run; a person must acknowledge.
    Failed = 4,
    /// The service ends; no further command is accepted.
    Ending = 5,
}

impl ServiceState {
    pub const ALL: [Self; 6] = [Self::Starting, Self::Waiting, Self::Running, Self::Held, Self::Failed, Self::Ending];

    pub fn label(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Waiting => "waiting",
            Self::Running => "running",
            Self::Held => "held",
            Self::Failed => "failed",
            Self::Ending => "ending",
        }
    }

    /// Checks that the machine waits: otherwise neither a start nor new values of its control are accepted.
    pub(super) fn check_waiting(self) -> Result<(), Refusal> {
        match self {
            Self::Waiting => Ok(()),
            Self::Running => Err(Refusal::Busy),
            Self::Held => Err(Refusal::Held),
            Self::Failed => Err(Refusal::Failed),
            Self::Starting | Self::Ending => Err(Refusal::NotReady),
        }
    }
}

/// Why a request is refused. The numbers are the values of the Modbus register `refusal`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Refusal {
    #[error("a run is in progress")]
    Busy = 1,
    /// The machine is held, or an unfinished run exists.
    #[error("the machine is held: inspect the machine, then acknowledge")]
    Held = 2,
    /// The last cycle failed, and no person has acknowledged that yet.
    #[error("the last cycle failed and is not acknowledged")]
    Failed = 3,
    #[error("the configuration does not contain this cycle")]
    NoSuchCycle = 4,
    #[error("the external start is not enabled at the machine")]
    NotEnabled = 5,
    #[error("the control is not in automatic mode")]
    NotAuto = 6,
    #[error("a guard is open")]
    DoorOpen = 7,
    /// The interlocks have no recent report.
    #[error("the inputs from the control are out of date")]
    Stale = 8,
    /// The minimum pause since the end of the last cycle has not passed.
    #[error("the last cycle ended less than `min_interval_s` ago")]
    TooSoon = 9,
    #[error("the stop input is set")]
    Stopped = 10,
    /// One write of coils contains the start of more than one cycle.
    #[error("one request contains the start of several cycles")]
    Several = 11,
    /// The service starts or ends, another command is in progress, or the worker could not execute the command (in
    /// time).
    #[error("the service is not ready")]
    NotReady = 12,
    /// An acknowledgement or a resume without the confirmation that all axes are homed.
    #[error("the control may have lost its position: home all axes, then run `trued resume`")]
    PositionLost = 13,
    /// Another process has the machine's lock.
    #[error("another program uses the machine")]
    UsedByOtherProgram = 14,
    /// Nothing waits for a person: an acknowledgement while the machine is neither held nor failed, or a resume while
    /// no run is held.
    #[error("there is nothing to acknowledge")]
    NothingToAcknowledge = 15,
    /// A line of the text interface that is no valid command.
    #[error("the line is not a valid command")]
    Unreadable = 16,
    /// A start without a person who can answer the prompts of the plan.
    #[error("the plan of this cycle has prompts: a person must start it and answer them")]
    PlanHasPrompts = 17,
    /// An answer while no prompt is open, or a prompt of another step or repeat.
    #[error("this prompt is not open")]
    PromptNotOpen = 18,
    #[error("the register of artefacts permits no run")]
    ArtefactRefused = 19,
}

/// All refusals.
#[cfg(test)]
pub const ALL_REFUSALS: [Refusal; 19] = [
    Refusal::Busy,
    Refusal::Held,
    Refusal::Failed,
    Refusal::NoSuchCycle,
    Refusal::NotEnabled,
    Refusal::NotAuto,
    Refusal::DoorOpen,
    Refusal::Stale,
    Refusal::TooSoon,
    Refusal::Stopped,
    Refusal::Several,
    Refusal::NotReady,
    Refusal::PositionLost,
    Refusal::UsedByOtherProgram,
    Refusal::NothingToAcknowledge,
    Refusal::Unreadable,
    Refusal::PlanHasPrompts,
    Refusal::PromptNotOpen,
    Refusal::ArtefactRefused,
];

/// Interlock inputs, as the machine reports them or a person confirms them; they count only while they are fresh.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Interlocks {
    /// Whether the report is recent enough; otherwise no start is accepted.
    pub is_fresh: bool,
    /// Whether the external start is enabled at the machine.
    pub is_start_enabled: bool,
    pub is_auto_mode: bool,
    pub is_door_closed: bool,
    /// Whether the stop input is set: it prevents every start and resume. This level holds no run in progress; the
    /// rising edge of the input does.
    pub is_stop_set: bool,
    /// Whether a person who can answer prompts requests the start; a machine never reports this.
    pub has_person_for_prompts: bool,
}

impl Interlocks {
    /// Refusal of a start because the inputs are stale, one of `demands` is not met, or the stop input is set. `None`:
    /// the interlocks permit a start.
    pub(super) fn start_refusal(self, demands: &[StartInterlock]) -> Option<Refusal> {
        if !self.is_fresh {
            return Some(Refusal::Stale);
        }
        let missing = |demand: &StartInterlock| match demand {
            StartInterlock::Enable => (!self.is_start_enabled).then_some(Refusal::NotEnabled),
            StartInterlock::Auto => (!self.is_auto_mode).then_some(Refusal::NotAuto),
            StartInterlock::Door => (!self.is_door_closed).then_some(Refusal::DoorOpen),
        };
        demands.iter().find_map(missing).or(self.is_stop_set.then_some(Refusal::Stopped))
    }
}

/// Current state of one schedule.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannedSchedule {
    /// Name of the schedule.
    pub name: String,
    pub cycle: u16,
    /// Time pattern, as in the machine file.
    pub at: String,
    /// Time zone, as in the machine file.
    pub zone: String,
    /// Maximum delay of the start after the scheduled time, minutes.
    pub latest_min: u64,
    /// The next three due times, in the schedule's time zone; the first is the earliest.
    pub next: Vec<Zoned>,
    /// Time of the due slot that waits, and for which condition; `None`: no slot waits.
    pub waiting: Option<String>,
}

/// State of a machine: everything that the triggers, the web page, the API and the metrics report. Only the gate
/// changes it ([`CommandGate`](super::command_gate::CommandGate)).
#[derive(Debug, Clone, Default)]
pub struct MachineState {
    pub state: ServiceState,
    /// Progress of the cycle by machine time, %; 100 only after its estimate.
    pub progress_percent: u16,
    /// Verdict of the cycle in `cycle`; `None` until this cycle is completed.
    pub verdict: Option<Verdict>,
    /// Number of the cycle that is running or ran last; 0 before the first start, also while a run of an earlier
    /// process is resumed.
    pub cycle: u16,
    /// Number of the run of this cycle, 0 until the cycle has a run; after the start of the service, the unfinished run
    /// that waits for a person.
    pub run: u32,
    /// Number of accepted starts since the service began, without resumes; wraps around.
    pub accepted_start_count: u16,
    /// Number of refused requests of all clients since the service began; wraps around.
    pub refusal_count: u16,
    /// The last refusal since the service began; an accepted request does not clear it.
    pub last_refusal: Option<Refusal>,
    /// Runs that were identified while the machine waited; the counter wraps around.
    pub idle_identification_count: u16,
    /// Parameters of the estimate that has `verdict`; empty until this cycle is completed.
    pub estimated_parameters: Vec<Parameter>,
    /// Current stage of the run; empty while no run is in progress.
    pub stage_name: String,
    /// Label of the current step of the run; empty while no run is in progress.
    pub step_label: String,
    /// Remaining machine time, s: the planned time, then as the run reports it; `None` if unknown.
    pub remaining_s: Option<f64>,
    /// Number of touches and scans of the run that are in the journal, each repeat counted, also those before a resume.
    pub stored_touch_and_scan_count: u32,
    /// While the machine is held: whether another process holds its lock and may move it.
    pub is_locked_by_other_process: bool,
    /// Why the last cycle was not completed, and the remedy; `None` once the failure is acknowledged or resolved by
    /// another process, or another cycle begins.
    pub failure: Option<RunFailure>,
    /// Open prompt; the machine does not move before a person answers it.
    pub open_prompt: Option<OpenPrompt>,
    /// Live values of the sensors that the open prompt names; `None` before the first values.
    pub live_values: Option<LiveValues>,
    /// Schedules with their next times and the reasons why due slots wait.
    pub planned_schedules: Vec<PlannedSchedule>,
    /// Newest runs in the journal, whichever process measured them, as of the last query.
    pub newest_runs: Arc<NewestMeasuredRuns>,
    pub counters: Counters,
}

/// How a cycle or an identification ended, as the metrics count it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CycleOutcome {
    /// An estimate with this verdict; [`Verdict::None`] without a tolerance.
    Judged(Verdict),
    /// The machine is held.
    Held,
    /// The cycle or the identification ended without an estimate, and no run is held.
    Failed,
}

impl CycleOutcome {
    pub(super) fn all() -> impl Iterator<Item = Self> {
        Verdict::ALL.map(Self::Judged).into_iter().chain([Self::Held, Self::Failed])
    }

    pub fn label(self) -> &'static str {
        match self {
            Self::Judged(Verdict::Pass) => "pass",
            Self::Judged(Verdict::Fail) => "fail",
            Self::Judged(Verdict::Undecided) => "undecided",
            Self::Judged(Verdict::UndecidedModel) => "undecided_model",
            Self::Judged(Verdict::None) => "none",
            Self::Held => "held",
            Self::Failed => "failed",
        }
    }
}

/// Counts since the start of the service, for the metrics.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Counters {
    /// Ended cycles and identifications by [`CycleOutcome::label`].
    pub outcome_counts_by_label: BTreeMap<&'static str, u64>,
    /// Touches and scans that this service stored in the journal.
    pub reading_count: u64,
    /// Refused requests by reason.
    pub refusal_counts: BTreeMap<Refusal, u64>,
    /// Cycles whose measurement ended by a failure of a link to the control or to a sensor.
    pub cycles_ended_by_link_error: u64,
}

/// Error message for a person.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = Failure)]
pub struct RunFailure {
    pub what: String,
    pub remedy: Option<String>,
}

/// End of a cycle, as the worker reports it to the gate.
#[derive(Default)]
pub(super) struct CycleEnd<'a> {
    /// State of the machine from now on.
    pub state: ServiceState,
    /// `None`: the cycle has no estimate (yet).
    pub estimate: Option<&'a Estimate>,
    /// `None`: the cycle was completed, or its run is identified later.
    pub failure: Option<RunFailure>,
    /// `None`: the outcome is counted later, when the run is identified.
    pub outcome: Option<CycleOutcome>,
    /// Whether a failure of a link ended the cycle.
    pub ended_by_link_error: bool,
}

#[cfg(test)]
impl CycleEnd<'_> {
    pub fn in_state(state: ServiceState) -> Self {
        Self { state, ..Self::default() }
    }
}

impl MachineState {
    /// Resets the state for a new or resumed cycle, and sets `Running`. `expected_time_s`: expected machine time, s,
    /// if it is known.
    pub(super) fn begin_cycle(&mut self, cycle: u16, expected_time_s: Option<f64>) {
        (self.state, self.cycle, self.run) = (ServiceState::Running, cycle, 0);
        (self.progress_percent, self.verdict) = (0, None);
        self.estimated_parameters.clear();
        (self.is_locked_by_other_process, self.failure) = (false, None);
        (self.stage_name, self.step_label) = (String::new(), String::new());
        (self.remaining_s, self.stored_touch_and_scan_count) = (expected_time_s, 0);
        (self.open_prompt, self.live_values) = (None, None);
    }

    /// Records the end of a cycle; the gate sets the state.
    pub(super) fn end_cycle(&mut self, end: &CycleEnd<'_>) {
        if let Some(estimate) = end.estimate {
            self.progress_percent = 100;
            self.verdict = Some(estimate.verdict);
            self.estimated_parameters = estimate.parameters.clone();
        }
        (self.stage_name, self.step_label) = (String::new(), String::new());
        (self.open_prompt, self.remaining_s) = (None, None);
        self.failure.clone_from(&end.failure);
        end.outcome.into_iter().for_each(|outcome| self.count_outcome(outcome));
        self.counters.cycles_ended_by_link_error += u64::from(end.ended_by_link_error);
    }

    pub(super) fn count_outcome(&mut self, outcome: CycleOutcome) {
        *self.counters.outcome_counts_by_label.entry(outcome.label()).or_default() += 1;
    }
}
