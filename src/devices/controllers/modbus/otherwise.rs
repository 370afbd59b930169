//! Reads the same registers with other settings: another word order, type, scale or address. If the values
//! then make sense, a suspicion names the one setting that would have to be changed.

use super::map::{Map, Register, Results, Status as Places};
use super::status::Status;
use crate::controllers::Diagnosis;
use link::modbus::Space;
use link::modbus::value::{Kind, Number, Order};
use machine::Axis;
use machine::record::machine::Machine;

const ORDERS: [Order; 4] = [Order::Abcd, Order::Cdab, Order::Badc, Order::Dcba];
const SCALES: [f64; 7] = [1.0, 0.1, 0.01, 0.001, 0.0001, 0.00001, 0.000001];
/// Largest distance of an axis beyond the travel of the machine file, mm or degrees.
pub(super) const TRAVEL_MARGIN: f64 = 1.0;
/// Smallest magnitude of a plausible position other than zero, mm or degrees.
const MIN_POSITION: f64 = 1e-4;
const MISREAD_INTEGER_LIMIT: f64 = 1e-20;

/// Another setting with which the positions can be read.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Change {
    Order(Order),
    Kind(Kind),
    Scale(f64),
}

impl Change {
    fn of(self, number: Number) -> Number {
        match self {
            Self::Order(order) => Number { order, ..number },
            Self::Kind(kind) => Number { kind, ..number },
            Self::Scale(scale) => Number { scale, ..number },
        }
    }

    /// Returns the mistake, and the key to write.
    fn words(self, from: Number) -> (String, String) {
        let small = |text: String| text.to_lowercase();
        match self {
            Self::Order(order) => {
                ("wrong word order".to_owned(), small(format!("order = \"{order:?}\"")))
            }
            Self::Kind(kind) => {
                let signs = kind.is_float() == from.kind.is_float();
                let what = if signs { "wrong signedness" } else { "wrong type" };
                (what.to_owned(), small(format!("type = \"{kind:?}\"")))
            }
            Self::Scale(scale) => ("wrong scale".to_owned(), format!("scale = {scale} or less")),
        }
    }
}

/// Whether `value` is a small whole number read as floating point: its magnitude is far below that of any
/// position.
pub(super) fn is_no_position(value: f64) -> bool {
    value != 0.0 && value.abs() < MISREAD_INTEGER_LIMIT
}

/// Whether the positions in `block` are possible for `machine`: each within its travel.
pub(super) fn fits(map: &Map, block: &[u16], machine: &Machine) -> bool {
    positions(&map.status, block, machine, None)
        .is_some_and(|positions| within(&positions, machine))
}

/// Suspected causes, one for each single change that would bring all axes into their travel.
pub(super) fn suspects(map: &Map, block: &[u16], machine: &Machine) -> Vec<Diagnosis> {
    let Some(number) = map.status.position.values().next().map(|register| register.number) else {
        return Vec::new();
    };
    let kinds = number.kind.others();
    let orders = ORDERS.into_iter().filter(|order| *order != number.order).map(Change::Order);
    let scales = SCALES.into_iter().filter(|scale| *scale != number.scale).map(Change::Scale);
    let changes = orders.chain(kinds.iter().copied().map(Change::Kind)).chain(scales);
    let mut told: Vec<(Change, Vec<(Axis, f64)>)> = Vec::new();
    for change in changes {
        let Some(positions) = positions(&map.status, block, machine, Some(change)) else {
            continue;
        };
        let real = positions.iter().any(|(_, value)| value.abs() >= MIN_POSITION)
            && positions.iter().all(|(_, value)| *value == 0.0 || value.abs() >= MIN_POSITION);
        // Among the scales that fit, the largest represents all; among types with the same result, the
        // first.
        let scaled =
            |other: &Change| matches!((other, change), (Change::Scale(_), Change::Scale(_)));
        let known = told.iter().any(|(other, same)| scaled(other) || *same == positions);
        if real && !known && within(&positions, machine) {
            told.push((change, positions));
        }
    }
    told.iter().map(|(change, positions)| suspicion(*change, number, positions)).collect()
}

fn suspicion(change: Change, number: Number, positions: &[(Axis, f64)]) -> Diagnosis {
    let (what, key) = change.words(number);
    let stands: Vec<String> =
        positions.iter().map(|(axis, value)| format!("{axis} {value:.3}")).collect();
    Diagnosis {
        seen: false,
        vague: false,
        what: format!("{what} of the positions"),
        because: format!("with {key} every axis stands within its travel: {}", stands.join(", ")),
        remedy: format!(
            "if the control's display shows these positions: {key} in each axis of \
             [controller.registers.status.position] and .latch"
        ),
    }
}

/// Position of each axis of `machine` according to `block`, mm and degrees.
fn positions(
    places: &Places,
    block: &[u16],
    machine: &Machine,
    change: Option<Change>,
) -> Option<Vec<(Axis, f64)>> {
    let first = places.sequence_head.address;
    let axes = machine.axes.keys().filter(|axis| **axis != Axis::S);
    let value = |axis: &Axis| {
        let Register { address, number } = *places.position.get(axis)?;
        let number = change.map_or(number, |change| change.of(number));
        let value = Register { address, number }.read(block, first).ok()?;
        Some((*axis, value))
    };
    axes.map(value).collect()
}

fn within(positions: &[(Axis, f64)], machine: &Machine) -> bool {
    positions.iter().all(|(axis, value)| {
        if is_no_position(*value) {
            return false;
        }
        let travel = machine.axes.get(axis);
        travel.is_none_or(|spec| {
            (spec.min - TRAVEL_MARGIN..=spec.max + TRAVEL_MARGIN).contains(value)
        })
    })
}

/// Other locations of the status that are tried: shift in registers, and whether in the other space.
pub(super) const STATUS_SHIFTS: [(i16, bool); 5] =
    [(-1, false), (1, false), (0, true), (-1, true), (1, true)];

/// Returns the map with its status shifted by `by` registers, and in the other space if `other`.
pub(super) fn moved(map: &Map, by: i16, other: bool) -> Option<Map> {
    let mut map = map.clone();
    let status = &mut map.status;
    if other {
        status.space = if status.space == Space::Input { Space::Holding } else { Space::Input };
    }
    let counts = [
        &mut status.sequence_head,
        &mut status.version,
        &mut status.state,
        &mut status.alarm,
        &mut status.accepted,
        &mut status.executed,
        &mut status.error,
        &mut status.probe,
        &mut status.inputs,
        &mut status.latches,
        &mut status.heartbeat,
        &mut status.time_s,
        &mut status.latch_time_s,
        &mut status.sequence_tail,
    ];
    let axes = status.latch.values_mut().chain(status.position.values_mut());
    let results = status.result.iter_mut().flat_map(Results::items_mut);
    for register in counts.into_iter().chain(axes).chain(results) {
        register.address = register.address.checked_add_signed(by)?;
    }
    Some(map)
}

/// Whether `block` is a valid status according to `map`.
pub(super) fn is_status(map: &Map, block: &[u16]) -> bool {
    matches!(Status::read(map, block), Ok(Some(_)))
}

/// Suspected cause if the status was found with [`moved`].
pub(super) fn elsewhere(map: &Map, by: i16, other: bool) -> Diagnosis {
    let space = if map.status.space == Space::Input { "input" } else { "holding" };
    let what = match (by, other) {
        (0, _) => format!("wrong space: the status lies in the {space} registers"),
        (_, false) => {
            format!("addresses off by one: the status lies {by:+} register from where it is read")
        }
        (_, true) => format!("wrong space and addresses off by one: {space} registers, {by:+}"),
    };
    let (first, _) = map.status.block();
    let keys = match (by, other) {
        (0, _) => format!("[controller.registers.status] space = \"{space}\""),
        (_, other) => format!(
            "{}{by:+} to every address of [controller.registers.status] (many manuals count from 1, here \
             they count from 0)",
            if other { format!("space = \"{space}\", and ") } else { String::new() }
        ),
    };
    Diagnosis {
        seen: true,
        vague: false,
        what,
        because: format!(
            "read from {space} register {first} on, head, tail, version and state agree"
        ),
        remedy: format!("in the machine file: {keys}"),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn machine() -> Machine {
        serde_json::from_value(json!({
            "name": "bench", "topology": "w-C-B-X-F-Z-Y-S-t",
            "axes": {"X": {"min": -400, "max": 400}, "Z": {"min": 30, "max": 760}, "C": {"min": -360, "max": 360}}
        }))
        .unwrap()
    }

    /// The published window with other keys for the positions.
    fn map(keys: &str) -> Map {
        let axis = |(axis, at): (&str, u16)| format!("{axis} = {{ address = {at}, {keys} }}");
        let axes = [("X", 32), ("Z", 36), ("C", 42)].map(axis).join(", ");
        toml::from_str(&format!("[status]\nposition = {{ {axes} }}")).unwrap()
    }

    /// X -12.5, Z 100, C 45, as a control with the published window stores them.
    fn block() -> Vec<u16> {
        let mut block = vec![0; 45];
        for (at, steps) in [(32, -12_500_i32), (36, 100_000), (42, 45_000)] {
            let bits = steps as u32;
            (block[at], block[at + 1]) = ((bits >> 16) as u16, bits as u16);
        }
        block
    }

    #[test]
    fn one_thing_that_is_read_wrongly_is_named() {
        assert!(fits(&map("type = \"i32\""), &block(), &machine()));
        for (wrong, named, right) in [
            ("order = \"cdab\"", "wrong word order", "order = \"abcd\""),
            ("order = \"dcba\"", "wrong word order", "order = \"abcd\""),
            ("type = \"u32\"", "wrong signedness", "type = \"i32\""),
            ("type = \"f32\"", "wrong type", "type = \"i32\""),
            ("scale = 0.1", "wrong scale", "scale = 0.001"),
        ] {
            let map = map(wrong);
            assert!(!fits(&map, &block(), &machine()), "{wrong}");
            let told = suspects(&map, &block(), &machine());
            let first = told.first().unwrap_or_else(|| panic!("{wrong}: nothing"));
            assert!(first.what.starts_with(named), "{wrong}: {told:?}");
            assert!(told.iter().any(|told| told.remedy.contains(right)), "{wrong}: {told:?}");
            assert!(told.iter().all(|told| !told.seen));
        }
    }

    #[test]
    fn what_lies_at_other_addresses_is_recognised() {
        let published: Map = toml::from_str("").unwrap();
        let mut block = block();
        (block[0], block[1], block[2], block[44]) = (7, 1, 1, 7);
        assert!(is_status(&published, &block));
        let later = moved(&published, 1, false).unwrap();
        assert_eq!(later.status.block(), (1, 45));
        assert!(!is_status(&published, &[&[0], &block[..44]].concat()));
        assert!(moved(&published, -1, false).is_none());
        assert_eq!(moved(&published, 0, true).unwrap().status.space, Space::Holding);
    }
}
