//! `trued plan`: nominal plans and the programs of each dialect.

use super::compare::{check_json, check_text};
use super::digest::check_digest;
use super::machines::Case;
use super::workspace::{Workspace, stderr};

/// Folders of gcode-templates/.
const DIALECTS: [&str; 3] = ["grbl", "grbl-m19", "linuxcnc"];

/// The plan of the built-in machine, as JSON and as text.
pub fn plan(case: &Case) {
    let (workspace, method) = (Workspace::new(), case.method);
    check_json(&format!("plans/{method}.json"), &workspace.json(&["plan", method, "--json"]));
    check_text(&format!("plans/{method}.txt"), &workspace.stdout(&["plan", method]));
}

/// The programs for the built-in machine, with the proof's messages on standard error. A dialect that cannot
/// express the plan is refused; the refusal is stored.
pub fn programs(case: &Case) {
    let workspace = Workspace::with_machine(&case.short_machine());
    let (method, machine) = (case.method, workspace.path("machine.toml"));
    for dialect in DIALECTS {
        let output = workspace.output(&["plan", method, "--gcode", dialect]);
        let code = output.status.code().unwrap();
        let proof = format!("exit code {code}\n{}", stderr(&output));
        check_text(&format!("programs/{method}-{dialect}-proof.txt"), &proof);
        let program = String::from_utf8(output.stdout).unwrap();
        if code != 0 {
            continue;
        }
        if case.is_large && dialect != "grbl" {
            check_digest(&format!("programs/{method}-{dialect}.digest"), &program);
            let arguments = ["plan", method, "--machine", &machine, "--gcode", dialect];
            let program = workspace.stdout(&arguments);
            check_text(&format!("programs/{method}-{dialect}-short.ngc"), &program);
        } else {
            check_text(&format!("programs/{method}-{dialect}.ngc"), &program);
        }
    }
}
