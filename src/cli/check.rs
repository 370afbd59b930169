//! `trued check`: compares the machine with its machine file.

use std::io::IsTerminal as _;
use std::path::Path;

use super::args::CheckArgs;
use super::failure::CommandFailure;
use super::files::state_folder;
use super::run::build_runtime;
use super::signals::start_signal_halt_thread;
use super::terminal::TerminalOperator;
use super::{ExitStatus, show};
use crate::commissioning::{
    CheckFinding, CheckStop, CheckSummary, CheckVerdict, MachineCheck, NoOperator, OperatorInterface,
};
use crate::setup::{self, ReopenableMachine};
use crate::store::{ArtefactRegister, Journal, MachineLock};

/// Method name for loading the machine file. The choice of the method has no effect on the check.
const PLACEHOLDER_METHOD: &str = "self-calibration";

/// `trued check`: runs all parts under the lock of the machine, with the simulated operator for a simulated machine.
pub fn commissioning_check_command(args: &CheckArgs, state: Option<&Path>) -> Result<ExitStatus, CommandFailure> {
    let mut machine = setup::load_machine_file(args.machine.as_deref(), PLACEHOLDER_METHOD)?;
    let folder = state_folder(state)?;
    machine.report_data = ArtefactRegister::in_folder(&folder).complete_report_data(&machine.report_data)?;
    let lock = MachineLock::acquire(&folder, &machine.machine.name)?;
    let journal = Journal::open(&folder)?;
    journal.mark_running_runs_interrupted(&lock).wait()?;
    if let Some(unfinished) = journal.unfinished_compensation(&machine.machine.name)? {
        return Err(CommandFailure::new(&unfinished, unfinished.remedy()));
    }
    let reopenable_machine = ReopenableMachine::new(&machine)?;
    let stop = CheckStop::default();
    start_signal_halt_thread(stop.halt_handle())?;
    let mut operator = select_operator(&reopenable_machine, &stop);
    let mut on_finding = |finding: &CheckFinding| {
        if args.json { errln!("{finding}") } else { outln!("{finding}") }
    };
    let pace = args.speed.into();
    let operator = operator.as_mut();
    let check = MachineCheck::new(&machine, &reopenable_machine, pace, &journal, operator, stop, &mut on_finding);
    let summary = build_runtime()?.block_on(check.run_all_parts());
    if args.json {
        show::print_json(&summary)?;
    } else {
        outln!("\nSummary for a support request:\n\n{summary}");
    }
    Ok(exit_status(&summary))
}

/// The simulated operator of a simulated machine, otherwise the operator at the terminal; no operator if standard
/// input is not a terminal.
fn select_operator(reopenable_machine: &ReopenableMachine<'_>, stop: &CheckStop) -> Box<dyn OperatorInterface> {
    match reopenable_machine.simulated_operator() {
        Some(simulated_operator) => Box::new(simulated_operator),
        None if std::io::stdin().is_terminal() => Box::new(TerminalOperator::new(stop.clone())),
        None => {
            errln!("standard input is not a terminal: checks that need an operator are skipped");
            Box::new(NoOperator)
        }
    }
}

/// `Stopped` after a stop request, `Error` after a failed check, otherwise `Pass`; checks that were skipped count as
/// passed.
fn exit_status(summary: &CheckSummary) -> ExitStatus {
    match summary {
        _ if summary.stopped => ExitStatus::Stopped,
        _ if summary.finding_count(CheckVerdict::Failed) > 0 => ExitStatus::Error,
        _ => ExitStatus::Pass,
    }
}
