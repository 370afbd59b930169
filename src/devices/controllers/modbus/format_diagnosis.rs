//! Reads the same registers with other settings: another word order, type, scale or address. If the values are then
//! plausible, a suspected cause names the one setting to change.

use super::map::{Register, StatusRegisters, WindowRegisterMap};
use super::status::WindowStatus;
use crate::controllers::PossibleCause;
use link::modbus::RegisterSpace;
use link::modbus::number_format::{ByteOrder, NumberFormat, NumberType};
use machine::Axis;
use machine::record::machine::Machine;

/// Orders of words and bytes that are tried, except the configured one.
const WORD_ORDERS: [ByteOrder; 4] = [ByteOrder::Abcd, ByteOrder::Cdab, ByteOrder::Badc, ByteOrder::Dcba];
/// Scales of positions that are tried, mm or degrees per count; the largest that fits is reported.
const SCALE_CANDIDATES: [f64; 7] = [1.0, 0.1, 0.01, 0.001, 0.0001, 0.00001, 0.000001];
/// Distance beyond either end of the travel of the machine file up to which a position is plausible, mm or degrees.
pub(super) const TRAVEL_MARGIN_MM_OR_DEG: f64 = 1.0;
/// Smallest magnitude of a plausible position other than zero, mm or degrees.
const MIN_PLAUSIBLE_NONZERO_POSITION_MM_OR_DEG: f64 = 1e-4;
/// A smaller magnitude other than zero, in mm or degrees, is a whole number that was read as floating point.
const MAX_MISREAD_INTEGER_MAGNITUDE: f64 = 1e-20;

/// A setting, other than the configured one, with which the positions are read for a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
enum FormatChange {
    Order(ByteOrder),
    NumberType(NumberType),
    /// Size of one count, mm or degrees.
    Scale(f64),
}

impl FormatChange {
    fn apply(self, number: NumberFormat) -> NumberFormat {
        match self {
            Self::Order(order) => NumberFormat { order, ..number },
            FormatChange::NumberType(number_type) => NumberFormat { number_type, ..number },
            Self::Scale(scale) => NumberFormat { scale, ..number },
        }
    }

    /// Returns the mistake, and the key to write.
    fn mistake_and_key_to_write(self, from: NumberFormat) -> (String, String) {
        let lowercase = |text: String| text.to_lowercase();
        match self {
            Self::Order(order) => ("wrong word order".to_owned(), lowercase(format!("order = \"{order:?}\""))),
            FormatChange::NumberType(kind) => {
                let is_same_class = kind.is_float() == from.number_type.is_float();
                let cause = if is_same_class { "wrong signedness" } else { "wrong type" };
                (cause.to_owned(), lowercase(format!("type = \"{kind:?}\"")))
            }
            Self::Scale(scale) => ("wrong scale".to_owned(), format!("scale = {scale} or less")),
        }
    }
}

/// Whether `value` is a small whole number read as floating point: its magnitude is far below that of any
/// position.
pub(super) fn is_misread_integer(value: f64) -> bool {
    value != 0.0 && value.abs() < MAX_MISREAD_INTEGER_MAGNITUDE
}

/// Whether the positions in `block` are possible for `machine`: each is within its travel plus
/// `TRAVEL_MARGIN_MM_OR_DEG`, and none is a misread integer. `false` if an axis without the spindle has no readable
/// position.
pub(super) fn are_positions_plausible(map: &WindowRegisterMap, block: &[u16], machine: &Machine) -> bool {
    read_positions(&map.status, block, machine, None).is_some_and(|positions| are_within_travel(&positions, machine))
}

/// Suspected causes, one for each single change that would bring all axes into their travel; of several scales only the
/// largest. Empty if all positions are zero: zero fits every format.
pub(super) fn diagnose_position_format(
    map: &WindowRegisterMap,
    block: &[u16],
    machine: &Machine,
) -> Vec<PossibleCause> {
    let Some(number) = map.status.position.values().next().map(|register| register.number_format) else {
        return Vec::new();
    };
    let kinds = number.number_type.same_size_types();
    let orders = WORD_ORDERS.into_iter().filter(|order| *order != number.order).map(FormatChange::Order);
    let scales = SCALE_CANDIDATES.into_iter().filter(|scale| *scale != number.scale).map(FormatChange::Scale);
    let changes = orders.chain(kinds.iter().copied().map(FormatChange::NumberType)).chain(scales);
    let mut candidates: Vec<(FormatChange, Vec<(Axis, f64)>)> = Vec::new();
    for change in changes {
        let Some(positions) = read_positions(&map.status, block, machine, Some(change)) else { continue };
        let nonzero: Vec<f64> = positions.iter().map(|(_, value)| value.abs()).filter(|value| *value != 0.0).collect();
        let is_plausible =
            !nonzero.is_empty() && nonzero.iter().all(|value| *value >= MIN_PLAUSIBLE_NONZERO_POSITION_MM_OR_DEG);
        // Among the scales that fit, the largest represents all; among types with the same result, the
        // first.
        let is_scale_again =
            |earlier: &FormatChange| matches!((earlier, change), (FormatChange::Scale(_), FormatChange::Scale(_)));
        let is_duplicate = candidates.iter().any(|(earlier, same)| is_scale_again(earlier) || *same == positions);
        if is_plausible && !is_duplicate && are_within_travel(&positions, machine) {
            candidates.push((change, positions));
        }
    }
    candidates.iter().map(|(change, positions)| format_change_diagnosis(*change, number, positions)).collect()
}

fn format_change_diagnosis(change: FormatChange, number: NumberFormat, positions: &[(Axis, f64)]) -> PossibleCause {
    let (cause, key) = change.mistake_and_key_to_write(number);
    let position_list: Vec<String> = positions.iter().map(|(axis, value)| format!("{axis} {value:.3}")).collect();
    PossibleCause::suspected(
        format!("{cause} of the positions"),
        format!("with {key} every axis is within its travel: {}", position_list.join(", ")),
        format!(
            "if the control's display shows these positions: {key} in each axis of \
             [controller.registers.status.position] and .latch"
        ),
    )
}

/// Position of each axis of `machine` without the spindle, mm and degrees, read from `block` with `change` if there
/// is one; `None` if an axis has no register or no readable value.
fn read_positions(
    registers: &StatusRegisters,
    block: &[u16],
    machine: &Machine,
    change: Option<FormatChange>,
) -> Option<Vec<(Axis, f64)>> {
    let first = registers.sequence_head.address;
    let axes = machine.axes.keys().filter(|axis| **axis != Axis::S);
    let value = |axis: &Axis| {
        let Register { address, number_format } = *registers.position.get(axis)?;
        let number = change.map_or(number_format, |change| change.apply(number_format));
        let value = Register { address, number_format: number }.decode_from_block(block, first).ok()?;
        Some((*axis, value))
    };
    axes.map(value).collect()
}

/// Whether each position is within its axis's travel plus [`TRAVEL_MARGIN_MM_OR_DEG`], and none is a misread integer.
fn are_within_travel(positions: &[(Axis, f64)], machine: &Machine) -> bool {
    positions.iter().all(|(axis, value)| {
        if is_misread_integer(*value) {
            return false;
        }
        let travel = machine.axes.get(axis);
        travel.is_none_or(|spec| {
            (spec.min - TRAVEL_MARGIN_MM_OR_DEG..=spec.max + TRAVEL_MARGIN_MM_OR_DEG).contains(value)
        })
    })
}

/// Registers that are read as a status, perhaps at another address or in another space than the configured ones.
pub(super) struct StatusRegisterRange {
    pub space: RegisterSpace,
    pub first: u16,
    pub count: u16,
}

/// Locations of the status, different from the declared one, that are tried: shift in registers, and
/// whether in the other space.
pub(super) const STATUS_SHIFT_CANDIDATES: [(i16, bool); 5] =
    [(-1, false), (1, false), (0, true), (-1, true), (1, true)];

/// Space, first register and number of registers of a status that is shifted by `shift` registers, and in the other
/// space if `in_other_space`; `None` if its first address is not from 0 to 65535.
pub(super) fn shifted_status_range(
    status: &StatusRegisters,
    shift: i16,
    in_other_space: bool,
) -> Option<StatusRegisterRange> {
    let (first, count) = status.block_first_and_count();
    let space = match (in_other_space, status.space) {
        (false, space) => space,
        (true, RegisterSpace::Input) => RegisterSpace::Holding,
        (true, _) => RegisterSpace::Input,
    };
    Some(StatusRegisterRange { space, first: first.checked_add_signed(shift)?, count })
}

/// Whether `block` is a valid status according to `map`: equal head and tail, the expected version, a known state,
/// readable numbers.
pub(super) fn is_valid_status(map: &WindowRegisterMap, block: &[u16]) -> bool {
    matches!(WindowStatus::parse(map, block), Ok(Some(_)))
}

/// Cause if the status was found at `block`, which is a [`shifted_status_range`].
pub(super) fn shifted_status_diagnosis(block: &StatusRegisterRange, shift: i16, in_other_space: bool) -> PossibleCause {
    let (space, first) = (block.space, block.first);
    let space = if space == RegisterSpace::Input { "input" } else { "holding" };
    let cause = match (shift, in_other_space) {
        (0, _) => format!("wrong space: the status is in the {space} registers"),
        (_, false) => {
            format!("addresses off by one: the status begins {shift:+} register from the configured address")
        }
        (_, true) => format!("wrong space and addresses off by one: {space} registers, {shift:+}"),
    };
    let keys = match (shift, in_other_space) {
        (0, _) => format!("[controller.registers.status] space = \"{space}\""),
        (_, in_other_space) => format!(
            "{}{shift:+} to every address of [controller.registers.status] (many manuals count from 1, the \
             machine file counts from 0)",
            if in_other_space { format!("space = \"{space}\", and ") } else { String::new() }
        ),
    };
    PossibleCause::observed(
        cause,
        format!("read from {space} register {first} on, head, tail, version and state agree"),
        format!("in the machine file: {keys}"),
    )
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn machine_with_three_axes() -> Machine {
        serde_json::from_value(json!({
            "name": "bench", "topology": "w-C-B-X-F-Z-Y-S-t",
            "axes": {"X": {"min": -400, "max": 400}, "Z": {"min": 30, "max": 760}, "C": {"min": -360, "max": 360}}
        }))
        .unwrap()
    }

    /// The published window with other keys for the positions.
    fn map_with_position_keys(keys: &str) -> WindowRegisterMap {
        let axis = |(axis, at): (&str, u16)| format!("{axis} = {{ address = {at}, {keys} }}");
        let axes = [("X", 32), ("Z", 36), ("C", 42)].map(axis).join(", ");
        toml::from_str(&format!("[status]\nposition = {{ {axes} }}")).unwrap()
    }

    /// X -12.5, Z 100, C 45, as a control with the published window stores them.
    fn status_block_words() -> Vec<u16> {
        let mut block = vec![0; 45];
        for (at, steps) in [(32, -12_500_i32), (36, 100_000), (42, 45_000)] {
            let bits = steps as u32;
            (block[at], block[at + 1]) = ((bits >> 16) as u16, bits as u16);
        }
        block
    }

    #[test]
    fn single_wrong_format_is_identified() {
        assert!(are_positions_plausible(
            &map_with_position_keys("type = \"i32\""),
            &status_block_words(),
            &machine_with_three_axes()
        ));
        for (wrong, named, right) in [
            ("order = \"cdab\"", "wrong word order", "order = \"abcd\""),
            ("order = \"dcba\"", "wrong word order", "order = \"abcd\""),
            ("type = \"u32\"", "wrong signedness", "type = \"i32\""),
            ("type = \"f32\"", "wrong type", "type = \"i32\""),
            ("scale = 0.1", "wrong scale", "scale = 0.001"),
        ] {
            let map = map_with_position_keys(wrong);
            assert!(!are_positions_plausible(&map, &status_block_words(), &machine_with_three_axes()), "{wrong}");
            let candidates = diagnose_position_format(&map, &status_block_words(), &machine_with_three_axes());
            let first = candidates.first().unwrap_or_else(|| panic!("{wrong}: nothing"));
            assert!(first.cause.starts_with(named), "{wrong}: {candidates:?}");
            assert!(candidates.iter().any(|candidate| candidate.remedy.contains(right)), "{wrong}: {candidates:?}");
            assert!(candidates.iter().all(|candidate| !candidate.is_observed));
        }
    }

    #[test]
    fn shifted_status_is_invalid_and_its_range_is_computed() {
        let published: WindowRegisterMap = toml::from_str("").unwrap();
        let mut block = status_block_words();
        (block[0], block[1], block[2], block[44]) = (7, 1, 1, 7);
        assert!(is_valid_status(&published, &block));
        let later = shifted_status_range(&published.status, 1, false).unwrap();
        assert_eq!((later.space, later.first, later.count), (RegisterSpace::Input, 1, 45));
        assert!(!is_valid_status(&published, &[&[0], &block[..44]].concat()));
        assert!(shifted_status_range(&published.status, -1, false).is_none());
        assert_eq!(shifted_status_range(&published.status, 0, true).unwrap().space, RegisterSpace::Holding);
    }
}
