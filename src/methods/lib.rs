//! The measuring methods. Each method is one folder, one `pub mod` below and one line in `registry.rs`.
//! Methods are pure: no IO, no clock, no unseeded random numbers. ARCHITECTURE.md explains how to add a
//! method.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use serde::de::DeserializeOwned;

pub mod ball_dome;
mod ball_measurement;
pub mod ball_plate;
pub mod decision;
pub mod identification;
pub mod laser_r_test;
pub mod latch_delay;
pub mod multiprobe;
mod outlier_repeats;
pub mod prediction;
mod probe_map_method;
pub mod probe_qualification;
mod prompts;
pub mod r_test;
mod registry;
pub mod samba;
pub mod self_calibration;
mod turns;

pub use prompts::with_prompts;
pub use registry::{METHODS, configure, description, names};

use estimation::linear::{LinearError, Survey};
use estimation::nonlinear::NonlinearError;
use estimation::revolutions::RevolutionsError;
use identification::probe_map;
use machine::kinematics::KinematicsError;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;
use planning::PlanningError;

/// The next stage of a run, or its end.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// A new stage. The new steps are numbered after the last step of the plan and run in this order;
    /// `stage.steps` may also name earlier steps of the plan, to repeat them.
    Stage {
        stage: Stage,
        new_steps: Vec<Step>,
    },
    Done,
}

impl Next {
    /// The stage that follows the `done` stages. `steps` are not numbered yet.
    pub fn new_steps(
        plan: &Plan,
        done: &[Stage],
        name: impl Into<String>,
        steps: Vec<Step>,
    ) -> Self {
        let id = done.last().map_or(0, |stage| stage.id + 1);
        let new_steps = plan.numbered(id, steps);
        let steps = new_steps.iter().map(|step| step.id).collect();
        let stage = Stage { id, name: name.into(), repeat: 0, steps, found: None };
        Self::Stage { stage, new_steps }
    }
}

/// A request that cannot be met, and an alternative that would work.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{why}")]
pub struct Refused {
    pub why: String,
    pub instead: String,
}

impl Refused {
    pub fn new(why: impl Into<String>, instead: impl Into<String>) -> Self {
        Self { why: why.into(), instead: instead.into() }
    }

    /// Error for a machine without a rotary axis that turns the table.
    pub fn no_table() -> Self {
        Self::new(
            "no rotary axis that carries the workpiece is along Z with all others at zero",
            "state it on the workpiece side of the topology (w-C-…) and as [axes.C]",
        )
    }

    /// Minimum number of Monte Carlo trials.
    pub const MIN_TRIALS: usize = 100;

    /// # Errors
    /// The number of Monte Carlo trials is too small; 0 stands for the adaptive rule of JCGM 101.
    pub fn check_trials(count: usize) -> Result<(), Self> {
        Self::unless(
            count == 0 || count >= Self::MIN_TRIALS,
            format!("{count} Monte Carlo trials show no scatter"),
            "choose at least 100, better 10 000; 0 lets JCGM 101 decide",
        )
    }

    /// # Errors
    /// One of the `positive` settings is not greater than 0, or one of the `not_negative` settings is
    /// negative; the error names the first one.
    pub fn check_numbers(
        positive: &[(&str, f64)],
        not_negative: &[(&str, f64)],
    ) -> Result<(), Self> {
        for (name, value) in positive {
            let is_met = *value > 0.0 && value.is_finite();
            Self::unless(is_met, format!("{name} = {value} is not greater than 0"), "correct it")?;
        }
        for (name, value) in not_negative {
            let is_met = *value >= 0.0 && value.is_finite();
            Self::unless(
                is_met,
                format!("{name} = {value} is negative or no number"),
                "correct it",
            )?;
        }
        Ok(())
    }

    /// # Errors
    /// `is_met` is false.
    pub fn unless(
        is_met: bool,
        why: impl Into<String>,
        instead: impl Into<String>,
    ) -> Result<(), Self> {
        if is_met { Ok(()) } else { Err(Self::new(why, instead)) }
    }
}

impl From<PlanningError> for Refused {
    fn from(error: PlanningError) -> Self {
        Self { why: error.to_string(), instead: error.remedy() }
    }
}

impl From<RevolutionsError> for Refused {
    fn from(error: RevolutionsError) -> Self {
        Self { why: error.to_string(), instead: error.remedy() }
    }
}

impl From<KinematicsError> for Refused {
    fn from(error: KinematicsError) -> Self {
        let instead = "correct [machine] and [axes] in the machine file".to_owned();
        Self { why: error.to_string(), instead }
    }
}

/// Readings of the last repeat of a step.
///
/// # Errors
/// The step has no reading.
pub fn latest<'r>(step: &Step, readings: &'r [Reading]) -> Result<Vec<&'r Reading>, IdentifyError> {
    let of_step = || readings.iter().filter(|reading| reading.step == step.id);
    let last = of_step().map(|reading| reading.repeat).max();
    let last = last.ok_or_else(|| IdentifyError::missing(step))?;
    Ok(of_step().filter(|reading| reading.repeat == last).collect())
}

/// Error for readings that cannot be turned into an estimate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    #[error("the readings lack step {step} ({label}); measure it again or give a plan without it")]
    Missing { step: u32, label: String },
    #[error("step {step} does not stand in the plan; are plan and readings of the same run?")]
    UnknownStep { step: u32 },
    #[error("step {step} repeat {repeat} stands twice; number repeated readings in `repeat`")]
    Duplicate { step: u32, repeat: u32 },
    #[error("rank {rank} of {unknowns}: {}", what.join("; "))]
    RankDeficient { rank: usize, unknowns: usize, what: Vec<String> },
    #[error(transparent)]
    Refused(#[from] Refused),
    #[error("the identification failed: {0}")]
    Numerical(String),
}

impl IdentifyError {
    /// Error for equations that could not be solved. `describe` gives the undetermined combinations of
    /// unknowns in words.
    pub fn unsolved(
        error: impl Into<NonlinearError>,
        describe: impl Fn(&Survey) -> Vec<String>,
    ) -> Self {
        match error.into() {
            NonlinearError::Linear(LinearError::RankDeficient(survey)) => Self::RankDeficient {
                rank: survey.rank,
                unknowns: survey.rank + survey.nullity,
                what: describe(&survey),
            },
            other => Self::Numerical(other.to_string()),
        }
    }

    /// # Errors
    /// A reading belongs to no step of the plan.
    pub fn check_steps(plan: &Plan, readings: &[Reading]) -> Result<(), Self> {
        let is_known = |reading: &&Reading| plan.steps.iter().any(|step| step.id == reading.step);
        let stray = readings.iter().find(|reading| !is_known(reading));
        stray.map_or(Ok(()), |stray| Err(Self::UnknownStep { step: stray.step }))
    }

    /// Error for a step without a reading.
    pub fn missing(step: &Step) -> Self {
        Self::Missing { step: step.id, label: step.label.clone() }
    }

    /// What the user can do about the error.
    pub fn remedy(&self) -> String {
        match self {
            Self::Refused(refused) => refused.instead.clone(),
            Self::Missing { .. } | Self::UnknownStep { .. } | Self::Duplicate { .. } => {
                "give the plan that was measured (--plan) and all of its readings".to_owned()
            }
            Self::RankDeficient { .. } => {
                "measure what is missing (`trued resume` goes on with a run that was stopped), or take \
                 what cannot be told apart out of the plan's settings (drift_order, parameters)"
                    .to_owned()
            }
            Self::Numerical(_) => "correct the plan or the readings named above".to_owned(),
        }
    }
}

impl From<RevolutionsError> for IdentifyError {
    fn from(error: RevolutionsError) -> Self {
        Refused::from(error).into()
    }
}

/// A measuring method as a pure state machine. `plan` holds machine, probe, artefact, settings and the steps
/// so far.
pub trait Method: Send + Sync {
    /// All settings, as the plan stores them.
    fn settings(&self) -> serde_json::Value;

    /// The next stage after the `done` stages and their readings. With [`Source::Nominal`] no readings are
    /// needed: positions come from the nominal artefact of the plan.
    fn next(&self, plan: &Plan, done: &[Stage], readings: Source<'_>) -> Result<Next, Refused>;

    /// The sensors of the machine that the method needs besides the probe.
    ///
    /// # Errors
    /// A sensor that the method needs is missing.
    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, Refused> {
        let _ = sensors;
        Ok(Vec::new())
    }

    /// Checks whether this method can use the priors of the plan as known values on this machine. It is
    /// called before the first motion and before the identification. Most methods accept no priors.
    fn check_priors(&self, plan: &Plan) -> Result<(), Refused> {
        match probe_map::others(&plan.priors).next() {
            None => Ok(()),
            Some(prior) => Err(Refused {
                why: format!("this method takes no prior (given: an estimate of {})", prior.method),
                instead: "leave out --with".to_owned(),
            }),
        }
    }

    /// Whether the pre-travel map of a qualified probe may be subtracted from the readings of this method.
    fn takes_probe_map(&self) -> bool {
        false
    }

    /// Expected uncertainty of a run and what the run cannot separate, one line each, for the user before the
    /// first motion. All steps of `plan` have nominal positions; the plan takes `machine_s` seconds of
    /// machine time.
    ///
    /// # Errors
    /// The plan cannot be identified.
    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, Refused> {
        let _ = machine_s;
        Ok(identification::aliased_by_plan(plan))
    }

    /// Computes the estimate from the plan (with its priors) and the readings. A pure function: the same
    /// input gives the same output.
    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError>;
}

/// Description of a method for users.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Description {
    /// Name of the method on the command line, in the machine file, in plans and estimates.
    pub name: &'static str,
    /// What the operator must set up.
    pub needs: &'static str,
    /// What the method identifies.
    pub finds: &'static str,
    /// Machine file in `config/` of the simulated machine that is used when the user names no machine.
    pub machine_file: &'static str,
}

/// A method that the registry can hold.
pub trait Registered: Method + Sized + 'static {
    /// Settings of the table `[method.NAME]` of the machine file.
    type Settings: DeserializeOwned;
    const DESCRIPTION: Description;
    fn new(settings: Self::Settings) -> Self;
}

/// The sensors that the settings of a method name; all sensors if the settings name none.
///
/// # Errors
/// The settings name a sensor that does not exist.
fn named_sensors<'a>(
    method: &str,
    named: &[String],
    sensors: &'a [Sensor],
) -> Result<Vec<&'a Sensor>, Refused> {
    let missing = named.iter().find(|name| sensors.iter().all(|sensor| sensor.name != **name));
    if let Some(name) = missing {
        return Err(Refused {
            why: format!("there is no [[sensor]] `{name}`"),
            instead: format!("correct sensors in [method.{method}], or describe it"),
        });
    }
    let is_named = |sensor: &&Sensor| named.is_empty() || named.contains(&sensor.name);
    Ok(sensors.iter().filter(is_named).collect())
}

/// Source of the positions that later stages need.
#[derive(Debug, Clone, Copy)]
pub enum Source<'a> {
    /// The readings so far.
    Measured(&'a [Reading]),
    /// No readings: the whole plan is computed from nominal positions.
    Nominal,
}

/// The plan with every stage computed from nominal positions, and the stages.
///
/// # Errors
/// The method refuses a stage.
pub fn nominal(method: &dyn Method, mut plan: Plan) -> Result<(Plan, Vec<Stage>), Refused> {
    let mut done = Vec::new();
    while let Next::Stage { stage, new_steps } = method.next(&plan, &done, Source::Nominal)? {
        plan.steps.extend(new_steps);
        done.push(stage);
    }
    Ok((plan, done))
}
