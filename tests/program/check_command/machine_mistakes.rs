//! The table of planted mistakes: a name, how the mistake is planted, and words that name only this mistake.

use trued::commissioning::CheckSummary;
use trued::setup::SimulationPace;

use super::simulated_machine_checks::{
    changed_machine_toml, check_against_other_machine, machine_toml_with_simulated_lines, run_check,
    toml_with_control_keys,
};

pub struct PlantedMistake {
    pub name: &'static str,
    pub run_check: fn() -> CheckSummary,
    pub expected_phrase: &'static str,
}

const fn mistake(name: &'static str, check: fn() -> CheckSummary, phrase: &'static str) -> PlantedMistake {
    PlantedMistake { name, run_check: check, expected_phrase: phrase }
}

fn check_with_simulated_wiring(lines: &str) -> CheckSummary {
    run_check(&machine_toml_with_simulated_lines(&format!("[simulated.wiring]\n{lines}\n")))
}

/// Checks with this true offset of the part.
fn check_with_part_offset(offset_mm: &str) -> CheckSummary {
    let offset = format!("centre_offset_mm = {offset_mm}");
    run_check(&changed_machine_toml(&[("centre_offset_mm = [0.8, -0.5]", &offset)]))
}

fn check_with_fault(lines: &str) -> CheckSummary {
    run_check(&machine_toml_with_simulated_lines(&format!("[[simulated.fault]]\n{lines}\n")))
}

fn check_modbus_with_fault(lines: &str) -> CheckSummary {
    let text = machine_toml_with_simulated_lines(&format!("[[simulated.fault]]\n{lines}\n"));
    run_check(&toml_with_control_keys("speaks = \"modbus\"", &text))
}

fn with_grbl_dialect(keys: String) -> String {
    keys + "\ndialect = \"grbl-m19\""
}

/// Checks a machine file with these changes, which contradict a correct control.
fn check_with_wrong_declaration(changes: &[(&str, &str)]) -> CheckSummary {
    let truth = toml_with_control_keys("wire = \"pty\"", &changed_machine_toml(&[]));
    check_against_other_machine(&changed_machine_toml(changes), &truth, SimulationPace::Immediate, with_grbl_dialect)
}

/// A body beside the stylus at the start position of the machine, which is at the top of Z; replaces `[artefact]`.
const KEEPOUT_BESIDE_STYLUS: &str = "[[keepout]]\nname = \"tool setter\"\nmin_mm = [5.5, -20.0, 320.0]\n\
                       max_mm = [50.0, 20.0, 340.0]\n\n[artefact]";

pub const MACHINE_MISTAKES: &[PlantedMistake] = &[
    mistake("X and Y swapped", || check_with_simulated_wiring("swapped = [[\"X\", \"Y\"]]"), "X and Y are swapped"),
    mistake("X and C swapped", || check_with_simulated_wiring("swapped = [[\"C\", \"X\"]]"), "X and C are swapped"),
    mistake("X the wrong way round", || check_with_simulated_wiring("reversed = [\"X\"]"), "the sense of X is wrong"),
    mistake("Z the wrong way round", || check_with_simulated_wiring("reversed = [\"Z\"]"), "the sense of Z is wrong"),
    mistake(
        "C the wrong way round",
        || check_with_simulated_wiring("reversed = [\"C\"]"),
        "write positive = \"reversed\" in [axes.C]",
    ),
    mistake(
        "C said to be reversed",
        || {
            run_check(
                &(changed_machine_toml(&[("[axes.C]\npositive = \"iso\"", "[axes.C]\npositive = \"reversed\"")])
                    + "\n[simulated.wiring]\nreversed = [\"C\"]\n"),
            )
        },
        "write positive = \"iso\" in [axes.C]",
    ),
    mistake(
        "X in inches",
        || check_with_simulated_wiring("gain = { X = 25.4 }"),
        "the gain of X is 25.400: is the control set to \
        inches",
    ),
    mistake("Y half as far", || check_with_simulated_wiring("gain = { Y = 0.5 }"), "the gain of Y is 0.500"),
    mistake("B ten times as far", || check_with_simulated_wiring("gain = { B = 10.0 }"), "the gain of B is 10.000"),
    mistake("Z unplugged", || check_with_simulated_wiring("gain = { Z = 0.0 }"), "the operator saw no motion"),
    mistake("probe inverted", || check_with_simulated_wiring("probe = \"inverted\""), "the input is inverted"),
    mistake("probe dead", || check_with_simulated_wiring("probe = \"dead\""), "the probe does not work"),
    mistake(
        "probe stuck",
        || check_with_simulated_wiring("probe = \"stuck\""),
        "stays closed with the stylus free and deflected",
    ),
    mistake(
        "an axis too many",
        || {
            let three = [
                ("V[w-C-B-b-Y-X-Z-(C)-t]", "V[w-C-b-Y-X-Z-(C)-t]"),
                ("[axes.B]", "[axes.S]"),
                ("[axes.S]\nmin = -360.0\nmax = 360.0\nrapid_per_min = 36000.0\nacceleration_per_s2 = 1000.0", ""),
                ("on = \"B\"", "on = \"bed\""),
            ];
            let truth = toml_with_control_keys("wire = \"pty\"", &changed_machine_toml(&three));
            check_against_other_machine(
                &changed_machine_toml(&[]),
                &truth,
                SimulationPace::Immediate,
                with_grbl_dialect,
            )
        },
        "but not B",
    ),
    mistake(
        "faster than the control",
        || check_with_wrong_declaration(&[("rapid_per_min = 20000.0", "rapid_per_min = 40000.0")]),
        "the rapid speed of X exceeds the value of the control",
    ),
    mistake(
        "brisker than the control",
        || check_with_wrong_declaration(&[("acceleration_per_s2 = 2000.0", "acceleration_per_s2 = 4000.0")]),
        "the acceleration of X exceeds the value of the control",
    ),
    mistake(
        "not where the file has the axis",
        || check_with_wrong_declaration(&[("min = -50.0\nmax = 450.0", "min = -50.0\nmax = 400.0")]),
        "Z is at 450.000, outside its travel",
    ),
    mistake(
        "a fixture beside the stylus",
        || run_check(&changed_machine_toml(&[("[artefact]", KEEPOUT_BESIDE_STYLUS)])),
        "X +1 mm: the collision check refuses the jog",
    ),
    mistake(
        "the hold register elsewhere",
        || {
            let truth = toml_with_control_keys("speaks = \"modbus\"", &changed_machine_toml(&[]));
            let hold = "\ndialect = \"grbl-m19\"\nregisters.command = { hold = { address = 105 }, \
                        chunk = { address = 6, registers = 99 } }";
            check_against_other_machine(&changed_machine_toml(&[]), &truth, SimulationPace::RealTime, |keys| {
                keys + hold
            })
        },
        "the hold has no effect",
    ),
    mistake(
        "in alarm",
        || check_with_fault("kind = \"alarm\"\nat_line = 1"),
        "unlock the control ($X) and home the machine",
    ),
    mistake("door open", || check_with_fault("kind = \"door\"\nat_line = 1"), "close the door"),
    mistake("feed hold pressed", || check_with_fault("kind = \"hold\"\nat_line = 1"), "a move is held"),
    mistake("not made ready", || check_modbus_with_fault("kind = \"reset\""), "make the control ready"),
    mistake("emergency stop", || check_modbus_with_fault("kind = \"e-stop\""), "alarm 10: emergency stop"),
    mistake("a latch in the PLC", || check_modbus_with_fault("kind = \"slow-latch\""), "a program scan of about"),
    mistake(
        "a latch in a PLC beside the control",
        || run_check(&machine_toml_with_simulated_lines("[simulated.latch]\ndelay_ms = 1.0\nscan_ms = 10.0\n")),
        "a program scan of about",
    ),
    mistake(
        "touches that scatter more than declared",
        || {
            let scatters = changed_machine_toml(&[("repeatability_um = 0.5", "repeatability_um = 3.0")]);
            let truth = toml_with_control_keys("wire = \"pty\"", &scatters);
            check_against_other_machine(
                &changed_machine_toml(&[]),
                &truth,
                SimulationPace::Immediate,
                with_grbl_dialect,
            )
        },
        "repeatability_um in [probe] and the display resolution explain",
    ),
    mistake(
        "no part",
        || check_with_part_offset("[-20.0, 0.0]"),
        "the part is not at the position in the machine file",
    ),
    mistake("a part too near", || check_with_part_offset("[3.5, 0.0]"), "unexpected contact during a positioning move"),
    mistake(
        "two feeds that are one",
        || run_check(&changed_machine_toml(&[("search_feed_mm_min = 300.0", "search_feed_mm_min = 40.0")])),
        "the fast feed of 40 mm/min is not allowed",
    ),
    mistake(
        "a part that may stand anywhere",
        || run_check(&changed_machine_toml(&[("uncertainty_mm = 2.0", "uncertainty_mm = 3.0")])),
        "more than the overtravel of 6 mm",
    ),
];
