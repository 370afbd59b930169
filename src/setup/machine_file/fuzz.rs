//! Fuzz tests of the parsers of machine files and ball tables.

use super::{MachineFile, balls_csv};
use crate::setup;
use machine::artefact;
use machine::record::artefact::Balls;
use methods::{METHOD_DESCRIPTIONS, ObjectPositionSource};
use testing::fuzz::fuzz_parser;

const SIMULATED: &[u8] = include_bytes!("../../../config/simulated.toml");
const GRBL: &[u8] = include_bytes!("../../../config/grblhal-serial.toml");
const SAMBA: &[u8] = include_bytes!("../../../config/samba.toml");
const LINUXCNC: &[u8] = include_bytes!("../../../config/linuxcnc-sim.toml");

#[test]
fn fuzz_machine_file() {
    let words = [
        "[machine]\n",
        "[axes.X]\n",
        "[controller]\n",
        "[probe]\n",
        "[[keepout]]\n",
        "[[solid]]\n",
        "[artefact]\n",
        "[[artefact.balls]]\n",
        "[[artefact.lengths]]\n",
        "file = \"../set.csv\"\n",
        "[[simulated.ball_moves]]\n",
        "[method.self-calibration]\n",
        "[tolerance]\n",
        "[simulated]\n",
        "name = ",
        "topology = ",
        "min = ",
        "kind = ",
        "\"simulated\"\n",
        "on = \"table\"\n",
        "[0, 0, 1]\n",
        "1.5\n",
        "\n",
    ];
    fuzz_parser("machine-file", &[SIMULATED, SAMBA, GRBL, LINUXCNC], &words, |input| {
        let text = String::from_utf8_lossy(input).into_owned();
        match MachineFile::parse("fuzz.toml", text) {
            Err(error) => error.to_string().len(),
            Ok(file) => build_parts_and_check_finite_numbers(&file),
        }
    });
}

#[test]
fn fuzz_ball_table() {
    const BALL_TABLE_CSV: &[u8] = b"# set\nball,x_mm,y_mm,z_mm,radius_mm,stem_x,stem_y,stem_z,stem_radius_mm,\
        stem_length_mm\n1,-150,0,40,6,0,0,-1,2,40\n2,150,0,40,6,0,0,-1,2,40\n3,0,90,40,6,,,,,\n";
    let words = ["ball", ",x_mm", ",y_mm", ",z_mm", ",radius_mm", ",stem_x", ",1", "\n", "\"", "#"];
    fuzz_parser("balls-csv", &[BALL_TABLE_CSV], &words, |input| {
        match balls_csv::parse_ball_csv("set.csv", &String::from_utf8_lossy(input), &Default::default()) {
            Err(error) => error.to_string().len(),
            Ok((_, balls)) => {
                let balls: Vec<_> = balls.into_iter().map(|(ball, _)| ball).collect();
                assert!(!serde_json::to_string(&balls).unwrap().contains("null"));
                drop(artefact::check_balls(&Balls { balls, ..Balls::default() }));
                input.len()
            }
        }
    });
}

/// Checks that every number of the file is finite, and builds the plan, the first stage and the world. Returns the
/// size of the file's parts as JSON, bytes.
fn build_parts_and_check_finite_numbers(file: &MachineFile) -> usize {
    let machine = serde_json::to_string(&(&file.machine, &file.probe, &file.artefact)).unwrap();
    assert!(!machine.contains("null"), "{machine}");
    let bodies = serde_json::to_string(&(&file.keepout_boxes, &file.solids)).unwrap();
    assert!(!bodies.contains("null"), "{bodies}");
    let configured = setup::configure_method_and_plan_without_steps(file, METHOD_DESCRIPTIONS[0].name, None);
    let Ok((method, plan_without_steps)) = configured else {
        return machine.len();
    };
    drop(method.next_stage(&plan_without_steps, &[], ObjectPositionSource::Nominal));
    drop(setup::build_world(file));
    machine.len() + bodies.len()
}
