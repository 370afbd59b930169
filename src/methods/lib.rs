//! The measuring methods. Each is one folder, its `pub mod` below and one line in `registry.rs`; each is
//! pure: no IO, no clock, no unseeded random. ARCHITECTURE.md tells how to add one.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

use serde::de::DeserializeOwned;

mod asking;
pub mod ball_dome;
mod ball_measurement;
pub mod ball_plate;
pub mod decision;
pub mod identification;
pub mod laser_r_test;
pub mod latch_delay;
pub mod multiprobe;
pub mod prediction;
pub mod probe_qualification;
mod qualified;
pub mod r_test;
mod registry;
pub mod samba;
pub mod self_calibration;
mod suspects;
mod turns;

pub use asking::asking;
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

/// What a method wants next.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// Run these new steps (already numbered on from the plan's last) in this order; `stage.steps`
    /// may also name steps of the plan, to repeat them.
    Stage {
        stage: Stage,
        new_steps: Vec<Step>,
    },
    Done,
}

impl Next {
    /// A stage after the `done` ones, of steps that are not yet numbered.
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

/// A request that cannot be met, and what would work instead.
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

    /// Of a machine whose table does not turn.
    pub fn no_table() -> Self {
        Self::new(
            "no rotary axis that carries the workpiece is along Z with all others at zero",
            "state it on the workpiece side of the topology (w-C-…) and as [axes.C]",
        )
    }

    /// Monte Carlo trials that show some scatter.
    pub const MIN_TRIALS: usize = 100;

    /// # Errors
    /// Too few Monte Carlo trials; 0 is the adaptive rule of JCGM 101.
    pub fn check_trials(count: usize) -> Result<(), Self> {
        Self::unless(
            count == 0 || count >= Self::MIN_TRIALS,
            format!("{count} Monte Carlo trials show no scatter"),
            "choose at least 100, better 10 000; 0 lets JCGM 101 decide",
        )
    }

    /// # Errors
    /// The first of the named settings that is not greater than 0, or that is negative.
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
    /// The refusal, unless `is_met`.
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

/// The readings of the last time that a step was measured.
///
/// # Errors
/// It was never measured.
pub fn latest<'r>(step: &Step, readings: &'r [Reading]) -> Result<Vec<&'r Reading>, IdentifyError> {
    let of_step = || readings.iter().filter(|reading| reading.step == step.id);
    let last = of_step().map(|reading| reading.repeat).max();
    let last = last.ok_or_else(|| IdentifyError::missing(step))?;
    Ok(of_step().filter(|reading| reading.repeat == last).collect())
}

/// Readings that cannot be turned into an estimate.
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
    /// Of equations that could not be solved. `describe` gives the lost combinations of unknowns.
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
    /// A reading of no step of the plan.
    pub fn check_steps(plan: &Plan, readings: &[Reading]) -> Result<(), Self> {
        let is_known = |reading: &&Reading| plan.steps.iter().any(|step| step.id == reading.step);
        let stray = readings.iter().find(|reading| !is_known(reading));
        stray.map_or(Ok(()), |stray| Err(Self::UnknownStep { step: stray.step }))
    }

    /// Of a step without a reading.
    pub fn missing(step: &Step) -> Self {
        Self::Missing { step: step.id, label: step.label.clone() }
    }

    /// What to do next.
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

/// A pure stepper. `plan` carries machine, probe, artefact, settings and the steps so far.
pub trait Method: Send + Sync {
    /// The settings in full, as they go into the plan.
    fn settings(&self) -> serde_json::Value;

    /// The next stage after the `done` stages and their readings. With `nominal`, no readings are
    /// needed: positions are taken from the plan's nominal artefact.
    fn next(&self, plan: &Plan, done: &[Stage], readings: Source<'_>) -> Result<Next, Refused>;

    /// The sensors that it needs besides the probe, of those that the machine has.
    ///
    /// # Errors
    /// One that it needs is not there.
    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, Refused> {
        let _ = sensors;
        Ok(Vec::new())
    }

    /// Whether this method can take the plan's priors as known on its machine; asked before anything moves,
    /// and before it identifies. Most take none.
    fn check_priors(&self, plan: &Plan) -> Result<(), Refused> {
        match probe_map::others(&plan.priors).next() {
            None => Ok(()),
            Some(prior) => Err(Refused {
                why: format!("this method takes no prior (given: an estimate of {})", prior.method),
                instead: "leave out --with".to_owned(),
            }),
        }
    }

    /// Whether the map of a qualified probe may be taken off its readings.
    fn takes_probe_map(&self) -> bool {
        false
    }

    /// What the run is expected to reach and what it cannot separate, for the user before anything moves, a line each. `plan`: with all steps at
    /// nominal positions, of `machine_s` of machine time.
    ///
    /// # Errors
    /// A plan that cannot be identified.
    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, Refused> {
        let _ = machine_s;
        Ok(identification::aliased_by_plan(plan))
    }

    /// Plan (with its priors) + readings → estimate. A pure function: same input, same output.
    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError>;
}

/// What users read of a method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Description {
    /// On the command line, in the machine file, in plans and estimates.
    pub name: &'static str,
    /// What must be set up.
    pub needs: &'static str,
    /// What is identified.
    pub finds: &'static str,
    /// The simulated machine that serves where the user names none: a file of `config/`.
    pub machine_file: &'static str,
}

/// A method that the list can hold.
pub trait Registered: Method + Sized + 'static {
    /// The table `[method.NAME]` of the machine file.
    type Settings: DeserializeOwned;
    const DESCRIPTION: Description;
    fn new(settings: Self::Settings) -> Self;
}

/// The sensors that the settings of a method name; all where they name none.
///
/// # Errors
/// A name that no sensor has.
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

/// Where a method takes the positions of later stages from.
#[derive(Debug, Clone, Copy)]
pub enum Source<'a> {
    /// The readings so far.
    Measured(&'a [Reading]),
    /// No readings: print the whole plan from nominal positions.
    Nominal,
}

/// The plan with every stage resolved from nominal positions, and the stages.
///
/// # Errors
/// What a stage is refused for.
pub fn nominal(method: &dyn Method, mut plan: Plan) -> Result<(Plan, Vec<Stage>), Refused> {
    let mut done = Vec::new();
    while let Next::Stage { stage, new_steps } = method.next(&plan, &done, Source::Nominal)? {
        plan.steps.extend(new_steps);
        done.push(stage);
    }
    Ok((plan, done))
}
