//! `trued compensate`: proposes values for the control from a stored run, writes approved ones, and restores them.

use std::fs::File;
use std::io::Write as _;
use std::path::Path;

use serde::Serialize;

use super::failure::CommandFailure;
use super::files::state_folder;
use super::result_args::{CompensateAction, CompensateArgs, ProposalSourceArgs, ProposeArgs, WriteCompensationArgs};
use super::{ExitStatus, show};
use crate::compensation::{
    CompensationTarget, CompensationWriteError, CompensationWriter, ControlProposal, ControlProposalError, TargetError,
    propose_for_control,
};
use crate::report::number::{decimals_for_uncertainty, format_fixed, one_line_symbol, with_one_line_symbols};
use crate::setup::{MachineFile, SetupError};
use crate::store::{Journal, MachineLock, RunId};
use methods::compensation::{AxisCoordinate, ProposalOptions, ProposedPosition, ProposedValue};

impl From<ControlProposalError> for CommandFailure {
    fn from(error: ControlProposalError) -> Self {
        let remedy = error.remedy();
        Self::new(error, remedy)
    }
}

impl From<CompensationWriteError> for CommandFailure {
    fn from(error: CompensationWriteError) -> Self {
        let remedy = error.remedy();
        Self::new(error, remedy)
    }
}

impl From<TargetError> for CommandFailure {
    fn from(error: TargetError) -> Self {
        let remedy = error.remedy();
        Self::new(error, remedy)
    }
}

/// The proposal as JSON, with the hash by which it is approved.
#[derive(Serialize)]
struct ProposalWithHash {
    sha256: String,
    #[serde(flatten)]
    proposal: ControlProposal,
}

/// What the sub-commands need.
struct CompensateContext<'a> {
    file: &'a MachineFile,
    folder: &'a Path,
    journal: &'a Journal,
    target: &'a CompensationTarget<'a>,
}

pub fn compensate_command(args: &CompensateArgs, state: Option<&Path>) -> Result<ExitStatus, CommandFailure> {
    let file = MachineFile::read(args.action.machine()).map_err(SetupError::from)?;
    let target = CompensationTarget::open(&file)?;
    let folder = state_folder(state)?;
    let journal = Journal::open(&folder)?;
    let context = CompensateContext { file: &file, folder: &folder, journal: &journal, target: &target };
    match &args.action {
        CompensateAction::Propose(proposal) => context.propose(proposal)?,
        CompensateAction::Write(write) => context.write(write)?,
        CompensateAction::Undo(by) => context.undo(&by.who)?,
        CompensateAction::Finish(by) => context.finish(&by.who)?,
        CompensateAction::Status(status) => context.print_status(status.hal.as_deref())?,
    }
    Ok(ExitStatus::Pass)
}

impl CompensateContext<'_> {
    fn proposal(&self, args: &ProposalSourceArgs) -> Result<ControlProposal, CommandFailure> {
        let options =
            ProposalOptions { with_insignificant_changes: args.with_insignificant, max_change_mm: args.max_change_mm };
        Ok(propose_for_control(self.journal, RunId(args.run), self.file, self.target, options)?)
    }

    fn propose(&self, args: &ProposeArgs) -> Result<(), CommandFailure> {
        let proposal = self.proposal(&args.source)?;
        match args.json {
            true => {
                let sha256 = proposal.sha256().map_err(CommandFailure::without_remedy)?;
                show::print_json(&ProposalWithHash { sha256, proposal })
            }
            false => print_proposal(&proposal),
        }
    }

    fn write(&self, args: &WriteCompensationArgs) -> Result<(), CommandFailure> {
        let lock = self.lock()?;
        let proposal = self.proposal(&args.source)?;
        let id = self.writer(&lock, &args.who).write(&proposal, &args.approve)?;
        let changed = proposal.proposal.values.iter().filter(|value| value.present_mm != value.proposed_mm);
        for ProposedValue { name, present_mm, proposed_mm } in changed {
            outln!("{name}: {} mm, was {} mm", format_fixed(*proposed_mm, 4), format_fixed(*present_mm, 4));
        }
        outln!(
            "compensation {id} is written and read back. Measure again: only a measurement shows that it is right. \
             LinuxCNC loses the values when it ends: `trued compensate status --hal FILE` writes them as lines of a HAL file"
        );
        Ok(())
    }

    fn undo(&self, who: &str) -> Result<(), CommandFailure> {
        let lock = self.lock()?;
        let undone = self.writer(&lock, who).undo()?;
        for change in &undone.changes {
            outln!("{}: {} mm, as before compensation {}", change.name, format_fixed(change.before_mm, 4), undone.id);
        }
        outln!(
            "if a HAL file contains the values of the compensation, restore it too: LinuxCNC reads it at each start"
        );
        Ok(())
    }

    fn finish(&self, who: &str) -> Result<(), CommandFailure> {
        let lock = self.lock()?;
        let finished = self.writer(&lock, who).finish()?;
        outln!("compensation {} is written and read back", finished.id);
        Ok(())
    }

    fn print_status(&self, hal: Option<&Path>) -> Result<(), CommandFailure> {
        let present = self.target.read()?;
        for value in present.values() {
            outln!("{:<32} {:>10} mm", value.name, format_fixed(value.present_mm, 4));
        }
        if let Some(path) = hal {
            write_new_file(path, &CompensationTarget::hal_lines(present.values()))?;
        }
        let Some(last) = self.journal.last_compensation(&self.file.machine.name)? else {
            outln!("no compensation of {} is in the journal", self.file.machine.name);
            return Ok(());
        };
        outln!(
            "compensation {} from run {}: {} by {} at {}",
            last.id,
            last.run,
            last.state.as_str(),
            last.who,
            last.at
        );
        for change in &last.changes {
            let [before, after] = [change.before_mm, change.after_mm].map(|mm| format_fixed(mm, 4));
            outln!("{:<32} before {before} mm, after {after} mm", change.name);
        }
        Ok(())
    }

    fn lock(&self) -> Result<MachineLock, CommandFailure> {
        Ok(MachineLock::acquire(self.folder, &self.file.machine.name)?)
    }

    fn writer<'a>(&'a self, lock: &'a MachineLock, who: &'a str) -> CompensationWriter<'a> {
        CompensationWriter { journal: self.journal, lock, target: self.target, who }
    }
}

fn write_new_file(path: &Path, text: &str) -> Result<(), CommandFailure> {
    let written = File::create_new(path).and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|error| {
        CommandFailure::new(format!("{} cannot be written: {error}", path.display()), "name a new file with --hal")
    })
}

fn print_proposal(proposal: &ControlProposal) -> Result<(), CommandFailure> {
    outln!("proposal from run {} for {}; nothing is written to the control", proposal.run, proposal.machine);
    outln!("{:<12} {:>10} {:>10} {:>9} {:>10}  unit", "position", "control", "measured", "U", "proposed");
    proposal.proposal.positions.iter().for_each(print_position);
    let [x, y, z] = proposal.proposal.at_mm.map(|mm| format_fixed(mm, 1));
    outln!(
        "positions with the tip at X {x} Y {y} Z {z} mm of the machine, and a stylus of {} mm",
        format_fixed(proposal.stylus_length_mm, 1)
    );
    outln!("{:<32} {:>10} {:>10}  unit", "value of the control", "present", "proposed");
    for ProposedValue { name, present_mm, proposed_mm } in &proposal.proposal.values {
        let [present, proposed] = [present_mm, proposed_mm].map(|mm| format_fixed(*mm, 4));
        outln!("{name:<32} {present:>10} {proposed:>10}  mm");
    }
    if let Some(predicted) = proposal.predicted {
        let [present, proposed] = predicted.map(|error| {
            format!("({} ± {}) µm", format_fixed(error.largest_um, 1), format_fixed(error.expanded_largest_um, 1))
        });
        outln!(
            "largest position error of the tool with tool centre point control, predicted over the measured ranges: \
             {present} with the present values, {proposed} with the proposed ones (U, k = 2)"
        );
    }
    let undetermined = proposal.proposal.positions.iter().filter(|position| position.measured_mm.is_none());
    let undetermined: Vec<String> = undetermined.map(position_name).collect();
    if !undetermined.is_empty() {
        outln!("the prediction takes the present {} as right", undetermined.join(", "));
    }
    proposal.warnings.iter().for_each(|warning| outln!("warning of the run: {}", with_one_line_symbols(warning)));
    for error in &proposal.remaining {
        let decimals = decimals_for_uncertainty(error.expanded);
        let [value, expanded] = [error.value, error.expanded].map(|number| format_fixed(number, decimals));
        let unit = error.unit.symbol();
        outln!("not corrected: {} {value} {unit}, U {expanded} {unit}", one_line_symbol(&error.symbol));
    }
    outln!("SHA-256 of the proposal: {}", proposal.sha256().map_err(CommandFailure::without_remedy)?);
    Ok(())
}

fn print_position(position: &ProposedPosition) {
    let ProposedPosition { present_mm, measured_mm, expanded_mm, proposed_mm, kept, .. } = position;
    let [present, proposed] = [present_mm, proposed_mm].map(|mm| format_fixed(*mm, 4));
    let [measured, expanded] =
        [measured_mm, expanded_mm].map(|mm| mm.map_or("–".to_owned(), |mm| format_fixed(mm, 4)));
    let kept = kept.as_ref().map_or(String::new(), |why| format!("  kept: {}; {}", why.reason, why.remedy));
    let name = position_name(position);
    outln!("{name:<12} {present:>10} {measured:>10} {expanded:>9} {proposed:>10}  mm{kept}");
}

fn position_name(position: &ProposedPosition) -> String {
    let AxisCoordinate { axis, component } = position.coordinate;
    format!("{component} of {axis}")
}
