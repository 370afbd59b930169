//! From an unconfigured control to the first result: `init`, completion of the file, `check` with an operator,
//! `run`.

use std::process::Output;

use libtest_mimic::Failed;
use machine::record::question::{Answer, ObservedMotion, Question, StylusState};
use trued::commissioning::{AnswerFuture, Check, Finding, OperatorInterface, Stop, Summary, Verdict};
use trued::setup::{MachineFile, Pace, ReopenableMachine};
use trued::store::Journal;

use super::cycle::{FIRST_UM, SHORT, measured, near_the_truth};
use super::rig::{MACHINE, Rig};
use crate::linuxcnc::desk::{Desk, complaint};
use crate::linuxcnc::machine::run;

/// Keys that the control does not report: the operator completes them.
const TOP: [&str; 4] = ["probe", "solid", "artefact", "method"];
const OF_ROTARY_AXES: [&str; 4] = ["positive", "point_mm", "min", "max"];

/// Allows every motion and confirms that it agrees with the file. Deflects the stylus, and releases the control
/// after a hold by reset and homing.
struct Operator<'a> {
    rig: &'a mut Rig,
    stylus_is_deflected: bool,
    fault: Option<Failed>,
}

impl Operator<'_> {
    fn deflect(&mut self, deflected: bool) -> Result<(), Failed> {
        if deflected != self.stylus_is_deflected {
            self.rig.press('p')?;
            self.stylus_is_deflected = deflected;
        }
        Ok(())
    }

    fn release(&self) -> Result<(), Failed> {
        self.rig.reset()?;
        self.rig.home()
    }
}

impl OperatorInterface for Operator<'_> {
    fn wait_for_answer<'a>(&'a mut self, question: &'a Question) -> AnswerFuture<'a> {
        let done = match question {
            Question::StylusState(stylus) => self.deflect(*stylus == StylusState::Deflected),
            Question::HoldReleased { .. } => self.release(),
            _ => Ok(()),
        };
        let answer = match (done, question) {
            (Err(fault), _) => {
                self.fault = Some(fault);
                Answer::NoOperator
            }
            (Ok(()), Question::ObservedJog { .. }) => Answer::Motion(ObservedMotion::AsAnnounced),
            (Ok(()), Question::RetractDirection { .. }) => Answer::No,
            (Ok(()), _) => Answer::Yes,
        };
        Box::pin(std::future::ready(answer))
    }
}

/// The draft of `init`, with the keys of `config/grblhal-sim.toml` that the control does not report.
fn completed(drafted: &str) -> Result<String, Failed> {
    let mut short = MACHINE.to_owned();
    for (from, to) in SHORT {
        short = short.replace(from, to);
    }
    let mut file: toml::Table = toml::from_str(drafted)?;
    let known: toml::Table = toml::from_str(&short)?;
    for key in TOP {
        file.insert(key.to_owned(), known[key].clone());
    }
    file["machine"]["tool_mm"] = known["machine"]["tool_mm"].clone();
    for axis in ["B", "C"] {
        let axis_table = file["axes"][axis].as_table_mut().ok_or("no table")?;
        for key in OF_ROTARY_AXES {
            axis_table.insert(key.to_owned(), known["axes"][axis][key].clone());
        }
    }
    Ok(toml::to_string(&file)?)
}

fn checked(desk: &Desk, rig: &mut Rig) -> Result<Summary, Failed> {
    let text = std::fs::read_to_string(desk.machine())?;
    let file = MachineFile::parse("machine.toml", text)?;
    let (summary, fault) = run(async {
        let site = ReopenableMachine::new(&file)?;
        let folder = tempfile::tempdir()?;
        let journal = Journal::open(folder.path())?;
        let mut operator = Operator { rig, stylus_is_deflected: false, fault: None };
        let mut report = |_: &Finding| {};
        let check = Check::new(&file, &site, Pace::Real, &journal, &mut operator, Stop::default(), &mut report);
        let summary = check.run_all_parts().await;
        Ok((summary, operator.fault))
    })?;
    fault.map_or(Ok(summary), Err)
}

pub fn an_owner_gets_from_the_control_to_a_result() -> Result<(), Failed> {
    let mut rig = Rig::homed(&[])?;
    let desk = rig.desk(&[])?;
    std::fs::remove_file(desk.machine())?;
    let (at, to) = (format!("127.0.0.1:{}", rig.wire.port), desk.machine().display().to_string());
    let init: Output = Desk::program(&["init", "--kind", "grbl", "--tcp", &at, "--to", &to]).output()?;
    if init.status.code() != Some(0) {
        return Err(complaint(&init).into());
    }
    let drafted = std::fs::read_to_string(&to)?;
    std::fs::write(&to, completed(&drafted)?)?;
    let summary = checked(&desk, &mut rig)?;
    eprintln!("{summary}");
    if [Verdict::Failed, Verdict::NotLookedAt].iter().any(|verdict| summary.count(*verdict) != 0) {
        return Err(summary.to_string().into());
    }
    near_the_truth(&measured(&desk, "self-calibration")?, &FIRST_UM)
}
