//! A machine file with a section `[serve]`, a journal, and the program.

#[path = "../support/served.rs"]
mod served;

use std::process::{Command, Output};

use serde_json::Value;

pub use served::Served as Daemon;

pub const MODBUS: &str = "[serve.modbus]\nlisten = \"127.0.0.1:0\"\nallow = [\"127.0.0.1\"]\n";

pub struct Shop {
    folder: tempfile::TempDir,
    /// For every program that it starts.
    pub envs: Vec<(String, String)>,
}

impl Shop {
    /// The built-in machine; `trigger`: the rest of `[serve]`.
    pub fn new(trigger: &str) -> Self {
        let shop = Self { folder: tempfile::tempdir().unwrap(), envs: Vec::new() };
        let machine = include_str!("../../config/simulated.toml");
        let machine = machine.split("\n[serve]").next().unwrap();
        let rest = "[method.self-calibration]\nmonte_carlo_trials = 1000\n\
                    [tolerance]\nEX0C_um = 500.0\nEY0C_um = 500.0\n\
                    [serve]\nmin_interval_s = 0.0\n\
                    [[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n";
        std::fs::write(shop.machine(), format!("{machine}\n{rest}{trigger}")).unwrap();
        shop
    }

    /// In the machine file.
    pub fn change(&self, from: &str, to: &str) {
        let text = std::fs::read_to_string(self.machine()).unwrap();
        assert!(text.contains(from), "{from}");
        std::fs::write(self.machine(), text.replace(from, to)).unwrap();
    }

    pub fn machine(&self) -> String {
        self.folder.path().join("machine.toml").display().to_string()
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).arg("--state").arg(self.folder.path().join("state"));
        command.envs(self.envs.clone());
        command
    }

    pub fn trued(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    pub fn json(&self, arguments: &[&str]) -> Value {
        let output = self.trued(arguments);
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{told}"))
    }

    /// Of each run, oldest first.
    pub fn states(&self) -> Vec<String> {
        let runs = self.json(&["runs", "--json"]);
        let state = |run: &Value| run["state"].as_str().unwrap().to_owned();
        runs.as_array().unwrap().iter().map(state).collect()
    }

    /// Until it is ready. `speed`: of the simulated machine.
    pub fn serve(&self, speed: &str) -> Daemon {
        self.serve_with(&["--speed", speed])
    }

    pub fn file(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    pub fn serve_with(&self, more: &[&str]) -> Daemon {
        let machine = self.machine();
        self.serve_as(&[&["--machine", &machine], more].concat())
    }

    /// Whatever it serves.
    pub fn serve_as(&self, arguments: &[&str]) -> Daemon {
        Daemon::start(self.command(&["serve"]).args(arguments))
    }
}

/// Nothing serves that everybody could start, or that nobody enables.
pub fn bad_sections() {
    let cases = [
        ("127.0.0.1:0", "0.0.0.0:1502", "any_interface"),
        ("allow = [\"127.0.0.1\"]", "allow = []", "modbus.allow is empty"),
        ("min_interval_s = 0.0", "demand = [\"auto\"]", "demand must contain `enable`"),
        ("number = 1", "number = 9", "cycle number 9"),
        ("\"self-calibration\"\n[serve.", "\"sorcery\"\n[serve.", "no method `sorcery`"),
        ("allow = ", "alow = ", "allow"),
        (MODBUS, "", "nothing could start a cycle"),
        (MODBUS, "[serve.http]\nlisten = \"0.0.0.0:0\"\n", "others can reach"),
        (
            MODBUS,
            "[serve.http]\nlisten = \"127.0.0.1:0\"\nnames = [\"a.example\"]\n",
            "tokens = true",
        ),
        // What the cycle itself is refused for is told now, not at the first start.
        ("trials = 1000", "trials = 1000\npositions = 2", "cycle 1 cannot be measured"),
        ("centre_mm = [0.0, 0.0, 0.0]", "centre_mm = [0.0, 0.0, 900.0]", "cycle 1 cannot be"),
    ];
    for (from, to, words) in cases {
        let shop = Shop::new(MODBUS);
        shop.change(from, to);
        let output = shop.trued(&["serve", "--machine", &shop.machine()]);
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{to}: {told}");
        assert!(told.contains(words), "{words} in {told}");
    }
}
