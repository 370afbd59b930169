//! Assigns each word to its line or to the modal state.

use super::line::{Line, Motion, Once};
use super::modal::Modal;
use super::words::{Code, Word};
use machine::Axis;

impl Modal {
    /// Adds one word to `line` or to the modal state.
    pub(super) fn sort(&mut self, word: Word, line: &mut Line, axes: &[Axis]) -> Result<(), Code> {
        match word.letter {
            'G' => return self.sort_g((word.value * 10.0).round() as u32, line),
            'M' => return Self::sort_m(word.value, line),
            letter => line.claim_letter(letter)?,
        }
        if let Some(axis) = axes.iter().find(|axis| axis.letter() == word.letter) {
            line.axes.push((*axis, word.value));
            return Ok(());
        }
        match word.letter {
            'F' if word.value < 0.0 => Err(4),
            'F' => {
                line.feed = Some(word.value);
                Ok(())
            }
            'N' if !(0.0..=9_999_999.0).contains(&word.value) => Err(27),
            'N' | 'L' | 'P' | 'R' => {
                line.values.push((word.letter, word.value));
                Ok(())
            }
            'S' | 'T' => Ok(()),
            _ => Err(20),
        }
    }

    /// `tenths`: ten times the G number, 382 for G38.2.
    fn sort_g(&mut self, tenths: u32, line: &mut Line) -> Result<(), Code> {
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
        line.claim_group(group)?;
        match tenths {
            0 => line.motion = Some(Motion::Rapid),
            10 => line.motion = Some(Motion::Feed),
            382 | 383 => line.motion = Some(Motion::Probe { strict: tenths == 382 }),
            800 => line.motion = Some(Motion::Off),
            170 | 180 | 190 => self.plane = tenths / 10,
            900 | 910 => self.relative = tenths == 910,
            200 | 210 => self.inches = tenths == 200,
            540..=590 => self.slot = (tenths / 10 - 54) as usize,
            40 => line.once = Some(Once::Dwell),
            100 => line.once = Some(Once::SetOffset),
            530 => line.once = Some(Once::MachineCoordinates),
            920 => line.once = Some(Once::Shift),
            921 => line.once = Some(Once::ShiftOff),
            _ => {}
        }
        Ok(())
    }

    fn sort_m(value: f64, line: &mut Line) -> Result<(), Code> {
        let group = match value {
            0.0 | 1.0 | 2.0 | 30.0 => 104,
            5.0 | 19.0 => 107,
            9.0 => 108,
            // Digital outputs, which are not connected here.
            62.0 | 63.0 | 64.0 | 65.0 => 110,
            _ => return Err(20),
        };
        line.orient |= value == 19.0;
        line.output |= matches!(value, 62.0..=65.0);
        line.ends |= matches!(value, 2.0 | 30.0);
        line.claim_group(group)
    }
}
