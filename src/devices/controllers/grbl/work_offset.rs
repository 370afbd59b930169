//! Reads a work offset from the answer to `$#`, and sets it by `G10 L2`. Nothing moves.

use super::driver::GrblDriver;
use super::fault::not_ready_error;
use super::message::GrblMessage;
use crate::controllers::work_offset::{check_no_other_shift, set_offset_block};
use crate::controllers::{ControllerError, WorkOffset, WorkOffsetSlot};
use machine::Axis;

/// Decimals of mm in reports (N_DECIMAL_COORDVALUE_MM of grblHAL `grbl.h`).
const REPORT_DECIMALS: i32 = 3;
/// Modal word for programs in inches.
const INCH_WORD: &str = "G20";

impl GrblDriver {
    pub(super) async fn read_offset_slot(&mut self, slot: WorkOffsetSlot) -> Result<WorkOffset, ControllerError> {
        let modes = self.read_modal_words_at_rest().await?;
        let offsets = self.connection.send_line("$#").await?;
        work_offset_from_reports(slot, &self.axes_in_report_order, &modes, &offsets)
    }

    /// `G10 L2` is absolute in G90 and in G91 (grblHAL `gcode.c`).
    pub(super) async fn set_offset_slot(
        &mut self,
        slot: WorkOffsetSlot,
        zero_mm: &[(Axis, f64)],
    ) -> Result<(), ControllerError> {
        self.read_modal_words_at_rest().await?;
        self.connection.send_line(&set_offset_block(slot, zero_mm)).await.map(drop)
    }

    /// Modal words of a control that is idle and reports in mm; ends a preparation.
    async fn read_modal_words_at_rest(&mut self) -> Result<Vec<String>, ControllerError> {
        self.is_prepared = false;
        let status = self.connection.synchronize_and_read_status().await?;
        if status.state != "Idle" {
            return Err(not_ready_error(&status));
        }
        self.check_firmware_axes().await?;
        if self.read_settings().await?.has_bit(13, 1) {
            return Err(ControllerError::not_ready(
                "the control reports positions in inches ($13=1)",
                "enter $13=0 at the control",
            ));
        }
        let answer = self.connection.send_line("$G").await?;
        let words = answer.into_iter().find_map(|message| match message {
            GrblMessage::ModalWords(words) => Some(words),
            _ => None,
        });
        let words: Vec<String> = words.ok_or_else(|| ControllerError::UnreadableReply { text: "$G".to_owned() })?;
        if words.iter().any(|word| word == INCH_WORD) {
            return Err(ControllerError::not_ready("programs are in inches (G20)", "enter G21 at the control"));
        }
        Ok(words)
    }
}

/// The offset of `slot` from the answers to `$G` and `$#`.
fn work_offset_from_reports(
    slot: WorkOffsetSlot,
    axes: &[Option<Axis>],
    modes: &[String],
    offsets: &[GrblMessage],
) -> Result<WorkOffset, ControllerError> {
    let reported = |wanted: &str| {
        offsets.iter().find_map(|message| match message {
            GrblMessage::Offset { name, values } if name == wanted && values.len() >= axes.len() => {
                Some(values.split_at(axes.len()))
            }
            _ => None,
        })
    };
    let missing = |name: &str| ControllerError::UnreadableReply { text: format!("$# without {name}") };
    let (zero, rotation) = reported(slot.name()).ok_or_else(|| missing(slot.name()))?;
    let (g92, _) = reported("G92").ok_or_else(|| missing("G92"))?;
    let rotation_deg = rotation.first().copied().unwrap_or_default();
    check_no_other_shift(slot, g92.iter().any(|value| *value != 0.0), rotation_deg)?;
    if modes.iter().any(|word| word == "G68") {
        return Err(ControllerError::not_ready("coordinates are rotated (G68)", "enter G69 at the control"));
    }
    let named = axes.iter().zip(zero).filter_map(|(axis, value)| Some(((*axis)?, *value)));
    let (zero_mm, rotary_deg) = named.partition(|(axis, _)| axis.is_linear());
    Ok(WorkOffset {
        zero_mm,
        rotary_deg,
        decimals: REPORT_DECIMALS,
        is_selected: modes.iter().any(|word| word == slot.name()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: [Option<Axis>; 4] = [Some(Axis::X), Some(Axis::Y), None, Some(Axis::C)];

    fn read(slot: &str, modes: &[&str], lines: &[&str]) -> Result<WorkOffset, ControllerError> {
        let modes: Vec<String> = modes.iter().map(|word| (*word).to_owned()).collect();
        let offsets: Vec<GrblMessage> = lines.iter().map(|line| GrblMessage::parse(line)).collect();
        work_offset_from_reports(slot.parse().unwrap(), &AXES, &modes, &offsets)
    }

    #[test]
    fn offset_of_the_slot_is_read() {
        let lines =
            ["[G54:1.000,2.000,3.000,4.000]", "[G55:-149.950,0.125,7.000,90.000]", "[G92:0.000,0.000,0.000,0.000]"];
        let offset = read("G55", &["G55", "G21"], &lines).unwrap();
        assert_eq!(offset.zero_mm, [(Axis::X, -149.95), (Axis::Y, 0.125)]);
        assert!(offset.is_selected && !read("G54", &["G55", "G21"], &lines).unwrap().is_selected);
        assert!(read("G56", &["G54"], &lines).is_err());
    }

    #[test]
    fn shifted_or_rotated_coordinates_are_refused() {
        let no_g92 = "[G92:0.000,0.000,0.000,0.000]";
        for (slot_line, g92_line, modes, expected) in [
            ("[G55:1.000,2.000,3.000,4.000]", "[G92:0.000,0.000,0.001,0.000]", "G54", "G92"),
            ("[G55:1.000,2.000,3.000,4.000:5.00]", no_g92, "G54", "rotated by 5°"),
            ("[G55:1.000,2.000,3.000,4.000]", no_g92, "G68", "G68"),
        ] {
            let error = read("G55", &[modes], &[slot_line, g92_line]).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(read("G55", &["G54"], &["[G55:1.000,2.000,3.000,4.000:0.00]", no_g92]).is_ok());
    }
}
