//! Runs checks of simulated machines, with simulated and other operators.

use trued::commissioning::{CheckFinding, CheckStop, CheckSummary, CheckVerdict, MachineCheck, OperatorInterface};
use trued::setup::{MachineFile, ReopenableMachine, SimulatedMachine, SimulationPace};
use trued::store::Journal;

const SIMULATED_MACHINE_TOML: &str = include_str!("../../../config/simulated.toml");
const SIMULATED_KIND_LINE: &str = "kind = \"simulated\"\n";
const MEMORY_WIRE_LINE: &str = "wire = \"memory\"\n";

/// The built-in machine, changed.
#[track_caller]
pub fn changed_machine_toml(changes: &[(&str, &str)]) -> String {
    let change = |text: String, (old, new): &(&str, &str)| {
        assert!(text.contains(old), "{old}");
        text.replacen(old, new, 1)
    };
    changes.iter().fold(SIMULATED_MACHINE_TOML.to_owned(), change)
}

/// The machine with additional lines in `[simulated]`, and any sections that follow.
pub fn machine_toml_with_simulated_lines(lines: &str) -> String {
    changed_machine_toml(&[]) + "\n" + lines
}

pub fn toml_with_control_keys(keys: &str, text: &str) -> String {
    assert!(text.contains(MEMORY_WIRE_LINE));
    text.replacen(MEMORY_WIRE_LINE, &format!("{keys}\n"), 1)
}

/// Checks a machine file with the simulated operator.
pub fn run_check(text: &str) -> CheckSummary {
    let file = MachineFile::parse("machine.toml", text.to_owned()).unwrap();
    runtime().block_on(async {
        let site = ReopenableMachine::new(&file).unwrap();
        let mut simulated_operator = site.simulated_operator().unwrap();
        check_with_operator(&file, &site, &mut simulated_operator).await
    })
}

/// Checks the machine file `declared` on a simulated control of the machine `actual`; `keys` makes the `[controller]`
/// of the former from the address of the latter.
pub fn check_against_other_machine(
    declared: &str,
    actual: &str,
    pace: SimulationPace,
    keys: impl Fn(String) -> String,
) -> CheckSummary {
    let truth = MachineFile::parse("truth.toml", actual.to_owned()).unwrap();
    runtime().block_on(async {
        let simulated = SimulatedMachine::new(&truth).unwrap();
        let served = simulated.serve_control(pace).unwrap();
        let controller = keys(served.controller_toml());
        let text =
            declared.replacen(SIMULATED_KIND_LINE, &format!("{controller}\n"), 1).replacen(MEMORY_WIRE_LINE, "", 1);
        let file = MachineFile::parse("machine.toml", text).unwrap();
        let site = ReopenableMachine::new(&file).unwrap();
        check_with_operator(&file, &site, &mut simulated.simulated_operator()).await
    })
}

pub async fn check_with_operator(
    file: &MachineFile,
    site: &ReopenableMachine<'_>,
    person: &mut dyn OperatorInterface,
) -> CheckSummary {
    let folder = tempfile::tempdir().unwrap();
    let journal = Journal::open(folder.path()).unwrap();
    let mut tell = |_: &CheckFinding| {};
    MachineCheck::new(file, site, SimulationPace::Immediate, &journal, person, CheckStop::default(), &mut tell)
        .run_all_parts()
        .await
}

pub fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

/// Failed findings, with their remedies.
pub fn failure_lines(summary: &CheckSummary) -> String {
    let failed = summary.findings.iter().filter(|finding| finding.verdict == CheckVerdict::Failed);
    failed.map(|finding| format!("{finding}\n")).collect()
}
