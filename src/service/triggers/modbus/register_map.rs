//! Register map of the daemon's own Modbus server, defined only here; a test compares it with the table in
//! docs/modbus.md.

use crate::service::config::MAX_CYCLES;
use crate::service::machine_state::{Interlocks, MachineState};
use machine::record::estimate::{Parameter, Unit, Verdict};

// Coils: the control writes them; a read returns the value that the control wrote last.
/// 1: the external start is enabled at the machine.
pub const START_ENABLED_COIL: u16 = 0;
/// 1: the control is in automatic mode.
pub const AUTO_MODE_COIL: u16 = 1;
/// 1: the guards are closed.
pub const DOOR_CLOSED_COIL: u16 = 2;
/// Rising edge: the machine is held. While the coil is 1, nothing is started or resumed.
pub const STOP_COIL: u16 = 3;
/// Rising edge: a person has inspected the held or failed machine.
pub const ACKNOWLEDGE_COIL: u16 = 4;
// Conditions of an unattended cycle: see docs/schedule.md.
/// 1: the probe is in the spindle and works.
pub const PROBE_READY_COIL: u16 = 5;
/// 1: the artefact is at the position of the machine file.
pub const ARTEFACT_IN_PLACE_COIL: u16 = 6;
/// 1: the machine and its surroundings are at the agreed temperature.
pub const TEMPERATURE_IN_RANGE_COIL: u16 = 7;
/// 1: the control executes no program.
pub const CONTROL_IDLE_COIL: u16 = 8;
/// A rising edge of coil `START_COIL_BASE + k` starts cycle `k`, from 1; coil 10 itself is unused.
pub const START_COIL_BASE: u16 = 10;
/// Number of coil addresses from 0, with the unused 9 and 10.
pub const COIL_COUNT: usize = (START_COIL_BASE + MAX_CYCLES + 1) as usize;

/// The only holding register; the control changes it continuously as a sign of life.
pub const ALIVE_REGISTER: u16 = 0;
pub const HOLDING_REGISTER_COUNT: usize = 1;

// Input registers: state of the machine.
/// Counter that advances four times a second and wraps around.
const HEARTBEAT_REGISTER: usize = 0;
/// Number of the [`ServiceState`](crate::service::machine_state::ServiceState).
const STATE_REGISTER: usize = 1;
const PROGRESS_PERCENT_REGISTER: usize = 2;
/// Code of the verdict; 0: none yet, 1: pass, 2: fail, 3: undecided, 4: no tolerance, 5: undecided because of the
/// model.
const VERDICT_REGISTER: usize = 3;
/// Number of the cycle that is running or ran last; 0 before the first start.
const CYCLE_REGISTER: usize = 4;
/// Number of the run of this cycle, or of the unfinished run found at the start of the service; 0: none yet. First of
/// two registers, high word first.
const RUN_REGISTER: usize = 5;
/// Number of accepted starts since the service began, without resumes.
const ACCEPTED_START_COUNT_REGISTER: usize = 7;
/// Number of refused requests of all clients since the service began.
const REFUSAL_COUNT_REGISTER: usize = 8;
/// Number of the last [`Refusal`](crate::service::machine_state::Refusal); 0: none.
const LAST_REFUSAL_REGISTER: usize = 9;
/// Bit mask of the interlocks that the control has written: 1 fresh, 2 enable, 4 auto, 8 door, 16 stop.
const INTERLOCKS_REGISTER: usize = 10;
/// First of three registers: major, minor and patch version of the program.
const PROGRAM_VERSION_REGISTER: usize = 11;
const MAP_VERSION_REGISTER: usize = 14;
/// Number of deviations that are present from [`FIRST_DEVIATION_REGISTER`] on; 0 until the cycle has an estimate.
const DEVIATION_COUNT_REGISTER: usize = 15;
/// First register of the first deviation, that is, of a parameter of the last estimate.
const FIRST_DEVIATION_REGISTER: usize = 100;
/// Number of registers of a deviation.
const REGISTERS_PER_DEVIATION: usize = 10;
/// Maximum number of deviations, so that all fit into one request; further parameters are left out.
const MAX_DEVIATIONS: usize = 12;
pub const INPUT_REGISTER_COUNT: usize = FIRST_DEVIATION_REGISTER + MAX_DEVIATIONS * REGISTERS_PER_DEVIATION;
/// Version of this register map.
const MAP_VERSION: u16 = 1;

/// Rows of docs/modbus.md: space, first register, name.
#[cfg(test)]
pub const COIL_AND_REGISTER_TABLE: [(&str, usize, &str); 25] = [
    ("coil", START_ENABLED_COIL as usize, "enable"),
    ("coil", AUTO_MODE_COIL as usize, "auto"),
    ("coil", DOOR_CLOSED_COIL as usize, "door"),
    ("coil", STOP_COIL as usize, "stop"),
    ("coil", ACKNOWLEDGE_COIL as usize, "acknowledge"),
    ("coil", PROBE_READY_COIL as usize, "probe"),
    ("coil", ARTEFACT_IN_PLACE_COIL as usize, "artefact"),
    ("coil", TEMPERATURE_IN_RANGE_COIL as usize, "temperature"),
    ("coil", CONTROL_IDLE_COIL as usize, "idle"),
    ("coil", START_COIL_BASE as usize + 1, "start 1"),
    ("coil", (START_COIL_BASE + MAX_CYCLES) as usize, "start 8"),
    ("holding", ALIVE_REGISTER as usize, "alive"),
    ("input", HEARTBEAT_REGISTER, "heartbeat"),
    ("input", STATE_REGISTER, "state"),
    ("input", PROGRESS_PERCENT_REGISTER, "progress"),
    ("input", VERDICT_REGISTER, "verdict"),
    ("input", CYCLE_REGISTER, "cycle"),
    ("input", RUN_REGISTER, "run"),
    ("input", ACCEPTED_START_COUNT_REGISTER, "accepted"),
    ("input", REFUSAL_COUNT_REGISTER, "refused"),
    ("input", LAST_REFUSAL_REGISTER, "refusal"),
    ("input", INTERLOCKS_REGISTER, "said"),
    ("input", PROGRAM_VERSION_REGISTER, "version"),
    ("input", MAP_VERSION_REGISTER, "map"),
    ("input", DEVIATION_COUNT_REGISTER, "count"),
];

/// Values of all input registers at one instant. `heartbeat`: the counter of the server.
pub fn input_registers(
    machine_state: &MachineState,
    interlocks: Interlocks,
    heartbeat: u16,
) -> [u16; INPUT_REGISTER_COUNT] {
    let mut image = [0; INPUT_REGISTER_COUNT];
    let verdict = match machine_state.verdict {
        None => 0,
        Some(Verdict::Pass) => 1,
        Some(Verdict::Fail) => 2,
        Some(Verdict::Undecided) => 3,
        Some(Verdict::None) => 4,
        Some(Verdict::UndecidedModel) => 5,
    };
    let flags = [
        interlocks.is_fresh,
        interlocks.is_start_enabled,
        interlocks.is_auto_mode,
        interlocks.is_door_closed,
        interlocks.is_stop_set,
    ];
    let mask = flags.iter().rev().fold(0, |mask, flag| mask << 1 | u16::from(*flag));
    let deviation_count = machine_state.estimated_parameters.len().min(MAX_DEVIATIONS);
    image[HEARTBEAT_REGISTER] = heartbeat;
    image[STATE_REGISTER] = machine_state.state as u16;
    image[PROGRESS_PERCENT_REGISTER] = machine_state.progress_percent;
    image[VERDICT_REGISTER] = verdict;
    image[CYCLE_REGISTER] = machine_state.cycle;
    write_registers(&mut image, RUN_REGISTER, &high_low_words(machine_state.run));
    image[ACCEPTED_START_COUNT_REGISTER] = machine_state.accepted_start_count;
    image[REFUSAL_COUNT_REGISTER] = machine_state.refusal_count;
    image[LAST_REFUSAL_REGISTER] = machine_state.last_refusal.map_or(0, |why| why as u16);
    image[INTERLOCKS_REGISTER] = mask;
    write_registers(&mut image, PROGRAM_VERSION_REGISTER, &program_version_registers());
    image[MAP_VERSION_REGISTER] = MAP_VERSION;
    image[DEVIATION_COUNT_REGISTER] = deviation_count as u16;
    for (register, parameter) in (FIRST_DEVIATION_REGISTER..)
        .step_by(REGISTERS_PER_DEVIATION)
        .zip(&machine_state.estimated_parameters[..deviation_count])
    {
        write_registers(&mut image, register, &deviation_registers(parameter));
    }
    image
}

fn write_registers(image: &mut [u16; INPUT_REGISTER_COUNT], first: usize, registers: &[u16]) {
    image.iter_mut().skip(first).zip(registers).for_each(|(to, from)| *to = *from);
}

/// Registers of a 32-bit value, high word first.
fn high_low_words(value: u32) -> [u16; 2] {
    [(value >> 16) as u16, value as u16]
}

fn program_version_registers() -> [u16; 3] {
    [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR"), env!("CARGO_PKG_VERSION_PATCH")]
        .map(|part| part.parse().unwrap_or(0))
}

/// Registers of one parameter: symbol (its first eight bytes), unit, value and expanded uncertainty in thousandths of
/// the unit, and whether the parameter is identifiable.
fn deviation_registers(parameter: &Parameter) -> [u16; REGISTERS_PER_DEVIATION] {
    let unit = match parameter.unit {
        Unit::Um => 1,
        Unit::Urad => 2,
        Unit::UmPerM => 3,
        Unit::Mm => 4,
        Unit::Ms => 5,
    };
    // The cast saturates.
    let thousandths = |value: f64| high_low_words((value * 1e3).round() as i32 as u32);
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
    use crate::service::machine_state::ALL_REFUSALS;

    const MODBUS_DOCS: &str = include_str!("../../../../docs/modbus.md");

    #[test]
    fn register_table_and_refusals_equal_those_of_the_docs() {
        let rows = MODBUS_DOCS
            .lines()
            .filter(|line| ["| coil |", "| holding |", "| input |"].iter().any(|space| line.starts_with(space)));
        let expected = COIL_AND_REGISTER_TABLE.map(|(space, at, name)| format!("| {space} | {at} | `{name}` | "));
        assert_eq!(rows.clone().count(), expected.len());
        for (row, expected) in rows.zip(&expected) {
            assert!(row.starts_with(expected.as_str()), "{row} is not {expected}");
        }
        for why in ALL_REFUSALS {
            let row = format!("\n| {} | {why} |\n", why as u16);
            assert!(MODBUS_DOCS.contains(&row), "{row}");
        }
    }

    #[test]
    fn deviation_values_are_signed_and_saturate() {
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
        assert_eq!(deviation_registers(&parameter(-0.001)), [0x4558, 0x3043, 0, 0, 1, 0xffff, 0xffff, 0, 1000, 1]);
        assert_eq!(deviation_registers(&parameter(1e9))[5..7], [0x7fff, 0xffff]);
    }
}
