//! A machine shop with a control and a run, and a substitute for `halcmd` that keeps pins in a file, refuses, falsifies
//! a read-back, or kills the program at a given call.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use crate::support::machine_shop::{MachineShop, stderr};
pub use crate::support::stored_run::{store_run, store_run_with};
use serde_json::Value;
use trued::setup::MachineFile;
use trued::store::{CompensationState, Journal};

pub const MACHINE_TEXT: &str = include_str!("../../../config/linuxcnc-sim.toml");
pub const INI_TEXT: &str = include_str!("../../peers/linuxcnc/rig.ini");
/// Prints the pins as `halcmd -s show pin PREFIX` of LinuxCNC 2.9 does, and sets them as `setp`. At the call whose
/// number is in the file `kill-at` it kills the program: before it acts, or after it if the number ends with a plus
/// sign.
pub const HALCMD_TEXT: &str = r#"#!/bin/sh
cd "$(dirname "$0")" || exit 1
count=$(($(cat calls 2>/dev/null || echo 0) + 1)); echo $count > calls
kill_at=$(cat kill-at 2>/dev/null)
if [ "$kill_at" = "$count" ]; then kill -9 $PPID; exit 1; fi
if [ "$1" = setp ]; then
    if [ "$2" = "$(cat refused 2>/dev/null)" ]; then echo "pin '$2' is refused" >&2; exit 1; fi
    value=$3
    [ -e falsified ] && value=$(awk "BEGIN { print $3 + 0.0001 }")
    [ -e intruder ] && sed -i 's/ 0.02 / 7.0 /' pins
    awk -v name="$2" -v value="$value" '$5 == name { $4 = value } { print }' pins > new && mv new pins
else
    grep " $4" pins
fi
[ "$kill_at" = "$count+" ] && kill -9 $PPID
exit 0
"#;
pub const PIN_LINES: &str = "10 float IN 0.0123 xyzbc-trt-kins.x-rot-point
10 float IN 0.02 xyzbc-trt-kins.y-rot-point
10 float IN -3.5 xyzbc-trt-kins.z-rot-point
10 float IN 0.25 xyzbc-trt-kins.x-offset
10 float IN 3.5 xyzbc-trt-kins.z-offset
10 float IN 0 motion.switchkins-type
10 bit OUT TRUE motion.in-position
";
/// x-rot-point, y-rot-point and x-offset after the correction: C is where it was measured, B where it was.
pub const CORRECTED: [(&str, f64); 3] = [("x-rot-point", 0.05), ("y-rot-point", -0.03), ("x-offset", 0.2123)];
/// Calls of `halcmd` by one `write`: one reads the values, two the state of the machine and the signals of the pins;
/// then for each value one reads all values, two the state, one sets it and one reads it back.
pub const CALLS_OF_WRITE: usize = 3 + 5 * CORRECTED.len();

/// A machine file, a control and a journal with one run of a self-calibration.
pub struct CompensationShop {
    pub shop: MachineShop,
}

impl CompensationShop {
    pub fn new() -> Self {
        let shop = MachineShop::with_machine_file("");
        let folder = shop.path_text("");
        let ini = format!("ini = \"{folder}rig.ini\"");
        let mut text = MACHINE_TEXT.to_owned();
        for (from, to) in [
            ("# ini = \"/home/cnc/linuxcnc/configs/mine/mine.ini\"", &*ini),
            ("/tmp/trued-linuxcnc", folder.trim_end_matches('/')),
        ] {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
        shop.replace_machine_file(&format!(
            "{text}\n[compensation.linuxcnc-trunnion]\nhalcmd = [\"{folder}halcmd\"]\n"
        ));
        std::fs::write(shop.path("rig.ini"), INI_TEXT).unwrap();
        std::fs::write(shop.path("halcmd"), HALCMD_TEXT).unwrap();
        std::fs::set_permissions(shop.path("halcmd"), Permissions::from_mode(0o755)).unwrap();
        std::fs::write(shop.path("pins"), PIN_LINES).unwrap();
        store_run(&shop.state_folder(), &MachineFile::read(Path::new(&shop.machine_path())).unwrap());
        Self { shop }
    }

    pub fn append_to_machine_file(&self, text: &str) {
        let machine_text = std::fs::read_to_string(self.shop.machine_path()).unwrap();
        self.shop.replace_machine_file(&format!("{machine_text}{text}"));
    }

    pub fn compensate(&self, arguments: &[&str]) -> std::process::Output {
        self.shop.run_trued(&[&["compensate"], arguments, &["--machine", &self.shop.machine_path()]].concat())
    }

    pub fn proposal(&self) -> Value {
        let output = self.compensate(&["propose", "1", "--json"]);
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", stderr(&output)))
    }

    pub fn hash(&self) -> String {
        let output = self.compensate(&["propose", "1"]);
        let text = String::from_utf8(output.stdout.clone()).unwrap();
        let hash = text.lines().find_map(|line| line.strip_prefix("SHA-256 of the proposal: "));
        hash.unwrap_or_else(|| panic!("{text}{}", stderr(&output))).to_owned()
    }

    pub fn write(&self, hash: &str) -> std::process::Output {
        self.compensate(&["write", "1", "--approve", hash, "--who", "Ada"])
    }

    pub fn pin(&self, name: &str) -> f64 {
        let text = std::fs::read_to_string(self.shop.path("pins")).unwrap();
        let end = format!("xyzbc-trt-kins.{name}");
        let line = text.lines().find(|line| line.ends_with(&end)).unwrap();
        line.split(' ').nth(3).unwrap().parse().unwrap()
    }

    pub fn are_pins(&self, expected: impl Fn(&(&str, f64)) -> bool) -> bool {
        self.pin("z-rot-point") == -3.5 && self.pin("z-offset") == 3.5 && CORRECTED.iter().all(expected)
    }

    pub fn is_corrected(&self) -> bool {
        self.are_pins(|(name, mm)| self.pin(name) == *mm)
    }

    pub fn is_as_before(&self) -> bool {
        std::fs::read_to_string(self.shop.path("pins")).unwrap() == PIN_LINES
    }

    pub fn replace_pins(&self, from: &str, to: &str) {
        let text = std::fs::read_to_string(self.shop.path("pins")).unwrap();
        assert!(text.contains(from), "{from}");
        std::fs::write(self.shop.path("pins"), text.replace(from, to)).unwrap();
    }

    pub fn state(&self) -> Option<CompensationState> {
        let journal = Journal::open(&self.shop.state_folder()).unwrap();
        journal.compensations("linuxcnc-sim5").unwrap().first().map(|newest| newest.state)
    }

    pub fn assert_refused(&self, output: &std::process::Output, expected: &str) {
        let text = stderr(output);
        assert!(output.status.code() != Some(0) && text.contains(expected), "{text}");
    }
}
