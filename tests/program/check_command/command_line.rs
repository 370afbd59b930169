//! `trued check` on the command line.

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Output, Stdio};
use std::sync::{Arc, Mutex};

use simulator::controls::grbl::{Firmware, SimulatedGrblOptions};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpListener;
use trued::setup::{MachineFile, SimulatedMachine, SimulationPace};

use super::simulated_machine_checks::{changed_machine_toml, machine_toml_with_simulated_lines, runtime};

struct CheckWorkspace(TempDir);

impl CheckWorkspace {
    fn with_machine_file(machine_text: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("machine.toml"), machine_text).unwrap();
        Self(folder)
    }

    fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.arg("--state").arg(self.0.path().join("state")).arg("check");
        command.args(words).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Checks the machine file.
    fn check(&self, words: &[&str]) -> Output {
        let file = self.0.path().join("machine.toml");
        let file = file.to_string_lossy();
        self.command(&[&["--machine", file.as_ref()], words].concat()).output().unwrap()
    }
}

fn utf8_text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

pub fn without_a_machine_file_the_simulated_machine_is_checked() {
    let shop = CheckWorkspace::with_machine_file("");
    let output = shop.command(&[]).output().unwrap();
    let said = utf8_text(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{said}{}", utf8_text(&output.stderr));
    assert!(said.contains("Summary for a support request:\n\ntrued "), "{said}");
    assert!(said.contains("check of `simulated five-axis machine`\ncontrol: Grbl 1.1f"), "{said}");
}

pub fn a_mistake_exits_with_1_and_is_in_the_json_output() {
    let shop = CheckWorkspace::with_machine_file(&machine_toml_with_simulated_lines(
        "[simulated.wiring]\nprobe = \"inverted\"\n",
    ));
    let output = shop.check(&["--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", utf8_text(&output.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["machine"], "simulated five-axis machine");
    let findings = summary["findings"].as_array().unwrap();
    let failed: Vec<_> = findings.iter().filter(|found| found["verdict"] == "failed").collect();
    assert_eq!(failed.len(), 1, "{summary:#}");
    assert_eq!(failed[0]["part"], "probe");
    assert!(failed[0]["remedy"].is_string(), "{summary:#}");
}

pub fn real_control_without_terminal_neither_moves_nor_hangs() {
    let truth = MachineFile::parse("truth.toml", changed_machine_toml(&[])).unwrap();
    let runtime = runtime();
    let served =
        runtime.block_on(async { SimulatedMachine::new(&truth)?.serve_control(SimulationPace::Immediate) }).unwrap();
    let keys = format!("{}\ndialect = \"grbl-m19\"\n", served.controller_toml());
    let shop = CheckWorkspace::with_machine_file(&changed_machine_toml(&[
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
        let said = utf8_text(&output.stdout);
        assert_eq!(output.status.code(), Some(0), "{said}{}", utf8_text(&output.stderr));
        assert!(utf8_text(&output.stderr).contains("standard input is not a terminal"));
        assert!(
            said.contains(
                "axes    not checked    the probe input was not tested, because no operator is \
                present"
            ),
            "{said}"
        );
        assert!(!said.contains("axes    ok"), "{said}");
    });
}

pub fn a_control_that_refuses_its_settings_is_a_failure() {
    // `$$` is refused only at the identification, or always.
    for refusals in [1, usize::MAX] {
        let runtime = runtime();
        let (address, control) = runtime.block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            (listener.local_addr().unwrap(), serve_control_refusing_settings(listener, refusals))
        });
        let keys = format!("kind = \"grbl\"\ntcp = \"{address}\"\ndialect = \"grbl-m19\"\n");
        let shop = CheckWorkspace::with_machine_file(&changed_machine_toml(&[
            ("kind = \"simulated\"\n", keys.as_str()),
            ("wire = \"memory\"\n", ""),
        ]));
        let output = std::thread::scope(|scope| {
            let checked = scope.spawn(|| shop.check(&[]));
            runtime.block_on(control);
            checked.join().unwrap()
        });
        let said = utf8_text(&output.stdout);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("1 failed"), "{said}");
        let failed = said.lines().find(|line| line.contains("FAILED")).unwrap();
        assert!(failed.contains("replied `error:3` to `$$`"), "{said}");
    }
}

/// The simulated control; it rejects the first `refusals` requests of `$$`.
async fn serve_control_refusing_settings(listener: TcpListener, mut refusals: usize) {
    let file = MachineFile::parse("truth.toml", changed_machine_toml(&[])).unwrap();
    let world = Arc::new(Mutex::new(trued::setup::build_world(&file).unwrap()));
    let mut firmware =
        Firmware::new(world, SimulatedGrblOptions::for_machine(&file.machine, SimulationPace::Immediate));
    let (stream, _) = listener.accept().await.unwrap();
    let ((mut asked, mut told), (near, far)) = (stream.into_split(), tokio::io::duplex(4096));
    let (mut says, mut hears) = tokio::io::split(near);
    let (reply, mut replies) = tokio::sync::mpsc::unbounded_channel();
    let requests = async move {
        let mut line = Vec::new();
        while let Ok(byte) = asked.read_u8().await {
            line.push(byte);
            if line == b"$$\n" && refusals > 0 {
                refusals -= 1;
                reply.send(b"error:3\r\n").unwrap();
                line.clear();
            } else if !line.starts_with(b"$") || byte == b'\n' {
                hears.write_all(&std::mem::take(&mut line)).await.unwrap();
            }
        }
        hears.shutdown().await.unwrap();
    };
    let answers = async move {
        let mut buffer = [0; 1024];
        loop {
            tokio::select! {
                Some(reply) = replies.recv() => told.write_all(reply).await.unwrap(),
                count = says.read(&mut buffer) => match count.unwrap() {
                    0 => return,
                    count => drop(told.write_all(&buffer[..count]).await),
                },
            }
        }
    };
    let (served, (), ()) = tokio::join!(firmware.serve(far), requests, answers);
    served.unwrap();
}

pub fn ctrl_c_holds_the_machine_and_exits_with_5() {
    let shop = CheckWorkspace::with_machine_file(&changed_machine_toml(&[]));
    let mut check = shop.command(&["--speed", "real"]).spawn().unwrap();
    let mut lines = BufReader::new(check.stdout.take().unwrap()).lines().map(Result::unwrap);
    // The next axis is moving, a second there and a second back.
    assert!(lines.any(|line| line.starts_with("axes    ok")), "no axis was looked at");
    std::thread::sleep(std::time::Duration::from_millis(600));
    let kill = format!("kill -INT {}", check.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    let rest: Vec<String> = lines.collect();
    assert_eq!(check.wait().unwrap().code(), Some(5), "{rest:#?}");
    assert!(rest.iter().any(|line| line.contains("stopped by the operator")), "{rest:#?}");
    assert!(rest.iter().any(|line| line.contains("the control is held: reset the control")), "{rest:#?}");
    assert!(!rest.iter().any(|line| line.contains("FAILED")), "a stop is no mistake: {rest:#?}");
}
