//! Compensation files of LinuxCNC: the new values count only after a restart.

use std::path::Path;

use super::shop::{CompensationShop, INI_TEXT, PIN_LINES, store_run_with};
use crate::support::machine_shop::stderr;
use machine::record::event::RunEvent;
use trued::compensation::describe_compensation_values;
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
    record_values(&shop, &file, RunId(2));
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
    journal.compensations("linuxcnc-sim5").unwrap()[0].state
}

/// The second file cannot be replaced: the first one is new as a whole.
pub fn interrupted_write_leaves_whole_files() {
    let shop = table_shop();
    let compensate = |arguments: &[&str]| shop.compensate(&[arguments, &["--target", "linuxcnc-joints"]].concat());
    let text = String::from_utf8(compensate(&["propose", "2"]).stdout).unwrap();
    let hash = text.lines().find_map(|line| line.strip_prefix("SHA-256 of the proposal: ")).unwrap();
    // Where the new file would be written.
    let obstacle = shop.shop.path(".z.comp.trued");
    std::fs::create_dir(&obstacle).unwrap();
    shop.assert_refused(&compensate(&["write", "2", "--approve", hash, "--who", "Ada"]), "cannot be read or written");
    assert_eq!(tables(&shop), [NEW_X_TABLE, Z_TABLE]);
    assert_eq!(state(&shop), CompensationState::Writing);
    shop.assert_refused(&compensate(&["write", "2", "--approve", hash, "--who", "Ada"]), "could be corrected twice");
    std::fs::remove_dir(&obstacle).unwrap();
    assert!(compensate(&["undo", "--who", "Ada"]).status.success());
    assert_eq!(tables(&shop), [X_TABLE, Z_TABLE]);
    set_corrections(&shop, 300.0, -0.03, 0.0);
    assert!(compensate(&["finish", "--who", "Ada"]).status.success());
}

/// A link stays a link; equal names in two folders are two files; a table must cover the travel.
pub fn files_of_the_control_are_found_and_kept() {
    let shop = table_shop();
    let compensate = |arguments: &[&str]| shop.compensate(&[arguments, &["--target", "linuxcnc-joints"]].concat());
    std::fs::create_dir(shop.shop.path("z")).unwrap();
    std::fs::rename(shop.shop.path("z.comp"), shop.shop.path("z/x.comp")).unwrap();
    std::fs::rename(shop.shop.path("x.comp"), shop.shop.path("real")).unwrap();
    std::os::unix::fs::symlink("real", shop.shop.path("x.comp")).unwrap();
    let ini = std::fs::read_to_string(shop.shop.path("rig.ini")).unwrap();
    std::fs::write(shop.shop.path("rig.ini"), ini.replace("z.comp", "z/x.comp")).unwrap();
    let file = MachineFile::read(Path::new(&shop.shop.machine_path())).unwrap();
    store_run_with(&shop.shop.state_folder(), &file, "samba", &SCALES);
    record_values(&shop, &file, RunId(3));
    let text = String::from_utf8(compensate(&["propose", "3"]).stdout).unwrap();
    let hash = text.lines().find_map(|line| line.strip_prefix("SHA-256 of the proposal: ")).unwrap();
    assert!(compensate(&["write", "3", "--approve", hash, "--who", "Ada"]).status.success(), "{text}");
    assert!(shop.shop.path("x.comp").is_symlink());
    assert_eq!(std::fs::read_to_string(shop.shop.path("real")).unwrap(), NEW_X_TABLE);
    assert_eq!(std::fs::read_to_string(shop.shop.path("z/x.comp")).unwrap(), NEW_Z_TABLE);
    std::fs::write(shop.shop.path("real"), "-10 0 0\n10 0 0\n").unwrap();
    shop.assert_refused(&compensate(&["status"]), "covers -10 to 10 mm, not the travel -300 to 300 mm");
}

/// As a run records it, with LinuxCNC at X = Z = 0.
fn record_values(shop: &CompensationShop, file: &MachineFile, run: RunId) {
    set_corrections(shop, 0.0, 0.0, 0.0);
    let journal = Journal::open(&shop.shop.state_folder()).unwrap();
    for text in describe_compensation_values(file, &[]) {
        journal.add_event(run, &RunEvent::OperatorMessage { text }).wait().unwrap();
    }
}

/// LinuxCNC does not use the file: the readings of this run contain another correction.
pub fn run_with_a_file_that_is_not_in_effect_gives_no_proposal() {
    let shop = table_shop();
    let file = MachineFile::read(Path::new(&shop.shop.machine_path())).unwrap();
    set_corrections(&shop, 290.0, -0.05, 0.0);
    let lines = describe_compensation_values(&file, &[]);
    assert!(lines.iter().any(|line| line.contains("LinuxCNC corrects X at 290 mm by -0.05 mm")), "{lines:?}");
    store_run_with(&shop.shop.state_folder(), &file, "samba", &SCALES);
    let journal = Journal::open(&shop.shop.state_folder()).unwrap();
    for text in lines {
        journal.add_event(RunId(3), &RunEvent::OperatorMessage { text }).wait().unwrap();
    }
    drop(journal);
    let refused = shop.compensate(&["propose", "3", "--target", "linuxcnc-joints"]);
    shop.assert_refused(&refused, "an error could be corrected twice");
    // Positions measured with other tables are not those of the control either.
    let refused = shop.compensate(&["propose", "1", "--target", "linuxcnc-trunnion"]);
    shop.assert_refused(&refused, "(linuxcnc-joints) during the run: the readings contain the effect of these values");
}

pub fn corrections_of_travel_are_written_confirmed_and_restored() {
    let shop = table_shop();
    let compensate = |arguments: &[&str]| shop.compensate(&[arguments, &["--target", "linuxcnc-joints"]].concat());
    shop.assert_refused(&shop.compensate(&["propose", "2"]), "several sections of [compensation]");
    let text = String::from_utf8(compensate(&["propose", "2"]).stdout).unwrap();
    for part in ["X from −300 to 300", "X x.comp 300.0 forward", "Z z.comp 300 reverse"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let hash = text.lines().find_map(|line| line.strip_prefix("SHA-256 of the proposal: ")).unwrap();
    let written = compensate(&["write", "2", "--approve", hash, "--who", "Ada"]);
    assert!(written.status.success(), "{}", stderr(&written));
    assert!(String::from_utf8_lossy(&written.stdout).contains("Restart LinuxCNC"), "{written:?}");
    assert_eq!(tables(&shop), [NEW_X_TABLE, NEW_Z_TABLE]);
    assert_eq!(state(&shop), CompensationState::AwaitingRestart);
    // LinuxCNC still uses the old tables: a run would measure the same error again.
    let check = shop.shop.run_trued(&["check", "--machine", &shop.shop.machine_path()]);
    assert!(stderr(&check).contains("only after a restart"), "{}", stderr(&check));
    shop.assert_refused(
        &compensate(&["write", "2", "--approve", hash, "--who", "Ada"]),
        "an error could be corrected twice",
    );
    let finish = || compensate(&["finish", "--who", "Ada"]);
    // A person has restored the old files, or entered others, and LinuxCNC uses them.
    write_tables(&shop, X_TABLE, Z_TABLE);
    set_corrections(&shop, 300.0, -0.03, 0.0);
    shop.assert_refused(&finish(), "X x.comp -300.0 forward is 0.03 mm, not 0.06 mm as written");
    write_tables(&shop, &NEW_X_TABLE.replace("-0.06", "-0.9"), NEW_Z_TABLE);
    set_corrections(&shop, 300.0, -0.9, 0.015);
    shop.assert_refused(&finish(), "X x.comp 300.0 forward is -0.9 mm, not -0.06 mm as written");
    write_tables(&shop, NEW_X_TABLE, NEW_Z_TABLE);
    set_corrections(&shop, 300.0, -0.03, 0.0);
    shop.assert_refused(&finish(), "corrects X at 300 mm by -0.03 mm; the file has -0.06 mm");
    set_corrections(&shop, 0.0, 0.0, 0.0);
    shop.assert_refused(&finish(), "does not show whether it uses the new file");
    set_corrections(&shop, 150.0, -0.035, 0.0075);
    assert!(finish().status.success(), "{}", stderr(&finish()));
    assert_eq!(state(&shop), CompensationState::Written);
    // The readings of this run contain the effect of the old tables only.
    shop.assert_refused(&compensate(&["propose", "2"]), "an error could be corrected twice");
    let undone = compensate(&["undo", "--who", "Ada"]);
    assert!(undone.status.success(), "{}", stderr(&undone));
    assert_eq!(tables(&shop), [X_TABLE, Z_TABLE], "byte for byte");
    assert_eq!(state(&shop), CompensationState::UndoneAwaitingRestart);
    shop.assert_refused(&finish(), "corrects X at 150 mm");
    set_corrections(&shop, -150.0, 0.01, 0.0);
    assert!(finish().status.success(), "{}", stderr(&finish()));
    assert_eq!(state(&shop), CompensationState::Undone);
}
