//! Keys of `[controller.registers]`, and the defaults of omitted keys.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::{Chunk, Command, Map, Register, Results, Status, check};
use link::modbus::Space;
use link::modbus::value::{Kind, Number, Order};
use machine::Axis;

/// Keys of one item; an omitted key keeps its published value.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in super::super) struct Entry {
    address: Option<u16>,
    #[serde(rename = "type")]
    kind: Option<Kind>,
    order: Option<Order>,
    scale: Option<f64>,
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct ChunkKeys {
    address: Option<u16>,
    registers: Option<u16>,
    order: Option<Order>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(in super::super) struct Keys {
    command: CommandKeys,
    status: StatusKeys,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct CommandKeys {
    hold: Entry,
    sequence: Entry,
    heartbeat: Entry,
    acknowledge: Entry,
    crc: Entry,
    length: Entry,
    chunk: ChunkKeys,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct StatusKeys {
    space: Option<Space>,
    sequence_head: Entry,
    version: Entry,
    state: Entry,
    alarm: Entry,
    accepted: Entry,
    executed: Entry,
    error: Entry,
    probe: Entry,
    inputs: Entry,
    latches: Entry,
    heartbeat: Entry,
    time_s: Entry,
    latch_time_s: Entry,
    /// If present, such a table lists all axes of the window.
    latch: Option<BTreeMap<Axis, Entry>>,
    position: Option<BTreeMap<Axis, Entry>>,
    sequence_tail: Entry,
    result: Option<ResultKeys>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct ResultKeys {
    under_way: Entry,
    sequence: Entry,
    row: Entry,
    contact: Entry,
    valid: Entry,
}

/// Default addresses of a window.
struct DefaultAddresses {
    chunk: u16,
    tail: u16,
}

const LINE_WINDOW_DEFAULTS: DefaultAddresses = DefaultAddresses { chunk: 100, tail: 44 };
const PROGRAM_WINDOW_DEFAULTS: DefaultAddresses = DefaultAddresses { chunk: 328, tail: 49 };

const AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
const LATCH: u16 = 20;
const POSITION: u16 = 32;
/// Default scale of positions, mm or degrees.
const STEP: f64 = 0.001;

impl Entry {
    pub(in super::super) fn at(self, address: u16, kind: Kind) -> Register {
        let number = Number {
            kind: self.kind.unwrap_or(kind),
            order: self.order.unwrap_or_default(),
            scale: self.scale.unwrap_or(1.0),
        };
        Register { address: self.address.unwrap_or(address), number }
    }

    /// Sets the scale, unless the keys give one.
    pub(in super::super) fn scaled(self, scale: f64) -> Self {
        Self { scale: self.scale.or(Some(scale)), ..self }
    }

    fn of_axis(self, address: u16) -> Register {
        self.scaled(STEP).at(address, Kind::I32)
    }
}

fn axes(
    name: &str,
    keys: Option<BTreeMap<Axis, Entry>>,
    first: u16,
) -> Result<BTreeMap<Axis, Register>, String> {
    let Some(keys) = keys else {
        let places = AXES.into_iter().zip((first..).step_by(2));
        return Ok(places.map(|(axis, place)| (axis, Entry::default().of_axis(place))).collect());
    };
    let register = |(axis, entry): (Axis, Entry)| match entry.address {
        Some(address) => Ok((axis, entry.of_axis(address))),
        None => Err(format!("`status.{name}.{axis}` needs an `address`")),
    };
    keys.into_iter().map(register).collect()
}

impl TryFrom<Keys> for Map {
    type Error = String;

    fn try_from(Keys { command, status }: Keys) -> Result<Self, String> {
        if status.result.is_some() {
            return Err(
                "`status.result` belongs to a resident program: write [controller.program], \
                        or remove it"
                    .to_owned(),
            );
        }
        let map = Self {
            command: command.at(&LINE_WINDOW_DEFAULTS),
            status: status.at(&LINE_WINDOW_DEFAULTS)?,
        };
        check::map(&map)?;
        Ok(map)
    }
}

impl Keys {
    /// Returns the map of the window to a resident program.
    ///
    /// # Errors
    /// The map is invalid; the message names the items.
    pub(in super::super) fn of_program(self) -> Result<Map, String> {
        let Self { command, mut status } = self;
        let result = status.result.take().unwrap_or_default();
        let mut map = Map {
            command: command.at(&PROGRAM_WINDOW_DEFAULTS),
            status: status.at(&PROGRAM_WINDOW_DEFAULTS)?,
        };
        map.status.result = Some(result.registers());
        check::map(&map)?;
        Ok(map)
    }
}

impl CommandKeys {
    fn at(self, usual: &DefaultAddresses) -> Command {
        Command {
            hold: self.hold.at(0, Kind::U16),
            sequence: self.sequence.at(1, Kind::U16),
            heartbeat: self.heartbeat.at(2, Kind::U16),
            acknowledge: self.acknowledge.at(3, Kind::U16),
            crc: self.crc.at(4, Kind::U16),
            length: self.length.at(5, Kind::U16),
            chunk: Chunk {
                address: self.chunk.address.unwrap_or(6),
                registers: self.chunk.registers.unwrap_or(usual.chunk),
                order: self.chunk.order.unwrap_or_default(),
            },
        }
    }
}

impl ResultKeys {
    fn registers(self) -> Results {
        Results {
            under_way: self.under_way.at(44, Kind::U16),
            sequence: self.sequence.at(45, Kind::U16),
            row: self.row.at(46, Kind::U16),
            contact: self.contact.at(47, Kind::U16),
            valid: self.valid.at(48, Kind::U16),
        }
    }
}

impl StatusKeys {
    fn at(self, usual: &DefaultAddresses) -> Result<Status, String> {
        Ok(Status {
            space: self.space.unwrap_or(Space::Input),
            sequence_head: self.sequence_head.at(0, Kind::U16),
            version: self.version.at(1, Kind::U16),
            state: self.state.at(2, Kind::U16),
            alarm: self.alarm.at(3, Kind::U16),
            accepted: self.accepted.at(4, Kind::U16),
            executed: self.executed.at(5, Kind::U16),
            error: self.error.at(6, Kind::U16),
            probe: self.probe.at(7, Kind::U16),
            inputs: self.inputs.at(8, Kind::U32),
            latches: self.latches.at(10, Kind::U16),
            heartbeat: self.heartbeat.at(11, Kind::U16),
            time_s: self.time_s.at(12, Kind::F64),
            latch_time_s: self.latch_time_s.at(16, Kind::F64),
            latch: axes("latch", self.latch, LATCH)?,
            position: axes("position", self.position, POSITION)?,
            sequence_tail: self.sequence_tail.at(usual.tail, Kind::U16),
            result: None,
        })
    }
}
