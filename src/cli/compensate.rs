//! `trued compensate`: proposes values for the control from a stored run, writes approved ones, and restores them.

use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::failure::CommandFailure;
use super::files::state_folder;
use super::result_args::{
    CompensateAction, CompensateArgs, ControlAction, ProposalSourceArgs, ProposeArgs, SheetArgs, TargetArgs,
    VerifyArgs, WriteCompensationArgs,
};
use super::{ExitStatus, show};
use crate::compensation::{
    CompensationError, CompensationStatus, HashedProposal, MachineCompensation, PositionRow, ProposalSource,
    ProposalTable, ValueRow, Verification, VerificationRow, VerificationTable, needs_control_link,
    render_correction_sheet,
};
use crate::report::number::format_fixed;
use crate::setup::{MachineFile, SetupError};
use crate::store::{Journal, MachineLock, RunId, StoredCompensation};
use methods::compensation::{ProposalOptions, ProposedValue};

impl From<CompensationError> for CommandFailure {
    fn from(error: CompensationError) -> Self {
        let remedy = error.remedy();
        Self::new(error, remedy)
    }
}

impl ProposalSourceArgs {
    fn source(&self) -> ProposalSource {
        let options = ProposalOptions {
            applies_insignificant_changes: self.with_insignificant,
            max_change_mm: self.max_change_mm,
        };
        ProposalSource { run: RunId(self.run), options }
    }
}

pub fn compensate_command(args: &CompensateArgs, state: Option<&Path>) -> Result<ExitStatus, CommandFailure> {
    let folder = state_folder(state)?;
    let journal = Journal::open(&folder)?;
    match &args.action {
        CompensateAction::Sheet(args) => write_sheet(&journal, args).map(|()| ExitStatus::Pass),
        CompensateAction::Control(action) => run_control_action(action, &folder, &journal),
    }
}

/// Writes the sheet to `out`.html and `out`.csv, which must not exist yet.
fn write_sheet(journal: &Journal, SheetArgs { run, out }: &SheetArgs) -> Result<(), CommandFailure> {
    let sheet = render_correction_sheet(journal, RunId(*run)).map_err(CompensationError::from)?;
    for (ending, content) in [("html", sheet.html.as_bytes()), ("csv", &sheet.csv)] {
        let path = PathBuf::from(format!("{out}.{ending}"));
        write_new_file(&path, content, "--out")?;
        outln!("{}", path.display());
    }
    Ok(())
}

/// Runs one action on the control; `OutOfTolerance` if a verification is not confirmed.
fn run_control_action(action: &ControlAction, folder: &Path, journal: &Journal) -> Result<ExitStatus, CommandFailure> {
    let TargetArgs { machine, target } = action.target();
    let file = MachineFile::read(machine).map_err(SetupError::from)?;
    let compensation = MachineCompensation::open(&file, journal, target.as_deref())?;
    let lock = || MachineLock::acquire(folder, &file.machine.name);
    // `write`, `undo` and `finish` take the lock below.
    let is_read = matches!(action, ControlAction::Propose(_) | ControlAction::Status(_));
    let _link_lock = (is_read && needs_control_link(&file, target.as_deref())).then(lock).transpose()?;
    match action {
        ControlAction::Propose(ProposeArgs { source, json }) => {
            let proposal = compensation.propose(source.source())?;
            if *json { show::print_json(&proposal)? } else { print_proposal(&proposal) }
        }
        ControlAction::Write(write) => write_compensation_and_print(&compensation, &lock()?, write)?,
        ControlAction::Verify(VerifyArgs { run, by, json }) => {
            let verification = compensation.verify(&lock()?, &by.who, RunId(*run))?;
            if *json {
                show::print_json(&verification)?
            } else {
                print_verification(&verification)
            }
            return Ok(if verification.is_confirmed() { ExitStatus::Pass } else { ExitStatus::OutOfTolerance });
        }
        ControlAction::Undo(by) => print_restored_values(&compensation, &compensation.undo(&lock()?, &by.who)?),
        ControlAction::Finish(by) => {
            let finished = compensation.finish(&lock()?, &by.who)?;
            outln!("compensation {} is finished", finished.id);
        }
        ControlAction::Status(args) => print_status_and_write_hal_file(&compensation, args.hal.as_deref())?,
    }
    Ok(ExitStatus::Pass)
}

fn write_compensation_and_print(
    compensation: &MachineCompensation<'_>,
    lock: &MachineLock,
    args: &WriteCompensationArgs,
) -> Result<(), CommandFailure> {
    let (id, proposal) = compensation.write(lock, &args.who, args.source.source(), &args.approve)?;
    let changed = proposal.proposal.values.iter().filter(|value| value.present_mm != value.proposed_mm);
    for ProposedValue { name, present_mm, proposed_mm, .. } in changed {
        outln!("{name}: {} mm, was {} mm", format_fixed(*proposed_mm, 4), format_fixed(*present_mm, 4));
    }
    outln!("compensation {id} is written and read back. {}", compensation.target().advice_after_write());
    Ok(())
}

fn print_verification(verification: &Verification) {
    let Verification { compensation, first_run, run, .. } = verification;
    outln!("compensation {compensation} by run {first_run}, verified by run {run}");
    let VerificationTable { rows, sentences, .. } = VerificationTable::new(verification);
    let width = rows.iter().map(|row| row.name.len()).fold("remaining error".len(), usize::max);
    outln!("{:<width$} {:>10} {:>10} {:>20}  unit", "remaining error", "predicted", "measured", "limit of difference");
    for VerificationRow { name, predicted, measured, limit, is_within_limits } in rows {
        let outside = if is_within_limits { "" } else { "  outside" };
        outln!("{name:<width$} {predicted:>10} {measured:>10} {limit:>20}  µm{outside}");
    }
    for sentence in sentences {
        outln!("{sentence}");
    }
}

fn print_restored_values(compensation: &MachineCompensation<'_>, undone: &StoredCompensation) {
    for change in &undone.changes {
        outln!("{}: {} mm, as before compensation {}", change.name, format_fixed(change.before_mm, 4), undone.id);
    }
    outln!("{}", compensation.target().advice_after_write());
}

fn print_status_and_write_hal_file(
    compensation: &MachineCompensation<'_>,
    hal: Option<&Path>,
) -> Result<(), CommandFailure> {
    let CompensationStatus { values, last } = compensation.status()?;
    for value in &values {
        outln!("{:<32} {:>10} mm", value.name, format_fixed(value.present_mm, 4));
    }
    if let Some(path) = hal {
        let lines = compensation
            .target()
            .startup_lines(&values)
            .ok_or_else(|| CommandFailure::new("these values are not lines of a HAL file", "leave out --hal"))?;
        write_new_file(path, lines.as_bytes(), "--hal")?;
    }
    let Some(last) = &last else {
        outln!("no compensation of this machine is in the journal");
        return Ok(());
    };
    let (state, who, at) = (last.state.as_str(), &last.who, last.at);
    let by_run = last.verified_by.map_or(String::new(), |run| format!(" with run {run}"));
    outln!("compensation {} from run {}: {state} by {who}{by_run} at {at}", last.id, last.run);
    for change in &last.changes {
        let [before, after] = [change.before_mm, change.after_mm].map(|mm| format_fixed(mm, 4));
        outln!("{:<32} before {before} mm, after {after} mm", change.name);
    }
    Ok(())
}

/// Writes a file that must not exist yet. `option`: command-line option that names the file, for the remedy.
fn write_new_file(path: &Path, content: &[u8], option: &str) -> Result<(), CommandFailure> {
    let written = File::create_new(path).and_then(|mut file| file.write_all(content));
    written.map_err(|error| {
        CommandFailure::new(
            format!("{} cannot be written: {error}", path.display()),
            format!("name a new file with {option}"),
        )
    })
}

/// Prints a table with these titles of its first three columns; nothing if it has no rows.
fn print_rows([name, present, measured]: [&str; 3], rows: &[PositionRow]) {
    if rows.is_empty() {
        return;
    }
    let width = rows.iter().map(|row| row.name.len()).fold(name.len(), usize::max);
    outln!("{name:<width$} {present:>10} {measured:>10} {:>9} {:>10}  unit", "U", "proposed");
    for PositionRow { name, present, measured, expanded, proposed, kept } in rows {
        let kept = kept.as_ref().map_or(String::new(), |why| format!("  kept: {why}"));
        outln!("{name:<width$} {present:>10} {measured:>10} {expanded:>9} {proposed:>10}  mm{kept}");
    }
}

fn print_proposal(proposal: &HashedProposal) {
    outln!(
        "proposal from run {} for {}; nothing is written to the control",
        proposal.proposal.run,
        proposal.proposal.machine
    );
    let ProposalTable { positions, travels, values, sentences } = ProposalTable::new(&proposal.proposal);
    print_rows(["position", "control", "measured"], &positions);
    print_rows(["correction of travel", "control", "required"], &travels);
    outln!("{:<32} {:>10} {:>10}  unit", "value of the control", "present", "proposed");
    for ValueRow { name, present, proposed, .. } in values {
        outln!("{name:<32} {present:>10} {proposed:>10}  mm");
    }
    for sentence in sentences {
        outln!("{sentence}");
    }
    outln!("SHA-256 of the proposal: {}", proposal.sha256);
}
