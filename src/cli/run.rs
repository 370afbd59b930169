//! `trued run`: from one command to a stored, judged estimate.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::args::{OutputArgs, RunArgs, Speed};
use super::failure::Failure;
use super::files::read_estimate;
use super::identify::judged;
use super::progress::Progress;
use super::signals::stop_on_signals;
use super::wires::Wires;
use super::{Exit, show};
use crate::controllers::Halt;
use crate::methods::Method;
use crate::record::estimate::Estimate;
use crate::record::event::Event;
use crate::record::plan::Plan;
use crate::record::reading::Reading;
use crate::run::{Run, RunError};
use crate::setup::{self, Devices, MachineFile, Pace, Past};
use crate::store::{Journal, MachineLock, NewRun, RunId};

/// How often a stop is looked for while the identification computes.
const STOP_POLL: Duration = Duration::from_millis(50);

pub fn run(args: &RunArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let machine = setup::load(args.machine.as_deref(), &args.method)?;
    let (method, plan) = setup::header(&machine, &args.method, args.repeat)?;
    let method: Arc<dyn Method> = method.into();
    let priors = args.with.iter().map(|file| read_estimate(file)).collect::<Result<Vec<_>, _>>()?;
    method.check_priors(&priors)?;
    check_report_folder(&args.output)?;
    let wires = Wires::of(args.output.capture.as_deref(), args.replay.as_deref())?;
    let folder = wires.folder(state)?;
    let lock = MachineLock::acquire(&folder, &machine.machine.name)?;
    let journal = Journal::open(&folder)?;
    journal.mark_interrupted(&lock).wait()?;
    let new = NewRun { config: machine.text().to_owned(), plan: plan.clone() };

    let mut progress = Progress::start(args.output.json);
    let mut tell = |event: &Event| progress.tell(event);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(Failure::plain)?;
    let found = runtime.block_on(async {
        // A run begins when its machine is there.
        let opening = connect(&machine, args.output.speed, Past::default());
        let devices = wires.connect(opening).await?;
        stop_on_signals(devices.controller.halt())?;
        let id = journal.begin(&new).await?;
        let mut run = Run::new(id, method.as_ref(), &devices, &journal, plan, &mut tell);
        let ended = run.execute().await;
        let measured = Measured::of(run, ended)?;
        let found = identify(&method, measured, priors, &devices.controller.halt()).await;
        found.map(|estimate| (id, estimate)).map_err(|failure| kept(failure, id, &args.method))
    });
    let found = wires.finish(found)?;
    conclude(&journal, &machine, found, &args.output, wires.keeps())
}

/// Judge, store, tell; `keeps`: the journal outlives the program.
pub fn conclude(
    journal: &Journal,
    machine: &MachineFile,
    (id, estimate): (RunId, Estimate),
    output: &OutputArgs,
    keeps: bool,
) -> Result<Exit, Failure> {
    let estimate = judged(estimate, machine);
    journal.estimate(id, &estimate).wait()?;
    tell_result(output, keeps.then_some(id), &estimate)?;
    if let Some(file) = &output.report {
        show::write_report(journal, id, file)?;
    }
    Ok(estimate.verdict.into())
}

/// What a run that came to its end has measured.
pub struct Measured {
    plan: Plan,
    readings: Vec<Reading>,
}

impl Measured {
    pub fn of(run: Run<'_>, ended: Result<(), RunError>) -> Result<Self, Failure> {
        let can_resume = run.can_resume();
        let Run { id, plan, readings, moved, resumed, .. } = run;
        match ended {
            Ok(()) => Ok(Self { plan, readings }),
            Err(error) => Err(Failure::of_run(&error, moved, resumed).of_stored(id, can_resume)),
        }
    }
}

/// Identify beside the runtime, so that a stop is still heard: the thread is then left behind and
/// ends with the program.
pub async fn identify(
    method: &Arc<dyn Method>,
    Measured { plan, readings }: Measured,
    priors: Vec<Estimate>,
    halt: &Halt,
) -> Result<Estimate, Failure> {
    tell!("identifying from {} readings", readings.len());
    let method = method.clone();
    let (answer, mut result) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || drop(answer.send(method.identify(&plan, &readings, &priors))));
    loop {
        // An answer not yet there leaves the receiver as it was.
        if let Ok(found) = tokio::time::timeout(STOP_POLL, &mut result).await {
            let ended =
                found.map_err(|_| Failure::plain("the identification ended without answer"))?;
            return ended.map_err(Failure::from);
        }
        if halt.is_halted() {
            let exit = Exit::Stopped;
            return Err(Failure { exit, ..Failure::plain("stopped during the identification") });
        }
    }
}

/// A failure after the measurement: everything measured is still there.
pub fn kept(failure: Failure, id: RunId, method: &str) -> Failure {
    let way_on = format!(
        "run {id} and its readings are kept: `trued identify {method} --run {id}`, or `trued export {id}`"
    );
    let remedy = failure.remedy.map_or(way_on.clone(), |remedy| format!("{remedy}; {way_on}"));
    Failure { remedy: Some(remedy), ..failure }
}

/// A report that cannot be written is told before the measurement.
pub fn check_report_folder(output: &OutputArgs) -> Result<(), Failure> {
    let Some(file) = &output.report else { return Ok(()) };
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    match folder {
        Some(folder) if !folder.is_dir() => Err(Failure::new(
            format!("{}: there is no such folder for the report", folder.display()),
            "make it, or choose another place with --report",
        )),
        _ => Ok(()),
    }
}

fn tell_result(
    output: &OutputArgs,
    kept: Option<RunId>,
    estimate: &Estimate,
) -> Result<(), Failure> {
    if output.json {
        return show::print_json(estimate);
    }
    show::print_estimate(estimate);
    match kept {
        Some(id) => say!("\nstored as run {id}: `trued show {id} --report report.html` draws it"),
        None => say!("\nreplayed: nothing was measured, nothing is stored"),
    }
    Ok(())
}

pub async fn connect(
    machine: &MachineFile,
    speed: Speed,
    past: Past<'_>,
) -> Result<Devices, Failure> {
    let pace = match speed {
        Speed::Real => Pace::Real,
        Speed::Fast => Pace::Fast,
    };
    Ok(setup::devices(machine, pace, past).await?)
}
