//! `trued run`: measures, and stores a judged estimate.

use std::path::Path;
use std::sync::Arc;

use jiff::Zoned;

use super::args::{OutputArgs, RunArgs, SimulationSpeed};
use super::daemon_client::DaemonClient;
use super::device_links::DeviceLinks;
use super::failure::CommandFailure;
use super::files::read_estimates;
use super::progress::ProgressDisplay;
use super::repeatability::print_repeatability;
use super::signals::start_signal_halt_thread;
use super::terminal::{enter_key_answer_source, login_name};
use super::{ExitStatus, add_state_option, show};
use crate::run::{Cycle, PromptAnswerSource, check_qualifications_match_probe, repeatability_of_runs};
use crate::setup::{self, Devices, EarlierSessions, MachineFile, SimulationPace};
use crate::store::{ArtefactRegister, Journal, MachineLock, RunId};
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;
use methods::Method;

/// `trued run`: measures and stores a run. If a daemon holds the machine, the daemon runs its cycle of the method.
pub fn measurement_run_command(args: &RunArgs, state: Option<&Path>) -> Result<ExitStatus, CommandFailure> {
    let machine = setup::load_machine_file(args.machine.as_deref(), &args.method)?;
    let (method, mut plan_without_steps) =
        setup::configure_method_and_plan_without_steps(&machine, &args.method, args.repeat)?;
    let method: Arc<dyn Method> = method.into();
    plan_without_steps.priors = read_estimates(&args.with)?;
    method.check_priors(&plan_without_steps)?;
    check_qualifications_match_probe(&plan_without_steps)?;
    check_report_folder(&args.output)?;
    let links = DeviceLinks::from_options(args.output.capture.as_deref(), args.replay.as_deref())?;
    let folder = links.state_folder(state)?;
    // The state folder of a replay contains no register: nothing moves, so an expired certificate is accepted.
    let register = ArtefactRegister::in_folder(&folder);
    plan_without_steps.report = register.report_data_for_run(&machine.report_data, Zoned::now().date())?;
    let lock = MachineLock::acquire(&folder, &machine.machine.name);
    let journal = Journal::open(&folder)?;
    let lock = match lock {
        Ok(lock) => lock,
        Err(error) => {
            let daemon = DaemonClient::from_lock_error(&error, &folder).ok_or(error)?;
            let (id, estimate) = daemon.run_cycle(args, &machine, &journal)?;
            return print_result_and_write_report(&journal, state, id, estimate, &args.output, true);
        }
    };
    journal.mark_running_runs_interrupted(&lock).wait()?;

    let mut progress = ProgressDisplay::start(args.output.json);
    let answers = prompt_answer_source(args, &progress);
    let mut tell = |event: &RunEvent| progress.show_event(event);
    let result = build_runtime()?.block_on(async {
        // The run begins after the devices are open.
        let opening = open_devices(&machine, args.output.speed, EarlierSessions::default());
        let devices = links.connect(opening).await?;
        start_signal_halt_thread(devices.open_controller.halt_handle())?;
        let cycle = Cycle { machine_file: &machine, method, plan_without_steps, prompt_answer_source: answers };
        let ended = cycle.run(&devices, &journal, |_| (), &mut tell).await;
        ended.map_err(|error| CommandFailure::from_cycle_error(&error, &args.method))
    });
    let (id, estimate) = links.end_capture_and_map_error(result)?;
    let exit = print_result_and_write_report(&journal, state, id, estimate, &args.output, links.is_journal_kept())?;
    if args.repeat.is_some_and(|passes| passes > 1) && !args.output.json {
        outln!("");
        match repeatability_of_runs(&journal, &[id]) {
            Ok(table) => print_repeatability(&table),
            // The result of the run itself is valid.
            Err(error) => errln!("no repeatability: {error}"),
        }
    }
    Ok(exit)
}

/// Source of the answers: the person at the terminal, or, in a replay, an automatic answer.
fn prompt_answer_source(args: &RunArgs, progress: &ProgressDisplay) -> PromptAnswerSource {
    let who = args.acknowledge.clone().unwrap_or_else(login_name);
    match args.replay {
        Some(_) => PromptAnswerSource::new(|_| Some("the replay".to_owned())),
        None => enter_key_answer_source(who, progress.line_printer()),
    }
}

/// Runtime with one thread for all tasks.
pub fn build_runtime() -> Result<tokio::runtime::Runtime, CommandFailure> {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_all().build().map_err(CommandFailure::without_remedy)
}

/// Prints the estimate, and writes the report if `--report` is given; `is_journal_kept` is false for a replay.
pub fn print_result_and_write_report(
    journal: &Journal,
    state: Option<&Path>,
    id: RunId,
    estimate: Estimate,
    output: &OutputArgs,
    is_journal_kept: bool,
) -> Result<ExitStatus, CommandFailure> {
    if output.json {
        show::print_json(&estimate)?;
    } else {
        show::print_estimate(&estimate);
        match is_journal_kept {
            true => {
                let advice = format!("`trued show {id} --report report.html` writes the report");
                outln!(
                    "\nstored as run {id} in {}: {}",
                    journal.state_dir().display(),
                    add_state_option(&advice, state)
                );
            }
            false => outln!("\nreplay: nothing was measured, nothing is stored"),
        }
    }
    if let Some(file) = &output.report {
        show::write_report(journal, id, file)?;
    }
    Ok(estimate.verdict.into())
}

/// Checks before the measurement that the folder of the report exists.
pub fn check_report_folder(output: &OutputArgs) -> Result<(), CommandFailure> {
    output.report.as_ref().map_or(Ok(()), |file| check_parent_folder(file, "the report", "--report"))
}

/// Checks that the folder of `file` exists.
pub fn check_parent_folder(file: &Path, what: &str, option: &str) -> Result<(), CommandFailure> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    match folder {
        Some(folder) if !folder.is_dir() => Err(CommandFailure::new(
            format!("the folder {} for {what} does not exist", folder.display()),
            format!("create the folder, or choose another folder with {option}"),
        )),
        _ => Ok(()),
    }
}

/// Opens the devices of the machine file; without `speed` a simulated machine runs at `Fast`.
pub async fn open_devices(
    machine: &MachineFile,
    speed: Option<SimulationSpeed>,
    earlier_sessions: EarlierSessions<'_>,
) -> Result<Devices, CommandFailure> {
    Ok(setup::open_devices(machine, speed.unwrap_or_default().into(), earlier_sessions).await?)
}

impl From<SimulationSpeed> for SimulationPace {
    fn from(speed: SimulationSpeed) -> Self {
        match speed {
            SimulationSpeed::Real => Self::RealTime,
            SimulationSpeed::Fast => Self::Immediate,
        }
    }
}
