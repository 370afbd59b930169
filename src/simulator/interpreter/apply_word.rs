//! Assigns each word to its line or to the modal state.

use super::line::{LineWords, MotionMode, NonModalCode};
use super::modal::ModalState;
use super::words::{GcodeWord, GrblErrorCode};
use machine::Axis;

impl ModalState {
    /// Adds one word to `line` or to the modal state.
    pub(super) fn apply_word(
        &mut self,
        word: GcodeWord,
        line: &mut LineWords,
        axes: &[Axis],
    ) -> Result<(), GrblErrorCode> {
        match word.letter {
            'G' => return self.apply_g_word((word.value * 10.0).round() as u32, line),
            'M' => return Self::apply_m_word(word.value, line),
            letter => line.add_unique_letter(letter)?,
        }
        if let Some(axis) = axes.iter().find(|axis| axis.letter() == word.letter) {
            line.axis_words.push((*axis, word.value));
            return Ok(());
        }
        match word.letter {
            'F' if word.value < 0.0 => Err(4),
            'F' => {
                line.feed_word = Some(word.value);
                Ok(())
            }
            'N' if !(0.0..=9_999_999.0).contains(&word.value) => Err(27),
            'N' | 'L' | 'P' | 'R' => {
                line.unconsumed_values.push((word.letter, word.value));
                Ok(())
            }
            'S' | 'T' => Ok(()),
            _ => Err(20),
        }
    }

    /// `tenths`: ten times the G number, 382 for G38.2.
    fn apply_g_word(&mut self, tenths: u32, line: &mut LineWords) -> Result<(), GrblErrorCode> {
        let group = match tenths {
            0 | 10 | 382 | 383 | 800 => 1,
            170 | 180 | 190 => 2,
            900 | 910 => 3,
            940 => 5,
            200 | 210 => 6,
            400 => 7,
            490 => 8,
            540 | 550 | 560 | 570 | 580 | 590 => 12,
            610 => 13,
            40 | 100 | 530 | 920 | 921 => 0,
            _ => return Err(20),
        };
        line.add_unique_modal_group(group)?;
        match tenths {
            0 => line.motion = Some(MotionMode::Rapid),
            10 => line.motion = Some(MotionMode::Feed),
            382 | 383 => line.motion = Some(MotionMode::Probe { alarms_on_miss: tenths == 382 }),
            800 => line.motion = Some(MotionMode::Cancelled),
            170 | 180 | 190 => self.plane_code = tenths / 10,
            900 | 910 => self.is_relative = tenths == 910,
            200 | 210 => self.uses_inches = tenths == 200,
            540..=590 => self.coordinate_system_index = (tenths / 10 - 54) as usize,
            40 => line.non_modal_code = Some(NonModalCode::Dwell),
            100 => line.non_modal_code = Some(NonModalCode::SetCoordinateSystemOffset),
            530 => line.non_modal_code = Some(NonModalCode::MachineCoordinates),
            920 => line.non_modal_code = Some(NonModalCode::SetG92Offset),
            921 => line.non_modal_code = Some(NonModalCode::ClearG92Offset),
            _ => {}
        }
        Ok(())
    }

    /// Stores M2, M19, M30 and M62 to M65 in `line`; the other supported M codes have no effect.
    fn apply_m_word(value: f64, line: &mut LineWords) -> Result<(), GrblErrorCode> {
        let group = match value {
            0.0 | 1.0 | 2.0 | 30.0 => 104,
            5.0 | 19.0 => 107,
            9.0 => 108,
            // Digital outputs, which are not connected here.
            62.0 | 63.0 | 64.0 | 65.0 => 110,
            _ => return Err(20),
        };
        line.has_spindle_orient |= value == 19.0;
        line.has_digital_output |= matches!(value, 62.0..=65.0);
        line.ends_program |= matches!(value, 2.0 | 30.0);
        line.add_unique_modal_group(group)
    }
}
