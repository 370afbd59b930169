//! `trued run`: from one command to a stored, judged estimate.

use std::path::Path;

use super::args::{RunArgs, Speed};
use super::failure::Failure;
use super::progress::Progress;
use super::{Exit, show};
use crate::decision;
use crate::record::estimate::Estimate;
use crate::record::event::Event;
use crate::run::Run;
use crate::setup::{self, Devices, MachineFile, Pace};
use crate::store::{Journal, MachineLock, NewRun, RunId, state_dir};

pub fn run(args: &RunArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let machine = setup::load(args.machine.as_deref())?;
    let (method, plan) = setup::header(&machine, &args.method, args.repeat)?;
    let priors = args.with.iter().map(|file| read_estimate(file)).collect::<Result<Vec<_>, _>>()?;
    let folder = state_folder(state)?;
    let lock = MachineLock::acquire(&folder, &machine.machine.name)?;
    let journal = Journal::open(&folder)?;
    journal.mark_interrupted(&lock).wait()?;
    let new = NewRun { config: machine.text().to_owned(), plan: plan.clone() };

    let mut progress = Progress::start(args.json);
    let mut tell = |event: &Event| progress.tell(event);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(Failure::plain)?;
    let (id, plan, readings) = runtime.block_on(async {
        // A run begins when its machine is there.
        let devices = connect(&machine, args.speed).await?;
        stop_on_signals(&devices);
        let id = journal.begin(&new).await?;
        let mut run = Run {
            id,
            method: method.as_ref(),
            devices: &devices,
            journal: &journal,
            plan,
            readings: Vec::new(),
            moved: false,
            tell: &mut tell,
        };
        let ended = run.execute().await;
        let Run { plan, readings, moved, .. } = run;
        ended.map(|()| (id, plan, readings)).map_err(|error| Failure::of_run(&error, moved))
    })?;

    let mut estimate = method.identify(&plan, &readings, &priors)?;
    estimate.verdict = decision::judge(&estimate, &machine.tolerance);
    journal.estimate(id, &estimate).wait()?;
    tell_result(args, id, &estimate)?;
    if let Some(file) = &args.report {
        show::write_report(&journal, id, file)?;
    }
    Ok(estimate.verdict.into())
}

fn tell_result(args: &RunArgs, id: RunId, estimate: &Estimate) -> Result<(), Failure> {
    if args.json {
        show::print_json(estimate)
    } else {
        show::print_estimate(estimate);
        println!("\nstored as run {id}: `trued show {id} --report report.html` draws it");
        Ok(())
    }
}

async fn connect(machine: &MachineFile, speed: Speed) -> Result<Devices, Failure> {
    let pace = match speed {
        Speed::Real => Pace::Real,
        Speed::Fast => Pace::Fast,
    };
    Ok(setup::devices(machine, pace).await?)
}

/// Ctrl-C and SIGTERM hold the machine; the run then ends by itself, everything kept.
fn stop_on_signals(devices: &Devices) {
    use tokio::signal::unix::{SignalKind, signal};
    for kind in [SignalKind::interrupt(), SignalKind::terminate()] {
        let halt = devices.controller.halt();
        if let Ok(mut stream) = signal(kind) {
            tokio::spawn(async move {
                while stream.recv().await.is_some() {
                    halt.now();
                }
            });
        }
    }
}

/// Where journal and locks live.
pub fn state_folder(given: Option<&Path>) -> Result<std::path::PathBuf, Failure> {
    state_dir(given).ok_or_else(|| {
        Failure::new("no place for the journal is known", "give one with --state DIR")
    })
}

pub fn read_estimate(file: &Path) -> Result<Estimate, Failure> {
    let text = std::fs::read_to_string(file).map_err(|error| Failure::file(file, &error))?;
    serde_json::from_str(&text).map_err(|error| {
        Failure::new(
            format!("{}: {error}", file.display()),
            "an estimate as `trued run --json` prints it is expected",
        )
    })
}
