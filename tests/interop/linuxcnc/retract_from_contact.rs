//! `trued check` moves a stylus out of contact.

use libtest_mimic::Failed;
use machine::Axis;
use machine::record::question::{AxisDirection, OperatorAnswer, OperatorQuestion};
use trued::commissioning::{AnswerFuture, CheckFinding, CheckStop, CheckVerdict, MachineCheck, OperatorInterface};
use trued::setup::{MachineFile, ReopenableMachine, SimulationPace};
use trued::store::Journal;

use super::driver::block_on;
use super::rig::lock_rig;
use super::run_workspace::RunWorkspace;

/// Answers each request for a retract direction with Z+, and keeps the Z positions of these requests.
#[derive(Default)]
struct RetractUpOperator {
    requested_at_z_mm: Vec<f64>,
}

impl OperatorInterface for RetractUpOperator {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        let answer = match question {
            OperatorQuestion::DisplayedPosition(_) => OperatorAnswer::Yes,
            OperatorQuestion::RetractDirection { position, .. } => {
                self.requested_at_z_mm.push(position.get_or_zero(Axis::Z));
                OperatorAnswer::Retract(AxisDirection { axis: Axis::Z, is_positive: true })
            }
            _ => OperatorAnswer::No,
        };
        Box::pin(std::future::ready(answer))
    }
}

pub fn check_retracts_a_stylus_in_contact_step_by_step() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let mut control = rig.connect_client()?;
    // Onto the top of the part at 103 mm, then 1.5 mm deeper.
    control.run_mdi("G53 G0 Z110")?;
    control.run_mdi("G38.3 Z95 F300")?;
    control.run_mdi("G53 G1 Z101.5 F60")?;
    let before = rig.wait_for_rest()?;
    let workspace = RunWorkspace::for_rig(&rig)?;
    let text = std::fs::read_to_string(workspace.machine_file_path())?;
    let file = MachineFile::parse("machine.toml", text)?;
    let (summary, operator) = block_on(async {
        let site = ReopenableMachine::new(&file)?;
        let folder = tempfile::tempdir()?;
        let journal = Journal::open(folder.path())?;
        let (mut person, mut tell) = (RetractUpOperator::default(), |_: &CheckFinding| {});
        let check = MachineCheck::new(
            &file,
            &site,
            SimulationPace::RealTime,
            &journal,
            &mut person,
            CheckStop::default(),
            &mut tell,
        );
        let summary = check.run_all_parts().await;
        Ok((summary, person))
    })?;
    let after = rig.wait_for_rest()?;
    let steps = operator.requested_at_z_mm.len() as f64;
    let is_led_out = (before[2] - 101.5).abs() < 0.01
        && operator.requested_at_z_mm.len() == 2
        && (after[2] - before[2] - steps).abs() < 0.01
        && [0, 1, 3, 4].iter().all(|joint| (after[*joint] - before[*joint]).abs() < 0.01);
    let told = summary.to_string();
    // The check always ends after a retract: the unexpected contact puts the displayed position in doubt.
    let ends = told.contains("the stylus is out of contact and the probe reads open")
        && told.contains("axes    not checked")
        && summary.finding_count(CheckVerdict::Failed) == 1;
    if is_led_out && ends {
        return Ok(());
    }
    Err(format!("{before:?} {after:?} {:?}\n{summary}", operator.requested_at_z_mm).into())
}
