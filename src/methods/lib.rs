//! The measuring methods. Each method is one folder, one `pub mod` below and one line in `registry.rs`.
//! Methods are pure: no IO, no clock, no unseeded random numbers. ARCHITECTURE.md explains how to add a
//! method.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use std::collections::BTreeSet;

use serde::de::DeserializeOwned;

pub mod ball_dome;
mod ball_measurement;
pub mod ball_plate;
pub mod combination;
pub mod compensation;
pub mod decision;
pub mod identification;
pub mod laser_r_test;
pub mod latch_delay;
pub mod multiprobe;
pub mod named_symbol;
mod outlier_repeats;
pub mod prediction;
mod probe_map_method;
pub mod probe_qualification;
mod prompts;
pub mod r_test;
mod registry;
mod revolution_grid;
pub mod samba;
pub mod self_calibration;
pub mod symbol_names;

pub use prompts::with_prompts;
pub use registry::{METHOD_DESCRIPTIONS, configure_method, method_description, method_names};

use estimation::linear_least_squares::{LinearError, RankAnalysis};
use estimation::nonlinear_least_squares::NonlinearError;
use estimation::revolutions::RevolutionsError;
use identification::probe_map;
use machine::kinematics::KinematicsError;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;
use planning::PlanningError;
use symbol_names::SymbolPattern;

/// The next stage of a run, or its end.
#[derive(Debug, Clone, PartialEq)]
pub enum NextStage {
    /// A new stage. The new steps are numbered after the last step of the plan and run in this order;
    /// `stage.steps` may also name earlier steps of the plan, to repeat them.
    Stage { stage: Stage, new_steps: Vec<Step> },
    /// All stages are done.
    NoFurtherStage,
}

impl NextStage {
    /// The stage that follows the `done` stages. `steps` are not numbered yet.
    pub fn from_new_steps(plan: &Plan, done: &[Stage], name: impl Into<String>, steps: Vec<Step>) -> Self {
        let id = done.last().map_or(0, |stage| stage.id + 1);
        let new_steps = plan.number_steps(id, steps);
        let steps = new_steps.iter().map(|step| step.id).collect();
        let stage = Stage { id, name: name.into(), repeat: 0, steps, found: None };
        Self::Stage { stage, new_steps }
    }
}

/// Reason why the method refuses a request, and what the operator can do instead.
#[derive(Debug, Clone, PartialEq, thiserror::Error, serde::Serialize)]
#[error("{reason}")]
pub struct MethodRefusal {
    pub reason: String,
    pub remedy: String,
}

impl MethodRefusal {
    pub fn new(reason: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { reason: reason.into(), remedy: remedy.into() }
    }

    /// Error for a machine without a rotary axis that turns the table.
    pub fn missing_rotary_table() -> Self {
        Self::new(
            "no rotary axis that carries the workpiece is along Z with all others at zero",
            "add the axis on the workpiece side of the topology (w-C-…) and as [axes.C] in the machine file",
        )
    }

    /// Minimum number of Monte Carlo trials. The setting 0, the adaptive rule, is allowed too.
    pub const MIN_MONTE_CARLO_TRIALS: usize = 100;

    /// # Errors
    /// The number of Monte Carlo trials is below the minimum and not 0. 0 selects the adaptive rule of JCGM 101.
    pub fn check_monte_carlo_trials(count: usize) -> Result<(), Self> {
        Self::require(
            count == 0 || count >= Self::MIN_MONTE_CARLO_TRIALS,
            format!("{count} Monte Carlo trials are too few for an uncertainty"),
            "choose at least 100, better 10 000; 0 selects the adaptive rule of JCGM 101",
        )
    }

    /// # Errors
    /// One of the `positive` settings is not greater than 0, one of the `not_negative` settings is negative, or a value
    /// is not finite; the error names the first one.
    pub fn check_number_ranges(positive: &[(&str, f64)], not_negative: &[(&str, f64)]) -> Result<(), Self> {
        let positive = positive.iter().map(|(name, value)| (name, value, *value > 0.0, "is not greater than 0"));
        let not_negative =
            not_negative.iter().map(|(name, value)| (name, value, *value >= 0.0, "is negative or not a number"));
        for (name, value, is_in_range, fault) in positive.chain(not_negative) {
            Self::require(
                is_in_range && value.is_finite(),
                format!("{name} = {value} {fault}"),
                "correct the value in the machine file",
            )?;
        }
        Ok(())
    }

    /// # Errors
    /// `is_met` is false.
    pub fn require(is_met: bool, reason: impl Into<String>, remedy: impl Into<String>) -> Result<(), Self> {
        if is_met { Ok(()) } else { Err(Self::new(reason, remedy)) }
    }
}

impl From<PlanningError> for MethodRefusal {
    fn from(error: PlanningError) -> Self {
        Self { reason: error.to_string(), remedy: error.remedy() }
    }
}

impl From<RevolutionsError> for MethodRefusal {
    fn from(error: RevolutionsError) -> Self {
        Self { reason: error.to_string(), remedy: error.remedy() }
    }
}

impl From<KinematicsError> for MethodRefusal {
    fn from(error: KinematicsError) -> Self {
        let remedy = "correct [machine] and [axes] in the machine file".to_owned();
        Self { reason: error.to_string(), remedy }
    }
}

/// Readings of the last repeat of a step.
///
/// # Errors
/// The step has no reading.
pub fn readings_of_last_repeat<'r>(step: &Step, readings: &'r [Reading]) -> Result<Vec<&'r Reading>, IdentifyError> {
    let of_step = || readings.iter().filter(|reading| reading.step == step.id);
    let last = of_step().map(|reading| reading.repeat).max();
    let last = last.ok_or_else(|| IdentifyError::missing_reading(step))?;
    Ok(of_step().filter(|reading| reading.repeat == last).collect())
}

/// Error for readings that cannot be turned into an estimate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    #[error("step {step} ({label}) has no reading; measure the step again or give a plan without it")]
    MissingReading { step: u32, label: String },
    /// A reading belongs to the step of this id, which the plan does not contain.
    #[error("a reading is of step {step}, which is not in the plan; check that plan and readings are of the same run")]
    UnknownStep { step: u32 },
    #[error("step {step} has two readings with repeat {repeat}; give repeated readings different numbers in `repeat`")]
    DuplicateReading { step: u32, repeat: u32 },
    /// The readings determine only `rank` of the `unknowns` unknowns. `undetermined`: texts of the combinations that
    /// are not determined.
    #[error("the readings determine only {rank} of {unknowns} unknowns: {}", undetermined.join("; "))]
    RankDeficient { rank: usize, unknowns: usize, undetermined: Vec<String> },
    #[error(transparent)]
    Refused(#[from] MethodRefusal),
    #[error("the identification failed: {0}")]
    IdentificationFailed(String),
}

impl IdentifyError {
    /// Error for equations that could not be solved. `describe` gives the undetermined combinations of
    /// unknowns in words.
    pub fn from_solver_error(
        error: impl Into<NonlinearError>,
        describe: impl Fn(&RankAnalysis) -> Vec<String>,
    ) -> Self {
        match error.into() {
            NonlinearError::Linear(LinearError::RankDeficient(survey)) => Self::RankDeficient {
                rank: survey.rank,
                unknowns: survey.rank + survey.nullity,
                undetermined: describe(&survey),
            },
            other => Self::IdentificationFailed(other.to_string()),
        }
    }

    /// # Errors
    /// A reading belongs to no step of the plan.
    pub fn check_known_steps(plan: &Plan, readings: &[Reading]) -> Result<(), Self> {
        let is_known = |reading: &&Reading| plan.steps.iter().any(|step| step.id == reading.step);
        let stray = readings.iter().find(|reading| !is_known(reading));
        stray.map_or(Ok(()), |stray| Err(Self::UnknownStep { step: stray.step }))
    }

    /// # Errors
    /// A reading belongs to no step of the plan, or has the step and the repeat of an earlier reading.
    pub fn check_known_and_unique(plan: &Plan, readings: &[Reading]) -> Result<(), Self> {
        let mut known_readings = BTreeSet::new();
        for reading in readings {
            Self::check_known_steps(plan, std::slice::from_ref(reading))?;
            let Reading { step, repeat, .. } = *reading;
            if !known_readings.insert((step, repeat)) {
                return Err(Self::DuplicateReading { step, repeat });
            }
        }
        Ok(())
    }

    /// Error for a step without a reading.
    pub fn missing_reading(step: &Step) -> Self {
        Self::MissingReading { step: step.id, label: step.label.clone() }
    }

    /// What the user must do about the error.
    pub fn remedy(&self) -> String {
        match self {
            Self::Refused(refused) => refused.remedy.clone(),
            Self::MissingReading { .. } | Self::UnknownStep { .. } | Self::DuplicateReading { .. } => {
                "give the plan that was measured (--plan) and all of its readings".to_owned()
            }
            Self::RankDeficient { .. } => {
                "measure the missing steps (`trued resume` continues a stopped run), or remove the \
                inseparable unknowns from the settings of the plan (drift_order, parameters)"
                    .to_owned()
            }
            Self::IdentificationFailed(_) => "correct the plan or the readings named above".to_owned(),
        }
    }
}

impl From<RevolutionsError> for IdentifyError {
    fn from(error: RevolutionsError) -> Self {
        MethodRefusal::from(error).into()
    }
}

/// A measuring method as a pure state machine. `plan` holds machine, probe, artefact, settings and the steps
/// so far.
pub trait Method: Send + Sync {
    /// All settings, as the plan stores them.
    fn settings(&self) -> serde_json::Value;

    /// The next stage after the `done` stages and their readings. With [`ObjectPositionSource::Nominal`] no readings
    /// are needed: positions come from the nominal artefact of the plan.
    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        readings: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal>;

    /// The sensors of the machine that the method needs besides the probe.
    ///
    /// # Errors
    /// A sensor that the method needs is missing.
    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, MethodRefusal> {
        let _ = sensors;
        Ok(Vec::new())
    }

    /// Checks whether this method can use the priors of the plan as known values on this machine. The check is called
    /// before the first motion and before the identification. Most methods accept only pre-travel maps of a probe.
    fn check_priors(&self, plan: &Plan) -> Result<(), MethodRefusal> {
        let prior = probe_map::priors_without_probe_maps(&plan.priors).next();
        prior.map_or(Ok(()), |prior| {
            Err(MethodRefusal::new(
                format!("this method accepts no prior estimate (given: an estimate of {})", prior.method),
                "remove --with",
            ))
        })
    }

    /// Whether the pre-travel map of a qualified probe may be subtracted from the readings of this method.
    fn accepts_probe_map(&self) -> bool {
        false
    }

    /// Lines for the user before the first motion: expected uncertainty of a run, then what the run cannot separate.
    /// `plan`: all stages, planned from nominal positions. `machine_time_s`: its machine time, s.
    ///
    /// # Errors
    /// The plan cannot be identified.
    fn forecast(&self, plan: &Plan, machine_time_s: f64) -> Result<Vec<String>, MethodRefusal> {
        let _ = machine_time_s;
        Ok(identification::describe_plan_aliasing(plan))
    }

    /// Computes the estimate from the plan (with its priors) and the readings. A pure function: the same
    /// input gives the same output.
    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError>;
}

/// Description of a method for users.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MethodDescription {
    /// Name of the method on the command line, in the machine file, in plans and estimates.
    pub name: &'static str,
    /// What the operator must set up.
    pub required_setup: &'static str,
    /// What the method identifies.
    pub results: &'static str,
    /// Machine file in `config/` of the simulated machine that is used when the user names no machine.
    pub default_machine_file: &'static str,
    /// Publication or document that describes the method.
    pub source: &'static str,
    /// Names of the method's results, except axis errors and the coordinates of stylus and balls.
    pub symbol_names: &'static [SymbolPattern],
    /// Whether the method's setting `repeats` is the number of passes of the whole cycle.
    pub has_cycle_passes: bool,
}

/// A method that the registry can hold.
pub trait RegisteredMethod: Method + Sized + 'static {
    /// Settings of the table `[method.NAME]` of the machine file.
    type Settings: DeserializeOwned;
    const DESCRIPTION: MethodDescription;
    fn new(settings: Self::Settings) -> Self;
}

/// The sensors that the settings of a method name; all sensors if the settings name none.
///
/// # Errors
/// The settings name a sensor that does not exist.
fn named_sensors<'a>(method: &str, named: &[String], sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, MethodRefusal> {
    let missing = named.iter().find(|name| sensors.iter().all(|sensor| sensor.name != **name));
    if let Some(name) = missing {
        return Err(MethodRefusal::new(
            format!("the machine file has no [[sensor]] `{name}`"),
            format!("correct sensors in [method.{method}], or add the [[sensor]]"),
        ));
    }
    let is_named = |sensor: &&Sensor| named.is_empty() || named.contains(&sensor.name);
    Ok(sensors.iter().filter(is_named).collect())
}

/// Source of the positions of balls and other measured objects that later stages need.
#[derive(Debug, Clone, Copy)]
pub enum ObjectPositionSource<'a> {
    /// The readings so far.
    Measured(&'a [Reading]),
    /// No readings: the whole plan is computed from nominal positions.
    Nominal,
}

/// The plan with every stage computed from nominal positions, and the stages.
///
/// # Errors
/// The method refuses a stage.
pub fn plan_nominal_stages(method: &dyn Method, mut plan: Plan) -> Result<(Plan, Vec<Stage>), MethodRefusal> {
    let mut done = Vec::new();
    while let NextStage::Stage { stage, new_steps } = method.next_stage(&plan, &done, ObjectPositionSource::Nominal)? {
        plan.steps.extend(new_steps);
        done.push(stage);
    }
    Ok((plan, done))
}
