//! `trued plan`: nominal plans and the programs of each dialect.

use super::compare::{check_json_against_baseline, check_text_against_baseline};
use super::digest::check_digest;
use super::method_cases::MethodCase;
use super::workspace::{Workspace, stderr_text};

/// Folders of gcode-templates/.
const DIALECTS: [&str; 3] = ["grbl", "grbl-m19", "linuxcnc"];

/// The plan of the built-in machine, as JSON and as text.
pub fn check_nominal_plan(case: &MethodCase) {
    let (workspace, method) = (Workspace::new(), case.method);
    check_json_against_baseline(&format!("plans/{method}.json"), &workspace.run_json(&["plan", method, "--json"]));
    check_text_against_baseline(&format!("plans/{method}.txt"), &workspace.run_stdout(&["plan", method]));
}

/// The programs for the built-in machine, with the proof's messages on standard error. A dialect that cannot
/// express the plan is refused; the refusal is stored.
pub fn check_gcode_programs(case: &MethodCase) {
    let workspace = Workspace::with_machine_file(&case.short_run_machine_file());
    let (method, machine) = (case.method, workspace.file_path("machine.toml"));
    for dialect in DIALECTS {
        let output = workspace.run_trued(&["plan", method, "--gcode", dialect]);
        let code = output.status.code().unwrap();
        let proof = format!("exit code {code}\n{}", stderr_text(&output));
        check_text_against_baseline(&format!("programs/{method}-{dialect}-proof.txt"), &proof);
        let program = String::from_utf8(output.stdout).unwrap();
        if code != 0 {
            continue;
        }
        if case.has_large_output && dialect != "grbl" {
            check_digest(&format!("programs/{method}-{dialect}.digest"), &program);
            let arguments = ["plan", method, "--machine", &machine, "--gcode", dialect];
            let program = workspace.run_stdout(&arguments);
            check_text_against_baseline(&format!("programs/{method}-{dialect}-short.ngc"), &program);
        } else {
            check_text_against_baseline(&format!("programs/{method}-{dialect}.ngc"), &program);
        }
    }
}
