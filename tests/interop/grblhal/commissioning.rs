//! From an unconfigured control to the first result: `init`, completion of the file, `check` with an operator,
//! `run`.

use std::process::Output;

use libtest_mimic::Failed;
use machine::record::question::{ObservedMotion, OperatorAnswer, OperatorQuestion, StylusState};
use trued::commissioning::{
    AnswerFuture, CheckFinding, CheckPart, CheckStop, CheckSummary, CheckVerdict, MachineCheck, OperatorInterface,
};
use trued::setup::{MachineFile, ReopenableMachine, SimulationPace};
use trued::store::Journal;

use super::cycle::{FIRST_TRUE_C_AXIS_UM, SHORT_RUN_TEXT_CHANGES, check_truth_within_u, run_method_for_estimate};
use super::rig::{GrblHalRig, MACHINE_FILE};
use crate::linuxcnc::driver::block_on;
use crate::linuxcnc::run_workspace::{RunWorkspace, failure_text};

/// Keys that the control does not report: the operator completes them.
const UNREPORTED_SECTIONS: [&str; 4] = ["probe", "solid", "artefact", "method"];
const UNREPORTED_ROTARY_AXIS_KEYS: [&str; 4] = ["positive", "point_mm", "min", "max"];

/// Allows every motion and confirms that it agrees with the file. Deflects the stylus, and releases the control
/// after a hold by reset and homing.
struct GrblHalRigOperator<'a> {
    rig: &'a mut GrblHalRig,
    stylus_is_deflected: bool,
    rig_failure: Option<Failed>,
}

impl GrblHalRigOperator<'_> {
    fn set_stylus_deflected(&mut self, is_deflected: bool) -> Result<(), Failed> {
        if is_deflected != self.stylus_is_deflected {
            self.rig.press_button('p')?;
            self.stylus_is_deflected = is_deflected;
        }
        Ok(())
    }

    fn reset_and_home_control(&self) -> Result<(), Failed> {
        self.rig.soft_reset()?;
        self.rig.home_axes()
    }
}

impl OperatorInterface for GrblHalRigOperator<'_> {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        let done = match question {
            OperatorQuestion::StylusState(stylus) => self.set_stylus_deflected(*stylus == StylusState::Deflected),
            OperatorQuestion::HoldReleased { .. } => self.reset_and_home_control(),
            _ => Ok(()),
        };
        let answer = match (done, question) {
            (Err(fault), _) => {
                self.rig_failure = Some(fault);
                OperatorAnswer::NoOperator
            }
            (Ok(()), OperatorQuestion::ObservedJog { .. }) => OperatorAnswer::Motion(ObservedMotion::AsAnnounced),
            (Ok(()), OperatorQuestion::RetractDirection { .. }) => OperatorAnswer::No,
            (Ok(()), _) => OperatorAnswer::Yes,
        };
        Box::pin(std::future::ready(answer))
    }
}

/// The draft of `init`, with the keys of `config/grblhal-sim.toml` that the control does not report.
fn complete_machine_file(drafted: &str) -> Result<String, Failed> {
    let mut short = MACHINE_FILE.to_owned();
    for (from, to) in SHORT_RUN_TEXT_CHANGES {
        short = short.replace(from, to);
    }
    let mut file: toml::Table = toml::from_str(drafted)?;
    let known: toml::Table = toml::from_str(&short)?;
    for key in UNREPORTED_SECTIONS {
        file.insert(key.to_owned(), known[key].clone());
    }
    file["machine"]["tool_mm"] = known["machine"]["tool_mm"].clone();
    for axis in ["B", "C"] {
        let axis_table = file["axes"][axis].as_table_mut().ok_or("no table")?;
        for key in UNREPORTED_ROTARY_AXIS_KEYS {
            axis_table.insert(key.to_owned(), known["axes"][axis][key].clone());
        }
    }
    Ok(toml::to_string(&file)?)
}

fn run_check(workspace: &RunWorkspace, rig: &mut GrblHalRig) -> Result<CheckSummary, Failed> {
    let text = std::fs::read_to_string(workspace.machine_file_path())?;
    let file = MachineFile::parse("machine.toml", text)?;
    let (summary, fault) = block_on(async {
        let site = ReopenableMachine::new(&file)?;
        let folder = tempfile::tempdir()?;
        let journal = Journal::open(folder.path())?;
        let mut operator = GrblHalRigOperator { rig, stylus_is_deflected: false, rig_failure: None };
        let mut report = |_: &CheckFinding| {};
        let check = MachineCheck::new(
            &file,
            &site,
            SimulationPace::RealTime,
            &journal,
            &mut operator,
            CheckStop::default(),
            &mut report,
        );
        let summary = check.run_all_parts().await;
        Ok((summary, operator.rig_failure))
    })?;
    fault.map_or(Ok(summary), Err)
}

pub fn init_check_and_run_give_a_result() -> Result<(), Failed> {
    let mut rig = GrblHalRig::start_homed(&[])?;
    let workspace = rig.create_run_workspace(&[])?;
    std::fs::remove_file(workspace.machine_file_path())?;
    let (at, to) =
        (format!("127.0.0.1:{}", rig.proxy.listen_port), workspace.machine_file_path().display().to_string());
    let init: Output =
        RunWorkspace::trued_command_without_journal(&["init", "--kind", "grbl", "--tcp", &at, "--to", &to]).output()?;
    if init.status.code() != Some(0) {
        return Err(failure_text(&init).into());
    }
    let drafted = std::fs::read_to_string(&to)?;
    std::fs::write(&to, complete_machine_file(&drafted)?)?;
    let summary = run_check(&workspace, &mut rig)?;
    eprintln!("{summary}");
    // The optional keys of [report] are missing in the draft.
    let is_open = |finding: &CheckFinding| finding.verdict != CheckVerdict::Ok && finding.part != CheckPart::Report;
    if summary.findings.iter().any(is_open) {
        return Err(summary.to_string().into());
    }
    check_truth_within_u(&run_method_for_estimate(&workspace, "self-calibration")?, &FIRST_TRUE_C_AXIS_UM)
}
