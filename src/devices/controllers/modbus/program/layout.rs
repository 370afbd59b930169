//! Layout of the parameters in the chunk: converts numbers to registers, and back.

use serde::Deserialize;

use super::Program;
use super::rows::{Does, Row};
use crate::controllers::modbus::map::Register;
use crate::controllers::modbus::map::check::{Span, apart};
use crate::controllers::modbus::map::keys::Entry;
use link::modbus::Space;
use link::modbus::value::{Kind, ValueError};
use machine::Axis;

const AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
/// Default scale of positions, mm or degrees: the last of the text's four decimals. `VALUE_STEP`: the last
/// of three decimals of feeds and seconds.
const STEP: f64 = 0.0001;
const VALUE_STEP: f64 = 0.001;
/// Largest difference between a number in registers and the number in the text, in the text's units.
const SAME: f64 = 1e-6;

/// Keys of `[controller.program.parameters]`: addresses count from the chunk's first register.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct ParameterKeys {
    sequence: Entry,
    program: Entry,
    tool: Entry,
    step: Entry,
    touches: Entry,
    rows: Entry,
    table: TableKeys,
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct TableKeys {
    address: Option<u16>,
    registers: Option<u16>,
}

/// Keys of `[controller.program.row]`: addresses count from the row's first register.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct RowKeys {
    kind: Entry,
    axes: Entry,
    value: Entry,
    #[serde(rename = "X")]
    x: Entry,
    #[serde(rename = "Y")]
    y: Entry,
    #[serde(rename = "Z")]
    z: Entry,
    #[serde(rename = "A")]
    a: Entry,
    #[serde(rename = "B")]
    b: Entry,
    #[serde(rename = "C")]
    c: Entry,
}

/// Parameters of one call.
pub(super) struct Call<'a> {
    pub sequence: u16,
    pub program: &'a Program,
    pub step: u32,
    pub rows: &'a [Row],
}

#[derive(Debug, Clone)]
pub(super) struct Layout {
    sequence: Register,
    program: Register,
    tool: Register,
    step: Register,
    touches: Register,
    rows: Register,
    /// First register of the table; registers of a row (`stride`); maximum number of rows (`most`).
    table: u16,
    stride: u16,
    most: u16,
    kind: Register,
    axes: Register,
    value: Register,
    target: Vec<(Axis, Register)>,
}

impl Layout {
    /// # Errors
    /// Items overlap, or are beyond the `registers` of the chunk.
    pub(super) fn of(keys: ParameterKeys, row: RowKeys, registers: u16) -> Result<Self, String> {
        let table = keys.table.address.unwrap_or(8);
        let stride = keys.table.registers.unwrap_or(16);
        let axes = AXES.into_iter().zip([row.x, row.y, row.z, row.a, row.b, row.c]);
        let axis = |(place, (axis, entry)): (u16, (Axis, Entry))| {
            (axis, entry.scaled(STEP).at(place, Kind::I32))
        };
        let layout = Self {
            sequence: keys.sequence.at(0, Kind::U16),
            program: keys.program.at(1, Kind::U16),
            tool: keys.tool.at(2, Kind::U16),
            step: keys.step.at(3, Kind::U32),
            touches: keys.touches.at(5, Kind::U16),
            rows: keys.rows.at(6, Kind::U16),
            table,
            stride,
            most: registers.saturating_sub(table).checked_div(stride).unwrap_or(0),
            kind: row.kind.at(0, Kind::U16),
            axes: row.axes.at(1, Kind::U16),
            value: row.value.scaled(VALUE_STEP).at(2, Kind::U32),
            target: (4..).step_by(2).zip(axes).map(axis).collect(),
        };
        layout.check()?;
        Ok(layout)
    }

    fn check(&self) -> Result<(), String> {
        if self.most == 0 {
            return Err("`command.chunk` holds no row of the program's table".to_owned());
        }
        let span = |section: &str, name: &str, at: &Register| -> Span {
            (Space::Holding, at.address, at.count(), format!("{section}.{name}"))
        };
        let heads = [
            ("sequence", &self.sequence),
            ("program", &self.program),
            ("tool", &self.tool),
            ("step", &self.step),
            ("touches", &self.touches),
            ("rows", &self.rows),
        ];
        let heads = heads.map(|(name, at)| span("parameters", name, at));
        let named = [("kind", &self.kind), ("axes", &self.axes), ("value", &self.value)];
        let mut row: Vec<Span> = named.map(|(name, at)| span("row", name, at)).to_vec();
        row.extend(self.target.iter().map(|(axis, at)| span("row", &axis.to_string(), at)));
        row.push((Space::Holding, self.stride, 1, "the next row".to_owned()));
        let end = |(_, at, count, _): &Span| u32::from(*at) + u32::from(*count);
        if let Some((.., name)) =
            row.iter().rev().skip(1).find(|item| end(item) > self.stride.into())
        {
            return Err(format!("`{name}` lies beyond the {} registers of a row", self.stride));
        }
        if let Some((.., name)) = heads.iter().find(|item| end(item) > self.table.into()) {
            return Err(format!("`{name}` does not lie before the table at {}", self.table));
        }
        apart(heads.to_vec())?;
        apart(row)
    }

    /// Returns the chunk for `call` as bytes, the high byte of each register first.
    ///
    /// # Errors
    /// There are too many rows, or the registers cannot hold a number of the text.
    pub(super) fn chunk(&self, call: &Call) -> Result<Vec<u8>, String> {
        let items = self.items(call)?;
        let length = usize::from(self.table) + call.rows.len() * usize::from(self.stride);
        let mut words = vec![0; length];
        for (register, value) in &items {
            let written = register.number.write(*value).map_err(|error| error.to_string())?;
            let first = usize::from(register.address);
            let place = words.get_mut(first..first + written.len());
            place.ok_or("a parameter lies beyond the chunk")?.copy_from_slice(&written);
        }
        // Compares each number with the one that the control will read.
        for (register, value) in &items {
            let read = register.read(&words, 0).map_err(|error: ValueError| error.to_string())?;
            if (read - value).abs() > SAME {
                return Err(format!(
                    "its registers would hold {read} where the text says {value}: give it a finer \
                     `scale` or another `type`"
                ));
            }
        }
        Ok(words.into_iter().flat_map(u16::to_be_bytes).collect())
    }

    /// All numbers of the call, each with its register.
    fn items(&self, call: &Call) -> Result<Vec<(Register, f64)>, String> {
        let (rows, most) = (call.rows.len(), usize::from(self.most));
        if rows > most {
            return Err(format!("it has {rows} moves, and `command.chunk` holds {most} rows"));
        }
        let touches = call.rows.iter().filter(|row| row.does == Does::Touch).count();
        let mut items = vec![
            (self.sequence, f64::from(call.sequence)),
            (self.program, f64::from(call.program.number)),
            (self.tool, f64::from(call.program.tool)),
            (self.step, f64::from(call.step)),
            (self.touches, touches as f64),
            (self.rows, rows as f64),
        ];
        for (row, first) in call.rows.iter().zip((self.table..).step_by(self.stride.into())) {
            self.row(row, first, &mut items)?;
        }
        Ok(items)
    }

    fn row(&self, row: &Row, first: u16, items: &mut Vec<(Register, f64)>) -> Result<(), String> {
        let at = |at: &Register| Register { address: first + at.address, ..*at };
        let known = |axis: Axis| self.target.iter().any(|(known, _)| *known == axis);
        if let Some((axis, _)) = row.target.iter().find(|(axis, _)| !known(*axis)) {
            return Err(format!("a row has no place for {axis}"));
        }
        let named =
            self.target.iter().zip(0..).filter(|((axis, _), _)| row.target.get(*axis).is_some());
        let mask: u16 = named.map(|(_, bit)| 1 << bit).sum();
        items.push((at(&self.kind), f64::from(row.does as u8)));
        items.push((at(&self.axes), f64::from(mask)));
        items.push((at(&self.value), row.value));
        for (axis, register) in &self.target {
            let value = row.target.get(*axis).map_or(0.0, |value| axis.to_edge(value));
            items.push((at(register), value));
        }
        Ok(())
    }
}
