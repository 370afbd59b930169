//! Work offsets: the slots that G54 to G59.3 select. `G10 L2` sets them; it moves no axis.

use std::fmt;
use std::str::FromStr;

use serde::Deserialize;

use super::ControllerError;
use machine::Axis;

/// Names of the slots in the order of their P numbers in `G10 L2`, from 1.
const SLOT_NAMES: [&str; 9] = ["G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"];

/// A slot of a work offset, in the order of the P numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(try_from = "String")]
pub struct WorkOffsetSlot {
    /// Index in `SLOT_NAMES`, from 0: the P number less 1.
    index: usize,
}

impl WorkOffsetSlot {
    /// All slots in the order of their P numbers.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..SLOT_NAMES.len()).map(|index| Self { index })
    }

    /// The word that selects the slot, e.g. `G55`.
    pub fn name(self) -> &'static str {
        SLOT_NAMES.get(self.index).copied().unwrap_or_default()
    }

    /// P of the slot in `G10 L2`, from 1.
    pub(super) fn p_number(self) -> usize {
        self.index + 1
    }
}

impl FromStr for WorkOffsetSlot {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let slot = Self::all().find(|slot| slot.name() == name);
        slot.ok_or_else(|| format!("`{name}` is no work offset; known are {}", SLOT_NAMES.join(", ")))
    }
}

impl TryFrom<String> for WorkOffsetSlot {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        name.parse()
    }
}

impl fmt::Display for WorkOffsetSlot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A work offset as the control holds it, without G92 and rotation.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkOffset {
    /// Zero of the slot on the linear axes of the control, machine coordinates, mm.
    pub zero_mm: Vec<(Axis, f64)>,
    /// Zero of the slot on the rotary axes of the control, degrees.
    pub rotary_deg: Vec<(Axis, f64)>,
    /// Decimals of mm in which the control states the values.
    pub decimals: i32,
    /// Whether the slot is the one that the control uses now.
    pub is_selected: bool,
}

/// Refuses a slot whose zero the control displaces by G92 or rotates.
pub(super) fn check_no_other_shift(
    slot: WorkOffsetSlot,
    has_g92: bool,
    rotation_deg: f64,
) -> Result<(), ControllerError> {
    if has_g92 {
        return Err(ControllerError::not_ready(
            "an offset by G92 is active: it displaces the zero of each work offset",
            "enter G92.1 at the control, check the zero of the workpiece, then try again",
        ));
    }
    if rotation_deg != 0.0 {
        return Err(ControllerError::not_ready(
            format!("the coordinates of {slot} are rotated by {rotation_deg}°"),
            format!("enter G10 L2 P{} R0 at the control, or name another slot, then try again", slot.p_number()),
        ));
    }
    Ok(())
}

/// The block that sets the zero of `slot` on the axes of `zero_mm`. Other axes keep their values.
pub(super) fn set_offset_block(slot: WorkOffsetSlot, zero_mm: &[(Axis, f64)]) -> String {
    let words: String = zero_mm.iter().map(|(axis, mm)| format!(" {axis}{mm}")).collect();
    format!("G10 L2 P{}{words}", slot.p_number())
}

/// Error of a control without this operation.
pub(super) fn unsupported_error() -> ControllerError {
    ControllerError::UnsupportedByControl {
        reason: "its work offsets can be neither read nor written".to_owned(),
        remedy: "remove [compensation.work-offset]; enter the values of `trued compensate sheet` by hand".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slot_names_have_the_p_numbers_of_g10() {
        let numbers = [("G54", 1), ("G55", 2), ("G59", 6), ("G59.1", 7), ("G59.3", 9)];
        for (name, p_number) in numbers {
            let slot: WorkOffsetSlot = name.parse().unwrap();
            assert_eq!((slot.p_number(), slot.to_string()), (p_number, name.to_owned()));
        }
        for name in ["G53", "g55", "55", "G59.4", ""] {
            assert!(name.parse::<WorkOffsetSlot>().is_err(), "{name}");
        }
    }

    #[test]
    fn block_has_only_the_axes_that_change() {
        let slot = "G59.1".parse().unwrap();
        let block = set_offset_block(slot, &[(Axis::X, -149.95), (Axis::Z, 0.00001)]);
        assert_eq!(block, "G10 L2 P7 X-149.95 Z0.00001");
    }

    #[test]
    fn other_shifts_of_the_zero_are_refused() {
        let slot = "G55".parse().unwrap();
        assert!(check_no_other_shift(slot, false, 0.0).is_ok());
        let g92 = check_no_other_shift(slot, true, 0.0).unwrap_err();
        assert!(g92.to_string().contains("G92") && g92.remedy().contains("G92.1"), "{g92}");
        let rotation = check_no_other_shift(slot, false, 5.0).unwrap_err();
        assert!(rotation.to_string().contains("rotated by 5°") && rotation.remedy().contains("P2 R0"), "{rotation}");
    }
}
