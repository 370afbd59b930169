//! Compensation files of LinuxCNC: the new values count only after a restart.

use std::path::Path;

use super::shop::{CompensationShop, INI_TEXT, PIN_LINES, store_run_with};
use crate::support::machine_shop::stderr;
use machine::record::event::RunEvent;
use trued::compensation::describe_values_of_control;
use trued::setup::MachineFile;
use trued::store::{CompensationState, Journal, RunId};

/// For X the corrections, for Z the actual positions.
const X_TABLE: &str = "-300.0 0.030 0.0200\n0 0 0\n300.0 -0.030 -0.0400\n";
const Z_TABLE: &str = "-300 -300 -300\n300 300 300\n";
/// X is 100 µm/m too long, Z 50 µm/m too short, each measured with the tables above.
const SCALES: [(&str, &str, f64); 2] = [("EXX1", "um/m", 100.0), ("EZZ1", "um/m", -50.0)];
const NEW_X_TABLE: &str = "-300.0 0.06 0.05\n0 0 0\n300.0 -0.06 -0.07\n";
const NEW_Z_TABLE: &str = "-300 -299.985 -299.985\n300 299.985 299.985\n";

fn table_shop() -> CompensationShop {
    let shop = CompensationShop::new();
    let folder = shop.shop.path_text("");
    shop.append_to_machine_file(&format!("[compensation.linuxcnc-joints]\nhalcmd = [\"{folder}halcmd\"]\n"));
    let with_file = |text: String, joint: usize, lines: &str| {
        text.replacen(&format!("[JOINT_{joint}]\n"), &format!("[JOINT_{joint}]\n{lines}"), 1)
    };
    let ini = with_file(INI_TEXT.to_owned(), 0, "COMP_FILE = x.comp\nCOMP_FILE_TYPE = 1\n");
    let ini = with_file(ini, 2, "COMP_FILE = z.comp\nCOMP_FILE_TYPE = 0\n");
    std::fs::write(shop.shop.path("rig.ini"), ini).unwrap();
    write_tables(&shop, X_TABLE, Z_TABLE);
    let file = MachineFile::read(Path::new(&shop.shop.machine_path())).unwrap();
    store_run_with(&shop.shop.state_folder(), &file, "samba", &SCALES);
    // As a run records it.
    let journal = Journal::open(&shop.shop.state_folder()).unwrap();
    for text in describe_values_of_control(&file, &[]) {
        journal.add_event(RunId(2), &RunEvent::Announced { text }).wait().unwrap();
    }
    shop
}

fn write_tables(shop: &CompensationShop, x: &str, z: &str) {
    std::fs::write(shop.shop.path("x.comp"), x).unwrap();
    std::fs::write(shop.shop.path("z.comp"), z).unwrap();
}

fn tables(shop: &CompensationShop) -> [String; 2] {
    ["x.comp", "z.comp"].map(|name| std::fs::read_to_string(shop.shop.path(name)).unwrap())
}

/// X and Z stand at `position`; LinuxCNC corrects them by these amounts.
fn set_corrections(shop: &CompensationShop, position: f64, x: f64, z: f64) {
    let pins = [("0", x), ("2", z)].map(|(joint, correction)| {
        format!(
            "10 float OUT {position} joint.{joint}.pos-cmd\n10 float OUT {correction} joint.{joint}.backlash-corr\n"
        )
    });
    std::fs::write(shop.shop.path("pins"), format!("{PIN_LINES}{}", pins.concat())).unwrap();
}

fn state(shop: &CompensationShop) -> CompensationState {
    let journal = Journal::open(&shop.shop.state_folder()).unwrap();
    journal.last_compensation("linuxcnc-sim5", "linuxcnc-joints").unwrap().unwrap().state
}

pub fn corrections_of_travel_are_written_confirmed_and_restored() {
    let shop = table_shop();
    let compensate = |arguments: &[&str]| shop.compensate(&[arguments, &["--target", "linuxcnc-joints"]].concat());
    shop.assert_refused(&shop.compensate(&["propose", "2"]), "several sections of [compensation]");
    let text = String::from_utf8(compensate(&["propose", "2"]).stdout).unwrap();
    for part in ["X from −300 to 300", "x.comp 300.0 forward", "z.comp 300 reverse"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let hash = text.lines().find_map(|line| line.strip_prefix("SHA-256 of the proposal: ")).unwrap();
    let written = compensate(&["write", "2", "--approve", hash, "--who", "Ada"]);
    assert!(written.status.success(), "{}", stderr(&written));
    assert!(String::from_utf8_lossy(&written.stdout).contains("restart LinuxCNC"), "{written:?}");
    assert_eq!(tables(&shop), [NEW_X_TABLE, NEW_Z_TABLE]);
    assert_eq!(state(&shop), CompensationState::AwaitingRestart);
    // LinuxCNC still uses the old tables: a run would measure the same error again.
    let check = shop.shop.run_trued(&["check", "--machine", &shop.shop.machine_path()]);
    assert!(stderr(&check).contains("only after a restart"), "{}", stderr(&check));
    shop.assert_refused(
        &compensate(&["write", "2", "--approve", hash, "--who", "Ada"]),
        "a correction could be made twice",
    );
    let finish = || compensate(&["finish", "--who", "Ada"]);
    set_corrections(&shop, 300.0, -0.03, 0.0);
    shop.assert_refused(&finish(), "corrects X at 300 mm by -0.03 mm, not by -0.06 mm");
    set_corrections(&shop, 0.0, 0.0, 0.0);
    shop.assert_refused(&finish(), "does not show whether it uses the new file");
    set_corrections(&shop, 150.0, -0.035, 0.0075);
    assert!(finish().status.success(), "{}", stderr(&finish()));
    assert_eq!(state(&shop), CompensationState::Written);
    // The readings of this run contain the effect of the old tables only.
    shop.assert_refused(&compensate(&["propose", "2"]), "a correction could be made twice");
    let undone = compensate(&["undo", "--who", "Ada"]);
    assert!(undone.status.success(), "{}", stderr(&undone));
    assert_eq!(tables(&shop), [X_TABLE, Z_TABLE], "byte for byte");
    assert_eq!(state(&shop), CompensationState::UndoneAwaitingRestart);
    shop.assert_refused(&finish(), "corrects X at 150 mm");
    set_corrections(&shop, -150.0, 0.01, 0.0);
    assert!(finish().status.success(), "{}", stderr(&finish()));
    assert_eq!(state(&shop), CompensationState::Undone);
}
