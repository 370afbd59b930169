//! Runs a check of a machine without an operator.

use trued::commissioning::{CheckFinding, CheckStop, CheckSummary, MachineCheck, OperatorInterface, Verdict};
use trued::setup::{MachineFile, ReopenableMachine, SimulatedMachine, SimulationPace};
use trued::store::Journal;

const MACHINE: &str = include_str!("../../../config/simulated.toml");
const CONTROLLER: &str = "kind = \"simulated\"\n";
const WIRE: &str = "wire = \"memory\"\n";

/// The built-in machine, changed.
#[track_caller]
pub fn changed_machine(changes: &[(&str, &str)]) -> String {
    let change = |text: String, (old, new): &(&str, &str)| {
        assert!(text.contains(old), "{old}");
        text.replacen(old, new, 1)
    };
    changes.iter().fold(MACHINE.to_owned(), change)
}

/// The machine with additional lines in `[simulated]`, and any sections that follow.
pub fn machine_with_truth(lines: &str) -> String {
    changed_machine(&[]) + "\n" + lines
}

pub fn machine_with_control(keys: &str, text: &str) -> String {
    assert!(text.contains(WIRE));
    text.replacen(WIRE, &format!("{keys}\n"), 1)
}

/// Checks a machine file with the simulated operator.
pub fn run_check(text: &str) -> CheckSummary {
    let file = MachineFile::parse("machine.toml", text.to_owned()).unwrap();
    runtime().block_on(async {
        let site = ReopenableMachine::new(&file).unwrap();
        let mut simulated_operator = site.simulated_operator().unwrap();
        check_through_operator(&file, &site, &mut simulated_operator).await
    })
}

/// Checks the machine file `told` with a simulated control that follows `true_to`; `keys` makes the `[controller]`
/// of the first from the address of the second.
pub fn check_against_other_machine(
    told: &str,
    true_to: &str,
    pace: SimulationPace,
    keys: impl Fn(String) -> String,
) -> CheckSummary {
    let truth = MachineFile::parse("truth.toml", true_to.to_owned()).unwrap();
    runtime().block_on(async {
        let rehearsal = SimulatedMachine::new(&truth).unwrap();
        let served = rehearsal.serve(pace).unwrap();
        let controller = keys(served.controller_toml());
        let text = told.replacen(CONTROLLER, &format!("{controller}\n"), 1).replacen(WIRE, "", 1);
        let file = MachineFile::parse("machine.toml", text).unwrap();
        let site = ReopenableMachine::new(&file).unwrap();
        check_through_operator(&file, &site, &mut rehearsal.simulated_operator()).await
    })
}

pub async fn check_through_operator(
    file: &MachineFile,
    site: &ReopenableMachine<'_>,
    person: &mut dyn OperatorInterface,
) -> CheckSummary {
    let folder = tempfile::tempdir().unwrap();
    let journal = Journal::open(folder.path()).unwrap();
    let mut tell = |_: &CheckFinding| {};
    MachineCheck::new(file, site, SimulationPace::Fast, &journal, person, CheckStop::default(), &mut tell)
        .run_all_parts()
        .await
}

pub fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

/// Failed findings, with their remedies.
pub fn failure_lines(summary: &CheckSummary) -> String {
    let failed = summary.findings.iter().filter(|finding| finding.verdict == Verdict::Failed);
    failed.map(|finding| format!("{finding}\n")).collect()
}
