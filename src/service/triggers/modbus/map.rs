//! Register map of the daemon's own Modbus server, defined only here; a test compares it with the table in
//! docs/modbus.md.

use crate::service::config::MAX_CYCLES;
use crate::service::machine_state::{Interlocks, MachineState};
use machine::record::estimate::{Parameter, Unit, Verdict};

/// Coils: written by the control, read back as written.
pub const ENABLE: u16 = 0;
pub const AUTO: u16 = 1;
pub const DOOR: u16 = 2;
pub const STOP: u16 = 3;
pub const ACKNOWLEDGE: u16 = 4;
/// Conditions of an unattended cycle: see docs/schedule.md.
pub const PROBE: u16 = 5;
pub const ARTEFACT: u16 = 6;
pub const TEMPERATURE: u16 = 7;
pub const IDLE: u16 = 8;
/// Cycle `k` is started by coil `START + k`.
pub const START: u16 = 10;
pub const COILS: usize = (START + MAX_CYCLES + 1) as usize;

/// The only holding register; the control changes it continuously as a sign of life.
pub const ALIVE: u16 = 0;
pub const HOLDINGS: usize = 1;

/// Input registers: state of the machine.
const HEARTBEAT: usize = 0;
const STATE: usize = 1;
const PROGRESS: usize = 2;
const VERDICT: usize = 3;
const CYCLE: usize = 4;
const RUN: usize = 5;
const ACCEPTED: usize = 7;
const REFUSED: usize = 8;
const REFUSAL: usize = 9;
const INTERLOCKS: usize = 10;
const VERSION: usize = 11;
const MAP: usize = 14;
const COUNT: usize = 15;
const DEVIATIONS: usize = 100;
/// Number of registers of a deviation.
const RECORD: usize = 10;
/// Maximum number of deviations, so that all fit into one request.
const MAX_DEVIATIONS: usize = 12;
pub const INPUTS: usize = DEVIATIONS + MAX_DEVIATIONS * RECORD;
/// Version of this register map.
const MAP_VERSION: u16 = 1;

/// Rows of docs/modbus.md: space, first register, name.
#[cfg(test)]
pub const ROWS: [(&str, usize, &str); 25] = [
    ("coil", ENABLE as usize, "enable"),
    ("coil", AUTO as usize, "auto"),
    ("coil", DOOR as usize, "door"),
    ("coil", STOP as usize, "stop"),
    ("coil", ACKNOWLEDGE as usize, "acknowledge"),
    ("coil", PROBE as usize, "probe"),
    ("coil", ARTEFACT as usize, "artefact"),
    ("coil", TEMPERATURE as usize, "temperature"),
    ("coil", IDLE as usize, "idle"),
    ("coil", START as usize + 1, "start 1"),
    ("coil", (START + MAX_CYCLES) as usize, "start 8"),
    ("holding", ALIVE as usize, "alive"),
    ("input", HEARTBEAT, "heartbeat"),
    ("input", STATE, "state"),
    ("input", PROGRESS, "progress"),
    ("input", VERDICT, "verdict"),
    ("input", CYCLE, "cycle"),
    ("input", RUN, "run"),
    ("input", ACCEPTED, "accepted"),
    ("input", REFUSED, "refused"),
    ("input", REFUSAL, "refusal"),
    ("input", INTERLOCKS, "said"),
    ("input", VERSION, "version"),
    ("input", MAP, "map"),
    ("input", COUNT, "count"),
];

/// Values of all input registers at one instant.
pub fn image(
    machine_state: &MachineState,
    interlocks: Interlocks,
    heartbeat: u16,
) -> [u16; INPUTS] {
    let mut image = [0; INPUTS];
    let verdict = match machine_state.verdict {
        None => 0,
        Some(Verdict::Pass) => 1,
        Some(Verdict::Fail) => 2,
        Some(Verdict::Undecided) => 3,
        Some(Verdict::None) => 4,
        Some(Verdict::UndecidedModel) => 5,
    };
    let flags =
        [interlocks.fresh, interlocks.enable, interlocks.auto, interlocks.door, interlocks.stop];
    let mask = flags.iter().rev().fold(0, |mask, flag| mask << 1 | u16::from(*flag));
    let shown = machine_state.deviations.len().min(MAX_DEVIATIONS);
    image[HEARTBEAT] = heartbeat;
    image[STATE] = machine_state.state as u16;
    image[PROGRESS] = machine_state.progress_percent;
    image[VERDICT] = verdict;
    image[CYCLE] = machine_state.cycle;
    put(&mut image, RUN, &words(machine_state.run));
    image[ACCEPTED] = machine_state.accepted;
    image[REFUSED] = machine_state.refused;
    image[REFUSAL] = machine_state.refusal.map_or(0, |why| why as u16);
    image[INTERLOCKS] = mask;
    put(&mut image, VERSION, &version());
    image[MAP] = MAP_VERSION;
    image[COUNT] = shown as u16;
    for (place, parameter) in (DEVIATIONS..).step_by(RECORD).zip(&machine_state.deviations[..shown])
    {
        put(&mut image, place, &deviation(parameter));
    }
    image
}

fn put(image: &mut [u16; INPUTS], at: usize, registers: &[u16]) {
    image.iter_mut().skip(at).zip(registers).for_each(|(to, from)| *to = *from);
}

/// Registers of a 32-bit value, high word first.
fn words(value: u32) -> [u16; 2] {
    [(value >> 16) as u16, value as u16]
}

fn version() -> [u16; 3] {
    [
        env!("CARGO_PKG_VERSION_MAJOR"),
        env!("CARGO_PKG_VERSION_MINOR"),
        env!("CARGO_PKG_VERSION_PATCH"),
    ]
    .map(|part| part.parse().unwrap_or(0))
}

/// Symbol (eight characters), unit, value and expanded uncertainty in thousandths of the unit, and whether the
/// parameter is identifiable.
fn deviation(parameter: &Parameter) -> [u16; RECORD] {
    let unit = match parameter.unit {
        Unit::Um => 1,
        Unit::Urad => 2,
        Unit::UmPerM => 3,
        Unit::Mm => 4,
        Unit::Ms => 5,
    };
    // The cast saturates.
    let thousandths = |value: f64| words((value * 1e3).round() as i32 as u32);
    let bytes = parameter.symbol.as_bytes();
    let byte = |at: usize| u16::from(bytes.get(at).copied().unwrap_or(0));
    let letters = |pair: usize| byte(2 * pair) << 8 | byte(2 * pair + 1);
    let [value_high, value_low] = thousandths(parameter.value);
    let [u_high, u_low] = thousandths(parameter.expanded);
    let [a, b, c, d] = [0, 1, 2, 3].map(letters);
    [a, b, c, d, unit, value_high, value_low, u_high, u_low, u16::from(parameter.identifiable)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::machine_state::REFUSALS;

    const DOCS: &str = include_str!("../../../../docs/modbus.md");

    #[test]
    fn the_published_tables_are_these() {
        let rows = DOCS.lines().filter(|line| {
            ["| coil |", "| holding |", "| input |"].iter().any(|space| line.starts_with(space))
        });
        let expected = ROWS.map(|(space, at, name)| format!("| {space} | {at} | `{name}` | "));
        assert_eq!(rows.clone().count(), expected.len());
        for (row, expected) in rows.zip(&expected) {
            assert!(row.starts_with(expected.as_str()), "{row} is not {expected}");
        }
        for why in REFUSALS {
            let row = format!("\n| {} | {why} |\n", why as u16);
            assert!(DOCS.contains(&row), "{row}");
        }
    }

    #[test]
    fn numbers_are_signed_and_saturate() {
        let parameter = |value: f64| Parameter {
            symbol: "EX0C".to_owned(),
            value,
            unit: Unit::Um,
            u: 0.5,
            expanded: 1.0,
            k: 2.0,
            dof: None,
            identifiable: true,
            u_monte_carlo: None,
            interval_monte_carlo: None,
            budget: Vec::new(),
            judged: None,
        };
        assert_eq!(
            deviation(&parameter(-0.001)),
            [0x4558, 0x3043, 0, 0, 1, 0xffff, 0xffff, 0, 1000, 1]
        );
        assert_eq!(deviation(&parameter(1e9))[5..7], [0x7fff, 0xffff]);
    }
}
