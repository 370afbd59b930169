//! Any text as a machine file.

use super::MachineFile;
use crate::base::fuzz::fuzz;
use crate::methods::{NAMES, Source};
use crate::setup;

const SIMULATED: &[u8] = include_bytes!("../../../config/simulated.toml");
const GRBL: &[u8] = include_bytes!("../../../config/grblhal-serial.toml");
const LINUXCNC: &[u8] = include_bytes!("../../../config/linuxcnc-sim.toml");

#[test]
fn the_machine_file_bears_anything() {
    let words = [
        "[machine]\n",
        "[axes.X]\n",
        "[controller]\n",
        "[probe]\n",
        "[[keepout]]\n",
        "[[solid]]\n",
        "[artefact]\n",
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
    fuzz("machine-file", &[SIMULATED, GRBL, LINUXCNC], &words, |input| {
        let text = String::from_utf8_lossy(input).into_owned();
        match MachineFile::parse("fuzz.toml", text) {
            Err(error) => error.to_string().len(),
            Ok(file) => plan(&file),
        }
    });
}

/// Every number is one; the parts that are built from a file without moving; bytes of the plan.
fn plan(file: &MachineFile) -> usize {
    let machine = serde_json::to_string(&(&file.machine, &file.probe, &file.artefact)).unwrap();
    assert!(!machine.contains("null"), "{machine}");
    let bodies = serde_json::to_string(&(&file.keepout, &file.solids)).unwrap();
    assert!(!bodies.contains("null"), "{bodies}");
    let Ok((method, plan)) = setup::header(file, NAMES[0], None) else { return machine.len() };
    drop(method.next(&plan, &[], Source::Nominal));
    drop(setup::world(file));
    machine.len() + bodies.len()
}
