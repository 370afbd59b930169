//! `trued check` as it is typed.

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;
use trued::setup::{MachineFile, Pace, Rehearsal};

use super::bench::{machine, runtime, with_truth};

struct Shop(TempDir);

impl Shop {
    fn new(text: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("machine.toml"), text).unwrap();
        Self(folder)
    }

    fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.arg("--state").arg(self.0.path().join("state")).arg("check");
        command.args(words).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Of the machine file.
    fn check(&self, words: &[&str]) -> Output {
        let file = self.0.path().join("machine.toml");
        let file = file.to_string_lossy();
        self.command(&[&["--machine", file.as_ref()], words].concat()).output().unwrap()
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

pub fn without_a_machine_file_the_simulated_machine_is_checked_by_itself() {
    let shop = Shop::new("");
    let output = shop.command(&[]).output().unwrap();
    let said = text(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{said}{}", text(&output.stderr));
    assert!(said.contains("to paste into a support request:\n\ntrued "), "{said}");
    assert!(said.contains("check of `simulated five-axis machine`\ncontrol: Grbl 1.1f"), "{said}");
}

pub fn a_mistake_ends_it_with_1_and_json_tells_it_as_data() {
    let shop = Shop::new(&with_truth("[simulated.wiring]\nprobe = \"inverted\"\n"));
    let output = shop.check(&["--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["machine"], "simulated five-axis machine");
    let findings = summary["findings"].as_array().unwrap();
    let failed: Vec<_> = findings.iter().filter(|found| found["verdict"] == "failed").collect();
    assert_eq!(failed.len(), 1, "{summary:#}");
    assert_eq!(failed[0]["part"], "probe");
    assert!(failed[0]["remedy"].is_string(), "{summary:#}");
}

pub fn with_a_real_control_and_no_terminal_nothing_moves_and_it_does_not_hang() {
    let truth = MachineFile::parse("truth.toml", machine(&[])).unwrap();
    let runtime = runtime();
    let served = runtime.block_on(async { Rehearsal::of(&truth)?.serve(Pace::Fast) }).unwrap();
    let keys = format!("{}\ndialect = \"grbl-m19\"\n", served.keys());
    let shop = Shop::new(&machine(&[
        ("kind = \"simulated\"\n", keys.as_str()),
        ("wire = \"memory\"\n", ""),
    ]));
    let (done, answered) = std::sync::mpsc::channel();
    std::thread::scope(|scope| {
        scope.spawn(|| done.send(shop.check(&[])).unwrap());
        // The control lives as long as its runtime runs.
        let output = runtime.block_on(async {
            loop {
                match answered.try_recv() {
                    Ok(output) => return output,
                    Err(_) => tokio::time::sleep(std::time::Duration::from_millis(10)).await,
                }
            }
        });
        let said = text(&output.stdout);
        assert_eq!(output.status.code(), Some(0), "{said}{}", text(&output.stderr));
        assert!(text(&output.stderr).contains("nobody is at a terminal"));
        assert!(
            said.contains("axes    not looked at  nobody is there to show that the probe answers"),
            "{said}"
        );
        assert!(!said.contains("axes    ok"), "{said}");
    });
}

pub fn ctrl_c_holds_the_machine_and_ends_it_with_5() {
    let shop = Shop::new(&machine(&[]));
    let mut check = shop.command(&["--speed", "real"]).spawn().unwrap();
    let mut lines = BufReader::new(check.stdout.take().unwrap()).lines().map(Result::unwrap);
    // The next axis is on its way, a second there and a second back.
    assert!(lines.any(|line| line.starts_with("axes    ok")), "no axis was looked at");
    let kill = format!("kill -INT {}", check.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    let rest: Vec<String> = lines.collect();
    assert_eq!(check.wait().unwrap().code(), Some(5), "{rest:#?}");
    assert!(rest.iter().any(|line| line.ends_with("stopped by a person")), "{rest:#?}");
    assert!(!rest.iter().any(|line| line.contains("FAILED")), "a stop is no mistake: {rest:#?}");
}
