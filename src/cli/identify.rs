//! `trued identify`: computes an estimate from readings of any origin.

use std::path::Path;

use super::args::IdentifyArgs;
use super::artefact::complete_report_data;
use super::failure::CommandFailure;
use super::files::{read_estimates, state_folder};
use super::{ExitStatus, show};
use crate::report::readings_csv;
use crate::run::{check_qualifications_match_probe, identify_readings, judge_estimate};
use crate::setup::{self, MachineFile, SetupError};
use crate::store::{Journal, RunId, RunState};
use machine::record::estimate::Estimate;
use machine::record::plan::{PLAN_VERSION, Plan, StepKind};
use machine::record::reading::Reading;

pub fn identify_command(args: &IdentifyArgs, state: Option<&Path>) -> Result<ExitStatus, CommandFailure> {
    let estimate = match (args.run, &args.readings) {
        (Some(run), _) => identify_stored_run(args, RunId(run), state)?,
        (None, Some(file)) => identify_readings_file(args, file, state)?,
        (None, None) => {
            return Err(CommandFailure::without_remedy("one of the options --readings and --run is required"));
        }
    };
    if args.json {
        show::print_json(&estimate)?;
    } else {
        show::print_estimate(&estimate);
    }
    Ok(estimate.verdict.into())
}

/// Identifies the readings of a file; nothing is stored.
fn identify_readings_file(args: &IdentifyArgs, csv: &Path, state: Option<&Path>) -> Result<Estimate, CommandFailure> {
    let machine = setup::load_machine_file(args.machine.as_deref(), &args.method)?;
    let (method, mut plan) = match &args.plan {
        Some(file) => read_plan_and_method(file, &args.method)?,
        None => {
            let (method, mut plan_without_steps) =
                setup::configure_method_and_plan_without_steps(&machine, &args.method, None)?;
            plan_without_steps.report = complete_report_data(&machine.report_data, state)?;
            let (plan, _) = methods::plan_nominal_stages(method.as_ref(), plan_without_steps)?;
            (method, plan)
        }
    };
    let bytes = std::fs::read(csv).map_err(|error| CommandFailure::from_file_error(csv, &error))?;
    let readings = readings_csv::read_readings(&bytes)
        .map_err(|error| CommandFailure::without_remedy(format!("{}: {error}", csv.display())))?;
    replace_priors_and_check_probe(args, &mut plan)?;
    let estimate = identify_readings(method.as_ref(), &plan, &readings)?;
    Ok(judge_estimate(estimate, &plan, &machine.tolerances))
}

/// Identifies a stored run from its measured steps and adds the estimate to the run; the tolerances are those of
/// `--machine`, or of the machine file of the run.
fn identify_stored_run(args: &IdentifyArgs, run: RunId, state: Option<&Path>) -> Result<Estimate, CommandFailure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let stored = journal.load_run(run)?;
    if stored.plan.method != args.method {
        return Err(CommandFailure::without_remedy(format!(
            "run {run} was measured with the method `{}`, not with `{}`",
            stored.plan.method, args.method
        )));
    }
    let machine = match &args.machine {
        Some(file) => setup::load_machine_file(Some(file), &args.method)?,
        None => {
            let file = format!("machine file of run {run}");
            MachineFile::from_stored_run(&file, stored.machine_file_text, &stored.plan.artefact)
                .map_err(SetupError::from)?
        }
    };
    let method = methods::configure_method(&args.method, stored.plan.settings.clone())
        .map_err(CommandFailure::without_remedy)?;
    let (mut plan, skipped_steps) = keep_measured_steps(stored.plan, stored.summary.state, &stored.readings);
    replace_priors_and_check_probe(args, &mut plan)?;
    let estimate = identify_readings(method.as_ref(), &plan, &stored.readings)?;
    let mut estimate = judge_estimate(estimate, &plan, &machine.tolerances);
    estimate.warnings.extend(skipped_steps);
    journal.add_estimate(run, &estimate).wait()?;
    Ok(estimate)
}

/// Replaces the priors of the plan by those of `--with`, if given, and checks that they were qualified
/// with the probe of the plan.
fn replace_priors_and_check_probe(args: &IdentifyArgs, plan: &mut Plan) -> Result<(), CommandFailure> {
    if !args.with.is_empty() {
        plan.priors = read_estimates(&args.with)?;
    }
    Ok(check_qualifications_match_probe(plan)?)
}

/// Reduces the plan of a run that was not measured to its end to the measured steps; also returns a message about the
/// steps left out. The plan of a finished, not identified or running run is unchanged.
fn keep_measured_steps(mut plan: Plan, state: RunState, readings: &[Reading]) -> (Plan, Option<String>) {
    if matches!(state, RunState::Finished | RunState::NotIdentified | RunState::Running) {
        return (plan, None);
    }
    let planned = plan.steps.len();
    // A prompt has no reading.
    plan.steps.retain(|step| step.kind == StepKind::Prompt || readings.iter().any(|reading| reading.step == step.id));
    let missing = planned - plan.steps.len();
    let message =
        format!("the run is {}: {missing} of {planned} steps were not measured and are not used", state.as_str());
    (plan, (missing > 0).then_some(message))
}

/// Plan in the file, which must be for `method`, and the method with the settings of the plan.
fn read_plan_and_method(file: &Path, method: &str) -> Result<(Box<dyn methods::Method>, Plan), CommandFailure> {
    let text = std::fs::read_to_string(file).map_err(|error| CommandFailure::from_file_error(file, &error))?;
    let wrong = |why: String| {
        CommandFailure::new(format!("{}: {why}", file.display()), "use a plan in the format of `trued plan --json`")
    };
    let plan: Plan = serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
    if plan.trued_plan != PLAN_VERSION {
        return Err(wrong(format!(
            "plan version {} is not supported; the supported version is {PLAN_VERSION}",
            plan.trued_plan
        )));
    }
    if plan.method != method {
        return Err(wrong(format!("the plan is for the method `{}`, not for `{method}`", plan.method)));
    }
    let settings = methods::configure_method(method, plan.settings.clone())
        .map_err(|error| wrong(format!("settings: {error}")))?;
    Ok((settings, plan))
}
