//! `trued runs`, `show`, `export`.

use std::path::Path;

use super::failure::Failure;
use super::files::{read_estimate, state_folder};
use super::result_args::{ExportArgs, Frame, RunsArgs, ShowArgs};
use super::{Exit, show, with_state};
use crate::archive::story::{self, how_it_ended, story};
use crate::report::{readings_csv, temperature};
use crate::run::can_resume;
use crate::store::{Journal, MachineLock, RunId, RunState, RunSummary, StoredRun};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::{Flag, Reading};
use methods::prediction::WorkpieceFrame;

pub fn list(args: &RunsArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let folder = state_folder(state)?;
    let journal = Journal::open(&folder)?;
    let mut runs = journal.runs()?;
    runs.iter_mut().for_each(|run| run.state = state_now(run, &folder));
    if args.json {
        show::print_json(&runs)?;
        return Ok(Exit::Pass);
    }
    if runs.is_empty() {
        say!("no runs yet: `trued run self-calibration` makes one");
    }
    for run in runs {
        say!(
            "{:>5}  {:.0}  {:<18} {:<14} {}",
            run.id.to_string(),
            run.started,
            run.method,
            run.state.as_str(),
            run.machine
        );
        if let Some(who) = &run.signed {
            say!("       signed by {who}");
        }
        let stopped =
            !matches!(run.state, RunState::Finished | RunState::Failed | RunState::Running);
        let mut stored = stopped.then(|| journal.load(run.id)).transpose()?;
        stored.iter_mut().for_each(|stored| stored.summary.state = run.state);
        if let Some(way_on) = stored.as_ref().and_then(way_on) {
            say!("       {}", with_state(&way_on, state));
        }
    }
    Ok(Exit::Pass)
}

/// Present state of a run. A run in state `running` whose machine is held by no process is interrupted; the
/// next process that acquires the machine writes that to the journal.
fn state_now(run: &RunSummary, folder: &Path) -> RunState {
    let is_dead = || MachineLock::holder(folder, &run.machine).is_none();
    match run.state {
        RunState::Running if is_dead() => RunState::Interrupted,
        state => state,
    }
}

pub fn show(args: &ShowArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let folder = state_folder(state)?;
    let journal = Journal::open(&folder)?;
    let run = RunId(args.run);
    let mut stored = journal.load(run)?;
    stored.summary.state = state_now(&stored.summary, &folder);
    if let Some(file) = &args.report {
        show::write_report(&journal, run, file)?;
        tell!("written: {}", file.display());
    }
    let last = stored.estimates.last().map(|stored| &stored.estimate);
    if args.json {
        show::print_json(&last)?;
        return Ok(Exit::Pass);
    }
    say!(
        "run {run}: {} on {}, started {:.0}, {}, {} readings",
        stored.summary.method,
        stored.summary.machine,
        stored.summary.started,
        stored.summary.state.as_str(),
        stored.readings.len()
    );
    tell_interruptions(&stored, state);
    match last {
        Some(estimate) => {
            show::print_estimate(estimate);
            for (name, said) in temperature::rows(&stored.readings) {
                say!("thermometer {name}: {said}");
            }
        }
        None => {
            let advice = format!("`trued export {run}` writes its readings to files");
            say!("no estimate: {}", with_state(&advice, state));
        }
    }
    Ok(Exit::Pass)
}

/// Next action that is possible for the run.
pub fn way_on(stored: &StoredRun) -> Option<String> {
    story::next_action(stored, can_resume(&stored.plan, &stored.readings))
}

fn tell_interruptions(stored: &StoredRun, state: Option<&Path>) {
    for (at, told) in story(stored) {
        say!("{at}  {told}");
    }
    let summary = &stored.summary;
    if summary.state != RunState::Finished {
        say!("{}", how_it_ended(stored));
    }
    if let Some(way_on) = way_on(stored) {
        say!("  → {}", with_state(&way_on, state));
    }
}

pub fn export(args: &ExportArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let run = RunId(args.run);
    let stored = journal.load(run)?;
    std::fs::create_dir_all(&args.to).map_err(|error| Failure::file(&args.to, &error))?;
    let write = |name: String, content: &[u8]| {
        let file = args.to.join(name);
        std::fs::write(&file, content).map_err(|error| Failure::file(&file, &error))?;
        say!("{}", file.display());
        Ok::<(), Failure>(())
    };
    write(format!("run-{run}-plan.json"), pretty(&stored.plan)?.as_bytes())?;
    let mut csv = Vec::new();
    let comments = [format!("run {run}: {} on {}", stored.plan.method, stored.plan.machine.name)];
    readings_csv::write(&stored.readings, &comments, &mut csv).map_err(Failure::plain)?;
    write(format!("run-{run}-readings.csv"), &csv)?;
    write(format!("run-{run}-machine.toml"), stored.config.as_bytes())?;
    if args.frame == Some(Frame::Workpiece) {
        let estimate = args.with.as_deref().map(read_estimate).transpose()?;
        let points = points_csv(&stored.plan, &stored.readings, estimate.as_ref())?;
        write(format!("run-{run}-points.csv"), points.as_bytes())?;
    }
    if let Some(last) = stored.estimates.last() {
        write(format!("run-{run}-estimate.json"), pretty(&last.estimate)?.as_bytes())?;
        show::write_report(&journal, run, &args.to.join(format!("run-{run}-report.html")))?;
    }
    Ok(Exit::Pass)
}

/// Readings as points of the workpiece, mm, with their standard uncertainties.
fn points_csv(
    plan: &Plan,
    readings: &[Reading],
    estimate: Option<&Estimate>,
) -> Result<String, Failure> {
    let frame = WorkpieceFrame::new(plan, estimate)?;
    tell!("points: {}", frame.stylus_in_words());
    let mut lines = vec!["step,label,repeat,sensor,x_mm,y_mm,z_mm,u_x_mm,u_y_mm,u_z_mm".to_owned()];
    for reading in readings.iter().filter(|reading| reading.flag == Flag::None) {
        let Some(point) = frame.point(reading) else { continue };
        let step = plan.steps.iter().find(|step| step.id == reading.step);
        let label = step.map_or("", |step| step.label.as_str());
        let numbers = point.at_mm.iter().chain(point.u_mm.iter());
        let numbers: Vec<String> = numbers.map(|mm| format!("{:.6}", mm + 0.0)).collect();
        let Reading { step, repeat, sensor, .. } = reading;
        lines.push(format!("{step},{label},{repeat},{sensor},{}", numbers.join(",")));
    }
    Ok(lines.join("\n") + "\n")
}

fn pretty(value: &impl serde::Serialize) -> Result<String, Failure> {
    serde_json::to_string_pretty(value).map_err(Failure::plain)
}
