//! `trued compensate`: proposes values for the control from the estimate of a stored run. It writes nothing to the
//! control.

use std::path::Path;

use super::failure::CommandFailure;
use super::files::state_folder;
use super::result_args::CompensateArgs;
use super::{ExitStatus, show};
use crate::archive::compensation::{ControlProposal, ControlProposalError, propose_for_control};
use crate::report::number::{decimals_for_uncertainty, format_fixed, one_line_symbol};
use crate::setup::{CompensationTargetError, MachineFile, SetupError, read_target_values};
use crate::store::{Journal, RunId, sha256};
use methods::compensation::{ProposalOptions, ProposedValue};

impl From<ControlProposalError> for CommandFailure {
    fn from(error: ControlProposalError) -> Self {
        let remedy = error.remedy();
        Self::new(error, remedy)
    }
}

impl From<CompensationTargetError> for CommandFailure {
    fn from(error: CompensationTargetError) -> Self {
        let remedy = error.remedy();
        Self::new(error, remedy)
    }
}

pub fn propose_compensation(args: &CompensateArgs, state: Option<&Path>) -> Result<ExitStatus, CommandFailure> {
    let file = MachineFile::read(&args.machine).map_err(SetupError::from)?;
    let config = file.compensation.as_ref().ok_or_else(|| {
        CommandFailure::new(
            format!("{} has no section [compensation]", args.machine.display()),
            "state where the control keeps its values, e.g. kind = \"linuxcnc-trunnion\" and kinematics = \
             \"xyzbc-trt-kins\"",
        )
    })?;
    let journal = Journal::open(&state_folder(state)?)?;
    let values = read_target_values(config, &file.machine)?;
    let options =
        ProposalOptions { with_insignificant_changes: args.with_insignificant, max_change_mm: args.max_change_mm };
    let proposal = propose_for_control(&journal, RunId(args.run), &file.machine, &values, options)?;
    match args.json {
        true => show::print_json(&proposal)?,
        false => print_proposal(&proposal)?,
    }
    Ok(ExitStatus::Pass)
}

fn print_proposal(proposal: &ControlProposal) -> Result<(), CommandFailure> {
    outln!("proposal from run {} for {}; nothing is written to the control", proposal.run, proposal.machine);
    outln!("{:<32} {:>10} {:>10} {:>9} {:>10}  unit", "value", "present", "measured", "U", "proposed");
    for value in &proposal.proposal.values {
        print_value(value);
    }
    if let Some([present, proposed]) = proposal.predicted {
        outln!(
            "largest position error of the tool with tool centre point control, predicted over the measured ranges: {} µm \
             (95 %: at most {} µm) with the present values, {} µm (95 %: at most {} µm) with the proposed ones",
            format_fixed(present.largest_um, 1),
            format_fixed(present.bound_um, 1),
            format_fixed(proposed.largest_um, 1),
            format_fixed(proposed.bound_um, 1)
        );
    }
    for error in &proposal.not_corrected {
        let decimals = decimals_for_uncertainty(error.expanded);
        let [value, expanded] = [error.value, error.expanded].map(|number| format_fixed(number, decimals));
        let unit = error.unit.symbol();
        outln!("not corrected: {} {value} {unit}, U {expanded} {unit}", one_line_symbol(&error.symbol));
    }
    outln!("SHA-256 of the proposal: {}", sha256(proposal).map_err(CommandFailure::without_remedy)?);
    Ok(())
}

fn print_value(value: &ProposedValue) {
    let ProposedValue { name, present_mm, measured_mm, expanded_mm, proposed_mm, kept_because } = value;
    let [present, proposed] = [present_mm, proposed_mm].map(|mm| format_fixed(*mm, 4));
    let [measured, expanded] =
        [measured_mm, expanded_mm].map(|mm| mm.map_or("–".to_owned(), |mm| format_fixed(mm, 4)));
    let kept = kept_because.as_ref().map_or(String::new(), |reason| format!("  kept: {reason}"));
    outln!("{name:<32} {present:>10} {measured:>10} {expanded:>9} {proposed:>10}  mm{kept}");
}
