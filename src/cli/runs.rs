//! `trued runs`, `trued show`, `trued export`.

use std::path::Path;

use super::failure::CommandFailure;
use super::files::{read_estimate, state_folder};
use super::result_args::{ExportArgs, ExportFrame, RunsArgs, ShowArgs};
use super::{add_state_option, show};
use crate::archive::run_files;
use crate::archive::run_story::{self, describe_events_with_times, describe_run_end};
use crate::report::result_row::verdict_word;
use crate::report::temperature;
use crate::run::can_resume;
use crate::store::{Journal, MachineLock, RunId, RunState, RunSummary, StoredRun};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::{Reading, ReadingFlag};
use methods::prediction::WorkpieceTransform;

pub fn list_runs(args: &RunsArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let folder = state_folder(state)?;
    let journal = Journal::open(&folder)?;
    let mut runs = journal.runs()?;
    runs.iter_mut().for_each(|run| run.state = current_run_state(run, &folder));
    if args.json {
        return show::print_json(&runs);
    }
    errln!("state folder: {}", folder.display());
    if runs.is_empty() {
        outln!("no runs yet: start one with `trued run self-calibration`");
    }
    for run in runs {
        outln!(
            "{:>5}  {:.0}  {:<18} {:<14} {:<17} {}",
            run.id.to_string(),
            run.started,
            run.method,
            run.state.as_str(),
            run.verdict.map_or("", verdict_word),
            run.machine
        );
        if let Some(reason) = run.end_reason.as_ref().filter(|_| run.state == RunState::Failed) {
            outln!("       {reason}");
        }
        if let Some(who) = &run.signed {
            outln!("       signed by {who}");
        }
        let stopped = !matches!(run.state, RunState::Finished | RunState::Failed | RunState::Running);
        let mut stored = stopped.then(|| journal.load_run(run.id)).transpose()?;
        stored.iter_mut().for_each(|stored| stored.summary.state = run.state);
        if let Some(next_action) = stored.as_ref().and_then(next_action) {
            outln!("       {}", add_state_option(&next_action, state));
        }
    }
    Ok(())
}

/// Present state of a run. A run in state `running` is interrupted if no process holds the lock of its machine. The
/// next process that acquires the lock writes the state `interrupted` to the journal.
fn current_run_state(run: &RunSummary, folder: &Path) -> RunState {
    let is_dead = || MachineLock::holder(folder, &run.machine).is_none();
    match run.state {
        RunState::Running if is_dead() => RunState::Interrupted,
        state => state,
    }
}

pub fn show_run(args: &ShowArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let folder = state_folder(state)?;
    let journal = Journal::open(&folder)?;
    let run = RunId(args.run);
    let mut stored = journal.load_run(run)?;
    stored.summary.state = current_run_state(&stored.summary, &folder);
    if let Some(file) = &args.report {
        show::write_report(&journal, run, file)?;
        errln!("written: {}", file.display());
    }
    let last = stored.estimates.last().map(|stored| &stored.estimate);
    if args.json {
        return show::print_json(&last);
    }
    outln!(
        "run {run}: {} on {}, started {:.0}, {}, {} readings",
        stored.summary.method,
        stored.summary.machine,
        stored.summary.started,
        stored.summary.state.as_str(),
        stored.readings.len()
    );
    print_events_and_next_action(&stored, state);
    match last {
        Some(estimate) => {
            show::print_estimate(estimate);
            for (name, said) in temperature::temperature_rows(&stored.readings) {
                outln!("thermometer {name}: {said}");
            }
        }
        None => {
            let advice = format!("`trued export {run}` writes its readings to files");
            outln!("no estimate: {}", add_state_option(&advice, state));
        }
    }
    Ok(())
}

/// Next action that is possible for the run.
pub fn next_action(stored: &StoredRun) -> Option<String> {
    run_story::next_action(stored, can_resume(&stored.plan, &stored.readings))
}

fn print_events_and_next_action(stored: &StoredRun, state: Option<&Path>) {
    for (at, told) in run_story::in_local_time(describe_events_with_times(stored)) {
        outln!("{at}  {told}");
    }
    let summary = &stored.summary;
    if summary.state != RunState::Finished {
        outln!("{}", describe_run_end(stored));
    }
    if let Some(next_action) = next_action(stored) {
        outln!("  → {}", add_state_option(&next_action, state));
    }
}

pub fn export_run(args: &ExportArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let run = RunId(args.run);
    let stored = journal.load_run(run)?;
    std::fs::create_dir_all(&args.to).map_err(|error| CommandFailure::from_file_error(&args.to, &error))?;
    let write = |name: String, content: &[u8]| {
        let file = args.to.join(name);
        std::fs::write(&file, content).map_err(|error| CommandFailure::from_file_error(&file, &error))?;
        outln!("{}", file.display());
        Ok::<(), CommandFailure>(())
    };
    let plan = serde_json::to_vec_pretty(&stored.plan).map_err(CommandFailure::without_remedy)?;
    write(format!("run-{run}-plan.json"), &plan)?;
    let csv = run_files::readings_file(&stored).map_err(CommandFailure::without_remedy)?;
    write(run_files::readings_file_name(run), &csv)?;
    write(format!("run-{run}-machine.toml"), stored.machine_file_text.as_bytes())?;
    if args.frame == Some(ExportFrame::Workpiece) {
        let estimate = args.with.as_deref().map(read_estimate).transpose()?;
        let points = readings_in_workpiece_frame_csv(&stored.plan, &stored.readings, estimate.as_ref())?;
        write(format!("run-{run}-points.csv"), points.as_bytes())?;
    }
    if let Some(estimate) = run_files::estimate_file(&stored).map_err(CommandFailure::without_remedy)? {
        write(run_files::estimate_file_name(run), estimate.as_bytes())?;
    }
    if let Some(results) = run_files::results_file(&stored).map_err(CommandFailure::without_remedy)? {
        write(run_files::results_file_name(run), &results)?;
        show::write_report(&journal, run, &args.to.join(format!("run-{run}-report.html")))?;
    }
    Ok(())
}

/// Readings without a flag in the workpiece frame: for a touch the centre of the stylus ball; mm, with standard
/// uncertainties.
fn readings_in_workpiece_frame_csv(
    plan: &Plan,
    readings: &[Reading],
    estimate: Option<&Estimate>,
) -> Result<String, CommandFailure> {
    let frame = WorkpieceTransform::new(plan, estimate)?;
    errln!("points: {}", frame.describe_stylus());
    let mut lines = vec!["step,label,repeat,sensor,x_mm,y_mm,z_mm,u_x_mm,u_y_mm,u_z_mm".to_owned()];
    for reading in readings.iter().filter(|reading| reading.flag == ReadingFlag::None) {
        let Some(point) = frame.point_in_workpiece_frame(reading) else { continue };
        let step = plan.steps.iter().find(|step| step.id == reading.step);
        let label = step.map_or("", |step| step.label.as_str());
        let numbers = point.position_mm.iter().chain(point.u_mm.iter());
        let numbers: Vec<String> = numbers.map(|mm| format!("{:.6}", mm + 0.0)).collect();
        let Reading { step, repeat, sensor, .. } = reading;
        lines.push(format!("{step},{label},{repeat},{sensor},{}", numbers.join(",")));
    }
    Ok(lines.join("\n") + "\n")
}
