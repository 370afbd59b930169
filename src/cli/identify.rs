//! `trued identify`: computes an estimate from readings of any origin.

use std::path::Path;

use super::args::IdentifyArgs;
use super::failure::Failure;
use super::files::{read_estimates, state_folder};
use super::{Exit, show};
use crate::report::readings_csv;
use crate::run::{check_probe, identified, judged};
use crate::setup::{self, MachineFile, SetupError};
use crate::store::{Journal, RunId, RunState};
use machine::record::estimate::Estimate;
use machine::record::plan::{PLAN_VERSION, Plan, StepKind};
use machine::record::reading::Reading;

pub fn identify(args: &IdentifyArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let estimate = match (args.run, &args.readings) {
        (Some(run), _) => stored_run(args, RunId(run), state)?,
        (None, Some(file)) => files(args, file)?,
        (None, None) => return Err(Failure::plain("neither --readings nor --run is given")),
    };
    if args.json {
        show::print_json(&estimate)?;
    } else {
        show::print_estimate(&estimate);
    }
    Ok(estimate.verdict.into())
}

fn files(args: &IdentifyArgs, csv: &Path) -> Result<Estimate, Failure> {
    let machine = setup::load(args.machine.as_deref(), &args.method)?;
    let (method, mut plan) = match &args.plan {
        Some(file) => read_plan(file, &args.method)?,
        None => {
            let (method, header) = setup::header(&machine, &args.method, None)?;
            let (plan, _) = methods::nominal(method.as_ref(), header)?;
            (method, plan)
        }
    };
    let bytes = std::fs::read(csv).map_err(|error| Failure::file(csv, &error))?;
    let readings = readings_csv::read(&bytes)
        .map_err(|error| Failure::plain(format!("{}: {error}", csv.display())))?;
    take_priors(args, &mut plan)?;
    Ok(judged(identified(method.as_ref(), &plan, &readings)?, &machine.tolerance))
}

/// Identifies a stored run; the tolerances are those of `--machine`, or of the machine file of the run.
fn stored_run(args: &IdentifyArgs, run: RunId, state: Option<&Path>) -> Result<Estimate, Failure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let stored = journal.load(run)?;
    if stored.plan.method != args.method {
        return Err(Failure::plain(format!(
            "run {run} is of the method `{}`, not `{}`",
            stored.plan.method, args.method
        )));
    }
    let machine = match &args.machine {
        Some(file) => setup::load(Some(file), &args.method)?,
        None => {
            let file = format!("machine file of run {run}");
            MachineFile::stored(&file, stored.config, &stored.plan.artefact)
                .map_err(SetupError::from)?
        }
    };
    let method =
        methods::configure(&args.method, stored.plan.settings.clone()).map_err(Failure::plain)?;
    let (mut plan, left_out) = measured(stored.plan, stored.summary.state, &stored.readings);
    take_priors(args, &mut plan)?;
    let estimate = identified(method.as_ref(), &plan, &stored.readings)?;
    let mut estimate = judged(estimate, &machine.tolerance);
    estimate.warnings.extend(left_out);
    journal.estimate(run, &estimate).wait()?;
    Ok(estimate)
}

/// Replaces the priors of the plan by those of `--with`, if given.
fn take_priors(args: &IdentifyArgs, plan: &mut Plan) -> Result<(), Failure> {
    if !args.with.is_empty() {
        plan.priors = read_estimates(&args.with)?;
    }
    Ok(check_probe(plan)?)
}

/// Reduces the plan of an incomplete run to the measured steps; also returns a message about the steps left
/// out.
fn measured(mut plan: Plan, state: RunState, readings: &[Reading]) -> (Plan, Option<String>) {
    if matches!(state, RunState::Finished | RunState::NotIdentified | RunState::Running) {
        return (plan, None);
    }
    let planned = plan.steps.len();
    // A prompt has no reading.
    plan.steps.retain(|step| {
        step.kind == StepKind::Prompt || readings.iter().any(|reading| reading.step == step.id)
    });
    let missing = planned - plan.steps.len();
    let told = format!(
        "the run is {}: {missing} of {planned} steps were never measured and are left out",
        state.as_str()
    );
    (plan, (missing > 0).then_some(told))
}

fn read_plan(file: &Path, method: &str) -> Result<(Box<dyn methods::Method>, Plan), Failure> {
    let text = std::fs::read_to_string(file).map_err(|error| Failure::file(file, &error))?;
    let wrong = |why: String| {
        Failure::new(
            format!("{}: {why}", file.display()),
            "a plan as `trued plan --json` prints it is expected",
        )
    };
    let plan: Plan = serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
    if plan.trued_plan != PLAN_VERSION {
        return Err(wrong(format!("plan version {} is not {PLAN_VERSION}", plan.trued_plan)));
    }
    if plan.method != method {
        return Err(wrong(format!("it is a plan of `{}`, not of `{method}`", plan.method)));
    }
    let settings = methods::configure(method, plan.settings.clone())
        .map_err(|error| wrong(format!("settings: {error}")))?;
    Ok((settings, plan))
}
