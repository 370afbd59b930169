//! Keys of `[controller.registers]`, and the defaults of omitted keys.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::{ChunkRegisters, CommandRegisters, Register, ResultRegisters, StatusRegisters, WindowRegisterMap, check};
use link::modbus::RegisterSpace;
use link::modbus::number_format::{ByteOrder, NumberFormat, NumberType};
use machine::Axis;

/// Keys of one item; an omitted key keeps its published value.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in super::super) struct RegisterKeys {
    address: Option<u16>,
    #[serde(rename = "type")]
    number_type: Option<NumberType>,
    order: Option<ByteOrder>,
    /// Size of one count; the default is 1, for positions, feeds, dwells and angles a smaller number.
    scale: Option<f64>,
}

/// Keys of the registers that hold one line, or the parameters of a resident program.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct ChunkKeys {
    address: Option<u16>,
    /// Number of registers.
    registers: Option<u16>,
    /// Order of the two characters of a register; an error for a resident program.
    order: Option<ByteOrder>,
}

/// Keys of `[controller.registers]`.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(in super::super) struct RegisterMapKeys {
    command: CommandKeys,
    status: WindowStatusKeys,
}

/// Keys of `[controller.registers.command]`: holding registers that `trued` writes.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct CommandKeys {
    /// 1: the control holds the machine.
    hold: RegisterKeys,
    /// Number of the chunk, written last.
    sequence: RegisterKeys,
    /// Heartbeat of `trued`.
    heartbeat: RegisterKeys,
    /// Number of the last result that `trued` has read; without results, of the last checked chunk.
    acknowledge: RegisterKeys,
    /// Checksum of the chunk's bytes.
    crc: RegisterKeys,
    /// Length of the chunk, bytes.
    length: RegisterKeys,
    chunk: ChunkKeys,
}

/// Keys of `[controller.registers.status]`: registers that the control writes.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct WindowStatusKeys {
    /// `input` or `holding`; the default is `input`.
    space: Option<RegisterSpace>,
    /// Counter of the status blocks.
    sequence_head: RegisterKeys,
    /// Version of the window layout.
    version: RegisterKeys,
    /// 0: not ready; 1: idle; 2: running; 3: held; 4: alarm.
    state: RegisterKeys,
    /// Code of the alarm; in the state `held`, the reason of the hold.
    alarm: RegisterKeys,
    /// Last sequence that the control has checked, accepted or refused.
    accepted: RegisterKeys,
    /// Last sequence whose execution is complete.
    executed: RegisterKeys,
    /// Reason why the sequence in `accepted` was refused; 0: it was not refused.
    error: RegisterKeys,
    /// 0: open; any other number: closed.
    probe: RegisterKeys,
    /// One bit for each input: A is bit 0.
    inputs: RegisterKeys,
    /// Number of contacts so far; with a resident program, number of results.
    latches: RegisterKeys,
    /// Heartbeat of the control's program.
    heartbeat: RegisterKeys,
    /// Present time of the control's clock; 0: the control has no clock.
    time_s: RegisterKeys,
    /// Time of the last contact on the control's clock; 0: the control has no clock.
    latch_time_s: RegisterKeys,
    /// Latched positions; if the table is present, it lists all axes of the window.
    latch: Option<BTreeMap<Axis, RegisterKeys>>,
    /// Present positions; if the table is present, it lists all axes of the window.
    position: Option<BTreeMap<Axis, RegisterKeys>>,
    /// Same value as `sequence_head`, unless the block changed during the read.
    sequence_tail: RegisterKeys,
    /// Further registers of a resident program; an error if no resident program is configured.
    result: Option<ResultKeys>,
}

/// Keys of `[controller.registers.status.result]`, only with a resident program.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct ResultKeys {
    /// Number of the row that the program executes; 0: none.
    under_way: RegisterKeys,
    /// Sequence of the call to which the result belongs.
    sequence: RegisterKeys,
    /// Row to which the result belongs, from 1.
    row: RegisterKeys,
    /// 0: the row ended without a contact.
    contact: RegisterKeys,
    /// 1 until the result is acknowledged.
    valid: RegisterKeys,
}

/// Defaults that differ between the window for lines and the window of a resident program.
struct WindowDefaults {
    chunk_register_count: u16,
    /// Last register of the status block; it repeats the counter of the status blocks.
    sequence_tail_address: u16,
}

const LINE_WINDOW_DEFAULTS: WindowDefaults = WindowDefaults { chunk_register_count: 100, sequence_tail_address: 44 };
const PROGRAM_WINDOW_DEFAULTS: WindowDefaults = WindowDefaults { chunk_register_count: 328, sequence_tail_address: 49 };

/// Axes of the published window, in the order of their registers.
const WINDOW_AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
/// Default address of the first latched position; two registers for each axis.
const DEFAULT_LATCH_ADDRESS: u16 = 20;
/// Default address of the first position; two registers for each axis.
const DEFAULT_POSITION_ADDRESS: u16 = 32;
/// Default scale of positions, mm or degrees per count.
const DEFAULT_POSITION_SCALE: f64 = 0.001;

impl RegisterKeys {
    /// Item with these keys; an omitted `order` or `scale` is the default order or 1.
    pub(in super::super) fn register(self, default_address: u16, default_type: NumberType) -> Register {
        let number = NumberFormat {
            number_type: self.number_type.unwrap_or(default_type),
            order: self.order.unwrap_or_default(),
            scale: self.scale.unwrap_or(1.0),
        };
        Register { address: self.address.unwrap_or(default_address), number_format: number }
    }

    /// Sets the scale, unless the keys give one.
    pub(in super::super) fn with_default_scale(self, scale: f64) -> Self {
        Self { scale: self.scale.or(Some(scale)), ..self }
    }

    /// Item of a position; the default type is `i32`, the default scale [`DEFAULT_POSITION_SCALE`].
    fn axis_register(self, default_address: u16) -> Register {
        self.with_default_scale(DEFAULT_POSITION_SCALE).register(default_address, NumberType::I32)
    }
}

/// Registers of `latch` or `position`, which is `name` in errors; without `keys`, those of [`WINDOW_AXES`] from
/// `first_address`. An axis without an address in `keys` is an error.
fn axis_registers(
    name: &str,
    keys: Option<BTreeMap<Axis, RegisterKeys>>,
    first_address: u16,
) -> Result<BTreeMap<Axis, Register>, String> {
    let Some(keys) = keys else {
        let addresses = WINDOW_AXES.into_iter().zip((first_address..).step_by(2));
        return Ok(addresses.map(|(axis, address)| (axis, RegisterKeys::default().axis_register(address))).collect());
    };
    let register = |(axis, entry): (Axis, RegisterKeys)| match entry.address {
        Some(address) => Ok((axis, entry.axis_register(address))),
        None => Err(format!("`status.{name}.{axis}` needs an `address`")),
    };
    keys.into_iter().map(register).collect()
}

impl TryFrom<RegisterMapKeys> for WindowRegisterMap {
    type Error = String;

    /// Returns the map of the window for lines; registers of a resident program are an error.
    fn try_from(RegisterMapKeys { command, status }: RegisterMapKeys) -> Result<Self, String> {
        if status.result.is_some() {
            return Err("`status.result` belongs to a resident program: add [controller.program], \
                        or remove `status.result`"
                .to_owned());
        }
        let map = Self {
            command: command.into_registers(&LINE_WINDOW_DEFAULTS),
            status: status.into_registers(&LINE_WINDOW_DEFAULTS)?,
        };
        check::check_map(&map)?;
        Ok(map)
    }
}

impl RegisterMapKeys {
    /// Returns the map of the window to a resident program.
    ///
    /// # Errors
    /// The map is invalid; the message names the items.
    pub(in super::super) fn into_program_map(self) -> Result<WindowRegisterMap, String> {
        let Self { command, mut status } = self;
        let result = status.result.take().unwrap_or_default();
        let mut map = WindowRegisterMap {
            command: command.into_registers(&PROGRAM_WINDOW_DEFAULTS),
            status: status.into_registers(&PROGRAM_WINDOW_DEFAULTS)?,
        };
        map.status.result = Some(result.into_registers());
        check::check_map(&map)?;
        Ok(map)
    }
}

impl CommandKeys {
    fn into_registers(self, defaults: &WindowDefaults) -> CommandRegisters {
        CommandRegisters {
            hold: self.hold.register(0, NumberType::U16),
            sequence: self.sequence.register(1, NumberType::U16),
            heartbeat: self.heartbeat.register(2, NumberType::U16),
            result_acknowledge: self.acknowledge.register(3, NumberType::U16),
            chunk_crc: self.crc.register(4, NumberType::U16),
            chunk_length: self.length.register(5, NumberType::U16),
            chunk: ChunkRegisters {
                address: self.chunk.address.unwrap_or(6),
                register_count: self.chunk.registers.unwrap_or(defaults.chunk_register_count),
                order: self.chunk.order.unwrap_or_default(),
            },
        }
    }
}

impl ResultKeys {
    fn into_registers(self) -> ResultRegisters {
        ResultRegisters {
            active_row_number: self.under_way.register(44, NumberType::U16),
            call_sequence: self.sequence.register(45, NumberType::U16),
            row_number: self.row.register(46, NumberType::U16),
            contact_flag: self.contact.register(47, NumberType::U16),
            unacknowledged_flag: self.valid.register(48, NumberType::U16),
        }
    }
}

impl WindowStatusKeys {
    fn into_registers(self, defaults: &WindowDefaults) -> Result<StatusRegisters, String> {
        Ok(StatusRegisters {
            space: self.space.unwrap_or(RegisterSpace::Input),
            sequence_head: self.sequence_head.register(0, NumberType::U16),
            window_version: self.version.register(1, NumberType::U16),
            state: self.state.register(2, NumberType::U16),
            alarm_code: self.alarm.register(3, NumberType::U16),
            checked_sequence: self.accepted.register(4, NumberType::U16),
            executed_sequence: self.executed.register(5, NumberType::U16),
            refusal_code: self.error.register(6, NumberType::U16),
            probe_closed_flag: self.probe.register(7, NumberType::U16),
            input_bits: self.inputs.register(8, NumberType::U32),
            latch_count: self.latches.register(10, NumberType::U16),
            heartbeat: self.heartbeat.register(11, NumberType::U16),
            control_time_s: self.time_s.register(12, NumberType::F64),
            latch_time_s: self.latch_time_s.register(16, NumberType::F64),
            latched_position: axis_registers("latch", self.latch, DEFAULT_LATCH_ADDRESS)?,
            position: axis_registers("position", self.position, DEFAULT_POSITION_ADDRESS)?,
            sequence_tail: self.sequence_tail.register(defaults.sequence_tail_address, NumberType::U16),
            result: None,
        })
    }
}
