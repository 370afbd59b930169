//! Layout of the parameters in the chunk: converts numbers to registers, and back.

use serde::Deserialize;

use super::ResidentProgram;
use super::rows::{ProgramRow, RowAction};
use crate::controllers::modbus::map::Register;
use crate::controllers::modbus::map::check::{RegisterSpan, check_overlaps};
use crate::controllers::modbus::map::keys::RegisterKeys;
use link::modbus::RegisterSpace;
use link::modbus::number_format::{NumberType, RegisterValueError};
use machine::Axis;

/// Axes of a row, in the order of their bits in the axis mask, from bit 0, and of their default registers.
const ROW_AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
/// Default scale of positions, mm or degrees per count: the last of the text's four decimals.
const DEFAULT_POSITION_SCALE: f64 = 0.0001;
/// Default scale of a feed, a dwell or an angle: the last of three decimals.
const DEFAULT_VALUE_SCALE: f64 = 0.001;
/// Largest permitted difference between a number in registers and the number in the text, in the text's units; beyond
/// it the block is refused.
const MAX_REGISTER_ROUNDING_ERROR: f64 = 1e-6;

/// Keys of `[controller.program.parameters]`: addresses count from the chunk's first register.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct ParameterKeys {
    /// Only sequence number that may start the chunk.
    sequence: RegisterKeys,
    /// Number of the resident program.
    program: RegisterKeys,
    /// Number of the probe as a tool; 0: any tool.
    tool: RegisterKeys,
    /// Step number of the plan, for the control's display.
    step: RegisterKeys,
    /// Number of rows that are touches.
    touches: RegisterKeys,
    /// Number of rows in the table.
    rows: RegisterKeys,
    table: TableKeys,
}

/// Location of the table of rows: `address` counts from the chunk's first register.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct TableKeys {
    address: Option<u16>,
    /// Number of registers of one row.
    registers: Option<u16>,
}

/// Keys of `[controller.program.row]`, `X` to `C` for end positions: addresses count from the row's first register.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RowKeys {
    /// Number of the [`RowAction`].
    kind: RegisterKeys,
    /// Bit mask of the axes that the row names: X is bit 0.
    axes: RegisterKeys,
    /// Feed, duration of a dwell or angle: see [`ProgramRow::feed_dwell_or_angle`].
    value: RegisterKeys,
    #[serde(rename = "X")]
    x: RegisterKeys,
    #[serde(rename = "Y")]
    y: RegisterKeys,
    #[serde(rename = "Z")]
    z: RegisterKeys,
    #[serde(rename = "A")]
    a: RegisterKeys,
    #[serde(rename = "B")]
    b: RegisterKeys,
    #[serde(rename = "C")]
    c: RegisterKeys,
}

/// Keys of the parameters of one call before the table, in the order of [`ParameterLayout::parameters`].
const PARAMETER_NAMES: [&str; 6] = ["sequence", "program", "tool", "step", "touches", "rows"];

/// Parameters of one call.
pub(super) struct ProgramCall<'a> {
    /// Only sequence number that may start the chunk.
    pub sequence: u16,
    pub program: &'a ResidentProgram,
    /// Step number of the plan, for the control's display.
    pub step: u32,
    pub rows: &'a [ProgramRow],
}

/// Registers of the parameters within the chunk, and of each item within a row of the table.
#[derive(Debug, Clone)]
pub(super) struct ParameterLayout {
    /// Registers of [`PARAMETER_NAMES`].
    parameters: [Register; PARAMETER_NAMES.len()],
    /// First register of the table, counted from the chunk's first register.
    table_offset: u16,
    registers_per_row: u16,
    /// Number of rows for which the chunk has registers.
    max_rows: u16,
    /// Number of the [`RowAction`]. The addresses of this register and of those below count from the first register of
    /// the row.
    action: Register,
    /// Bit mask of the axes that the row names: X is bit 0.
    axis_mask: Register,
    /// Feed, duration of a dwell or angle: see [`ProgramRow::feed_dwell_or_angle`].
    value: Register,
    /// End position of each axis, mm or degrees, in the order of [`ROW_AXES`].
    axis_targets: Vec<(Axis, Register)>,
}

impl ParameterLayout {
    /// # Errors
    /// Items overlap, or are beyond the registers of the chunk.
    pub(super) fn from_keys(keys: ParameterKeys, row: RowKeys, chunk_register_count: u16) -> Result<Self, String> {
        let table = keys.table.address.unwrap_or(8);
        let row_registers = keys.table.registers.unwrap_or(16);
        let axes = ROW_AXES.into_iter().zip([row.x, row.y, row.z, row.a, row.b, row.c]);
        let axis = |(address, (axis, entry)): (u16, (Axis, RegisterKeys))| {
            (axis, entry.with_default_scale(DEFAULT_POSITION_SCALE).register(address, NumberType::I32))
        };
        let layout = Self {
            parameters: [
                keys.sequence.register(0, NumberType::U16),
                keys.program.register(1, NumberType::U16),
                keys.tool.register(2, NumberType::U16),
                keys.step.register(3, NumberType::U32),
                keys.touches.register(5, NumberType::U16),
                keys.rows.register(6, NumberType::U16),
            ],
            table_offset: table,
            registers_per_row: row_registers,
            max_rows: chunk_register_count.saturating_sub(table).checked_div(row_registers).unwrap_or(0),
            action: row.kind.register(0, NumberType::U16),
            axis_mask: row.axes.register(1, NumberType::U16),
            value: row.value.with_default_scale(DEFAULT_VALUE_SCALE).register(2, NumberType::U32),
            axis_targets: (4..).step_by(2).zip(axes).map(axis).collect(),
        };
        layout.check_spans_fit_without_overlap()?;
        Ok(layout)
    }

    fn check_spans_fit_without_overlap(&self) -> Result<(), String> {
        if self.max_rows == 0 {
            return Err("`command.chunk` is too small for one row of the program's table".to_owned());
        }
        let span = |section: &str, name: &str, at: &Register| -> RegisterSpan {
            (RegisterSpace::Holding, at.address, at.register_count(), format!("{section}.{name}"))
        };
        let parameters = PARAMETER_NAMES.iter().zip(&self.parameters);
        let parameters: Vec<_> = parameters.map(|(name, at)| span("parameters", name, at)).collect();
        let named = [("kind", &self.action), ("axes", &self.axis_mask), ("value", &self.value)];
        let mut row: Vec<RegisterSpan> = named.map(|(name, at)| span("row", name, at)).to_vec();
        row.extend(self.axis_targets.iter().map(|(axis, at)| span("row", &axis.to_string(), at)));
        row.push((RegisterSpace::Holding, self.registers_per_row, 1, "the next row".to_owned()));
        let end = |(_, at, count, _): &RegisterSpan| u32::from(*at) + u32::from(*count);
        if let Some((.., name)) = row.iter().rev().skip(1).find(|item| end(item) > self.registers_per_row.into()) {
            return Err(format!("`{name}` is beyond the {} registers of a row", self.registers_per_row));
        }
        if let Some((.., name)) = parameters.iter().find(|item| end(item) > self.table_offset.into()) {
            return Err(format!("`{name}` must be before the table at {}", self.table_offset));
        }
        check_overlaps(parameters)?;
        check_overlaps(row)
    }

    /// Returns the chunk for `call` as bytes, the high byte of each register first.
    ///
    /// # Errors
    /// There are too many rows, or the registers cannot hold a number of the text.
    pub(super) fn encode_chunk(&self, call: &ProgramCall) -> Result<Vec<u8>, String> {
        let items = self.parameter_values(call)?;
        let length = usize::from(self.table_offset) + call.rows.len() * usize::from(self.registers_per_row);
        let mut words = vec![0; length];
        for (register, value) in &items {
            let written = register.number_format.encode(*value).map_err(|error| error.to_string())?;
            let first = usize::from(register.address);
            let target = words.get_mut(first..first + written.len());
            target.ok_or("a parameter is beyond the chunk")?.copy_from_slice(&written);
        }
        // Compares each number with the one that the control will read.
        for (register, value) in &items {
            let read = register.decode_from_block(&words, 0).map_err(|error: RegisterValueError| error.to_string())?;
            if (read - value).abs() > MAX_REGISTER_ROUNDING_ERROR {
                return Err(format!(
                    "the registers would contain {read} instead of {value} in the program text: set a finer \
                     `scale` or another `type`"
                ));
            }
        }
        Ok(words.into_iter().flat_map(u16::to_be_bytes).collect())
    }

    /// All numbers of the call, each with its register.
    fn parameter_values(&self, call: &ProgramCall) -> Result<Vec<(Register, f64)>, String> {
        let (rows, max_rows) = (call.rows.len(), usize::from(self.max_rows));
        if rows > max_rows {
            return Err(format!("the block has {rows} moves, but `command.chunk` holds only {max_rows} rows"));
        }
        let touches = call.rows.iter().filter(|row| row.action == RowAction::Touch).count();
        let (program, tool) = (f64::from(call.program.program_number), f64::from(call.program.probe_tool_number));
        let values = [f64::from(call.sequence), program, tool, f64::from(call.step), touches as f64, rows as f64];
        let mut items: Vec<_> = self.parameters.into_iter().zip(values).collect();
        for (row, first) in call.rows.iter().zip((self.table_offset..).step_by(self.registers_per_row.into())) {
            self.add_row_values(row, first, &mut items)?;
        }
        Ok(items)
    }

    /// Adds the numbers of `row`, whose first register is `first`, counted from the chunk's first register.
    fn add_row_values(&self, row: &ProgramRow, first: u16, items: &mut Vec<(Register, f64)>) -> Result<(), String> {
        let at = |at: &Register| Register { address: first + at.address, ..*at };
        let has_axis = |axis: Axis| self.axis_targets.iter().any(|(known, _)| *known == axis);
        if let Some((axis, _)) = row.target.iter().find(|(axis, _)| !has_axis(*axis)) {
            return Err(format!("a row has no register for {axis}"));
        }
        let named = self.axis_targets.iter().zip(0..).filter(|((axis, _), _)| row.target.get(*axis).is_some());
        let mask: u16 = named.map(|(_, bit)| 1 << bit).sum();
        items.push((at(&self.action), f64::from(row.action as u8)));
        items.push((at(&self.axis_mask), f64::from(mask)));
        items.push((at(&self.value), row.feed_dwell_or_angle));
        for (axis, register) in &self.axis_targets {
            let value = row.target.get(*axis).map_or(0.0, |value| axis.to_mm_or_deg(value));
            items.push((at(register), value));
        }
        Ok(())
    }
}
