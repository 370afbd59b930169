//! The table of planted mistakes: a name, how the mistake is planted, and words that name only this mistake.

use trued::commissioning::Summary;
use trued::setup::Pace;

use super::bench::{against, checked, machine, with_control, with_truth};

pub struct Mistake {
    pub name: &'static str,
    pub check: fn() -> Summary,
    pub phrase: &'static str,
}

const fn row(name: &'static str, check: fn() -> Summary, phrase: &'static str) -> Mistake {
    Mistake { name, check, phrase }
}

fn wired(lines: &str) -> Summary {
    checked(&with_truth(&format!("[simulated.wiring]\n{lines}\n")))
}

/// The true offset of the part.
fn part_off(by: &str) -> Summary {
    let offset = format!("centre_offset_mm = {by}");
    checked(&machine(&[("centre_offset_mm = [0.8, -0.5]", &offset)]))
}

fn faulty(lines: &str) -> Summary {
    checked(&with_truth(&format!("[[simulated.fault]]\n{lines}\n")))
}

fn faulty_modbus(lines: &str) -> Summary {
    let text = with_truth(&format!("[[simulated.fault]]\n{lines}\n"));
    checked(&with_control("speaks = \"modbus\"", &text))
}

fn grbl(keys: String) -> String {
    keys + "\ndialect = \"grbl-m19\""
}

/// The machine file contradicts a correct control.
fn told(changes: &[(&str, &str)]) -> Summary {
    let truth = with_control("wire = \"pty\"", &machine(&[]));
    against(&machine(changes), &truth, Pace::Fast, grbl)
}

/// Start position of the machine, at the top of Z.
const KEEPOUT: &str = "[[keepout]]\nname = \"tool setter\"\nmin_mm = [5.5, -20.0, 320.0]\n\
                       max_mm = [50.0, 20.0, 340.0]\n\n[artefact]";

pub const MISTAKES: &[Mistake] = &[
    row("X and Y swapped", || wired("swapped = [[\"X\", \"Y\"]]"), "X and Y are swapped"),
    row("X and C swapped", || wired("swapped = [[\"C\", \"X\"]]"), "X and C are swapped"),
    row("X the wrong way round", || wired("reversed = [\"X\"]"), "the sense of X is wrong"),
    row("Z the wrong way round", || wired("reversed = [\"Z\"]"), "the sense of Z is wrong"),
    row("C the wrong way round", || wired("reversed = [\"C\"]"), "write positive = \"reversed\" in [axes.C]"),
    row(
        "C said to be reversed",
        || {
            checked(
                &(machine(&[("[axes.C]\npositive = \"iso\"", "[axes.C]\npositive = \"reversed\"")])
                    + "\n[simulated.wiring]\nreversed = [\"C\"]\n"),
            )
        },
        "write positive = \"iso\" in [axes.C]",
    ),
    row(
        "X in inches",
        || wired("gain = { X = 25.4 }"),
        "the gain of X is 25.400: is the control set to \
        inches",
    ),
    row("Y half as far", || wired("gain = { Y = 0.5 }"), "the gain of Y is 0.500"),
    row("B ten times as far", || wired("gain = { B = 10.0 }"), "the gain of B is 10.000"),
    row("Z unplugged", || wired("gain = { Z = 0.0 }"), "the operator saw no motion"),
    row("probe inverted", || wired("probe = \"inverted\""), "the input is inverted"),
    row("probe dead", || wired("probe = \"dead\""), "the probe does not work"),
    row("probe stuck", || wired("probe = \"stuck\""), "stays closed with the stylus free and deflected"),
    row(
        "an axis too many",
        || {
            let three = [
                ("V[w-C-B-b-Y-X-Z-(C)-t]", "V[w-C-b-Y-X-Z-(C)-t]"),
                ("[axes.B]", "[axes.S]"),
                ("[axes.S]\nmin = -360.0\nmax = 360.0\nrapid_per_min = 36000.0\nacceleration_per_s2 = 1000.0", ""),
                ("on = \"B\"", "on = \"bed\""),
            ];
            let truth = with_control("wire = \"pty\"", &machine(&three));
            against(&machine(&[]), &truth, Pace::Fast, grbl)
        },
        "but not B",
    ),
    row(
        "faster than the control",
        || told(&[("rapid_per_min = 20000.0", "rapid_per_min = 40000.0")]),
        "the rapid speed of X exceeds the value of the control",
    ),
    row(
        "brisker than the control",
        || told(&[("acceleration_per_s2 = 2000.0", "acceleration_per_s2 = 4000.0")]),
        "the acceleration of X exceeds the value of the control",
    ),
    row(
        "not where the file has the axis",
        || told(&[("min = -50.0\nmax = 450.0", "min = -50.0\nmax = 400.0")]),
        "Z is at 450.000, outside its travel",
    ),
    row(
        "a fixture beside the stylus",
        || checked(&machine(&[("[artefact]", KEEPOUT)])),
        "X +1 mm: the collision check refuses the jog",
    ),
    row(
        "the hold register elsewhere",
        || {
            let truth = with_control("speaks = \"modbus\"", &machine(&[]));
            let hold = "\ndialect = \"grbl-m19\"\nregisters.command = { hold = { address = 105 }, \
                        chunk = { address = 6, registers = 99 } }";
            against(&machine(&[]), &truth, Pace::Real, |keys| keys + hold)
        },
        "the hold has no effect",
    ),
    row("in alarm", || faulty("kind = \"alarm\"\nat_line = 1"), "unlock the control ($X) and home the machine"),
    row("door open", || faulty("kind = \"door\"\nat_line = 1"), "close the door"),
    row("feed hold pressed", || faulty("kind = \"hold\"\nat_line = 1"), "a move is held"),
    row("not made ready", || faulty_modbus("kind = \"reset\""), "make the control ready"),
    row("emergency stop", || faulty_modbus("kind = \"e-stop\""), "alarm 10: emergency stop"),
    row("a latch in the PLC", || faulty_modbus("kind = \"slow-latch\""), "a program scan of about"),
    row(
        "a latch in a PLC beside the control",
        || checked(&with_truth("[simulated.latch]\ndelay_ms = 1.0\nscan_ms = 10.0\n")),
        "a program scan of about",
    ),
    row(
        "touches that scatter more than declared",
        || {
            let scatters = machine(&[("repeatability_um = 0.5", "repeatability_um = 3.0")]);
            let truth = with_control("wire = \"pty\"", &scatters);
            against(&machine(&[]), &truth, Pace::Fast, grbl)
        },
        "repeatability_um in [probe] and the display resolution explain",
    ),
    row("no part", || part_off("[-20.0, 0.0]"), "the part is not at the position in the machine file"),
    row("a part too near", || part_off("[3.5, 0.0]"), "unexpected contact during a positioning move"),
    row(
        "two feeds that are one",
        || checked(&machine(&[("search_feed_mm_min = 300.0", "search_feed_mm_min = 40.0")])),
        "the fast feed of 40 mm/min is not allowed",
    ),
    row(
        "a part that may stand anywhere",
        || checked(&machine(&[("uncertainty_mm = 2.0", "uncertainty_mm = 3.0")])),
        "more than the overtravel of 6 mm",
    ),
];
