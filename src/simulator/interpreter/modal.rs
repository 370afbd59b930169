//! Modal state of the simulated control, and the action that a line requests.

use machine::{Axis, Position};

use super::job::Job;
use super::line::{LineWords, MotionMode, NonModalCode};
use super::words::{GcodeWord, GrblErrorCode};

const MM_PER_INCH: f64 = 25.4;
const COORDINATE_SYSTEM_COUNT: usize = 6;

/// Modes, feed and offsets of the control, which apply until a later line changes them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ModalState {
    motion_mode: MotionMode,
    pub(super) uses_inches: bool,
    /// Whether targets are relative (G91).
    pub(super) is_relative: bool,
    /// Number of the active plane: 17, 18 or 19.
    pub(super) plane_code: u32,
    /// Active coordinate system: 0 for G54 to 5 for G59.
    pub(super) coordinate_system_index: usize,
    /// Last F word, mm/min, or deg/min where only rotary axes move; `None`: no F word yet.
    feed_mm_min: Option<f64>,
    /// Offsets of the coordinate systems G54 to G59, mm or rad.
    offsets: [Position; COORDINATE_SYSTEM_COUNT],
    /// Offset set by G92, mm or rad; added to that of the active coordinate system.
    g92_offset: Position,
}

impl Default for ModalState {
    fn default() -> Self {
        Self {
            motion_mode: MotionMode::Rapid,
            uses_inches: false,
            is_relative: false,
            plane_code: 17,
            coordinate_system_index: 0,
            feed_mm_min: None,
            offsets: Default::default(),
            g92_offset: Position::new(),
        }
    }
}

impl ModalState {
    /// The active modes, as in Grbl's answer to `$G`, without the brackets.
    pub(crate) fn modes_report(&self) -> String {
        let motion = match self.motion_mode {
            MotionMode::Rapid => "G0",
            MotionMode::Feed => "G1",
            MotionMode::Probe { alarms_on_miss: true } => "G38.2",
            MotionMode::Probe { alarms_on_miss: false } => "G38.3",
            MotionMode::Cancelled => "G80",
        };
        let units = if self.uses_inches { 20 } else { 21 };
        let distance = if self.is_relative { 91 } else { 90 };
        let (coordinate_system, plane, feed) =
            (54 + self.coordinate_system_index, self.plane_code, self.feed_mm_min.unwrap_or(0.0));
        format!(
            "GC:{motion} G{coordinate_system} G{plane} G{units} G{distance} G94 G49 G98 G50 M5 M9 T0 F{feed:.0} S0."
        )
    }

    /// Names and offsets, as in Grbl's answer to `$#`.
    pub(crate) fn named_offsets(&self) -> Vec<(String, Position)> {
        let coordinate_systems = self.offsets.iter().enumerate();
        coordinate_systems
            .map(|(coordinate_system, offset)| (format!("G{}", 54 + coordinate_system), offset.clone()))
            .chain([("G92".to_owned(), self.g92_offset.clone())])
            .collect()
    }

    /// Action that `words` request with the control at `here`; `None`: no job. An erroneous line does not change the
    /// modal state.
    pub(super) fn interpret_words(
        &mut self,
        words: &[GcodeWord],
        here: &Position,
        axes: &[Axis],
    ) -> Result<Option<Job>, GrblErrorCode> {
        let mut next = self.clone();
        let mut line = LineWords::default();
        for word in words {
            next.apply_word(*word, &mut line, axes)?;
        }
        let job = next.apply_line_words(&mut line, here)?;
        if !line.unconsumed_values.is_empty() {
            return Err(36);
        }
        *self = next;
        Ok(job)
    }

    /// Applies the words of a line to the modes and offsets; returns the job that the line requests.
    fn apply_line_words(&mut self, line: &mut LineWords, here: &Position) -> Result<Option<Job>, GrblErrorCode> {
        let n = line.take_value('N').unwrap_or(0.0) as u32;
        if let Some(feed) = line.feed_word {
            self.feed_mm_min = Some(if self.uses_inches { feed * MM_PER_INCH } else { feed });
        }
        if let Some(motion) = line.motion {
            self.motion_mode = motion;
        }
        if line.ends_program {
            let offsets = self.offsets.clone();
            *self = Self { offsets, ..Self::default() };
        }
        match line.non_modal_code {
            Some(NonModalCode::Dwell) => {
                let seconds = line.take_value('P').ok_or(28)?;
                return Ok(Some(Job::Dwell { seconds }));
            }
            Some(NonModalCode::SetCoordinateSystemOffset) => {
                return self.set_coordinate_system_offset(line, here).map(|()| None);
            }
            Some(NonModalCode::SetG92Offset) => {
                if line.axis_words.is_empty() {
                    return Err(26);
                }
                for (axis, value) in &line.axis_words {
                    let system_offset = self.offsets[self.coordinate_system_index].get_or_zero(*axis);
                    self.g92_offset
                        .set(*axis, here.get_or_zero(*axis) - system_offset - self.value_in_mm_or_rad(*axis, *value));
                }
                return Ok(None);
            }
            Some(NonModalCode::ClearG92Offset) => self.g92_offset = Position::new(),
            Some(NonModalCode::MachineCoordinates) | None => {}
        }
        if line.has_digital_output {
            line.take_value('P').ok_or(28)?;
            return Ok(None);
        }
        if line.has_spindle_orient {
            let degrees = line.take_value('R').ok_or(28)?;
            return Ok(Some(Job::OrientSpindle { s: Axis::S.to_mm_or_rad(degrees) }));
        }
        self.motion_job(line, here, n)
    }

    /// Move or probing move of the line in the active motion mode; `None`: the line has no axis words.
    fn motion_job(&self, line: &LineWords, here: &Position, n: u32) -> Result<Option<Job>, GrblErrorCode> {
        let in_machine_coordinates = line.non_modal_code == Some(NonModalCode::MachineCoordinates);
        if in_machine_coordinates && !matches!(self.motion_mode, MotionMode::Rapid | MotionMode::Feed) {
            return Err(30);
        }
        if line.axis_words.is_empty() {
            let probing = matches!(line.motion, Some(MotionMode::Probe { .. }));
            return if probing { Err(26) } else { Ok(None) };
        }
        let to = self.target_position(line, here, in_machine_coordinates);
        match self.motion_mode {
            MotionMode::Cancelled => Err(31),
            MotionMode::Rapid => Ok(Some(Job::Travel { to, feed_mm_min: None })),
            MotionMode::Feed => Ok(Some(Job::Travel { to, feed_mm_min: Some(self.positive_feed()?) })),
            MotionMode::Probe { .. } if here.updated_by(&to) == *here => Err(33),
            MotionMode::Probe { alarms_on_miss } => {
                Ok(Some(Job::Probe { to, feed_mm_min: self.positive_feed()?, alarms_on_miss, n }))
            }
        }
    }

    /// The active feed; error 22 if there is none or it is 0.
    fn positive_feed(&self) -> Result<f64, GrblErrorCode> {
        self.feed_mm_min.filter(|feed| *feed > 0.0).ok_or(22)
    }

    /// Target in machine coordinates, mm or rad, of the axes that the line names.
    fn target_position(&self, line: &LineWords, here: &Position, in_machine_coordinates: bool) -> Position {
        let target_on_axis = |(axis, value): &(Axis, f64)| {
            let length = self.value_in_mm_or_rad(*axis, *value);
            let origin = if in_machine_coordinates {
                0.0
            } else if self.is_relative {
                here.get_or_zero(*axis)
            } else {
                self.offsets[self.coordinate_system_index].get_or_zero(*axis) + self.g92_offset.get_or_zero(*axis)
            };
            (*axis, origin + length)
        };
        line.axis_words.iter().map(target_on_axis).collect()
    }

    /// Value of a word in the active units, converted to mm or rad.
    fn value_in_mm_or_rad(&self, axis: Axis, value: f64) -> f64 {
        if axis.is_linear() && self.uses_inches { value * MM_PER_INCH } else { axis.to_mm_or_rad(value) }
    }

    /// `G10 L2 Pn` sets an offset; `G10 L20 Pn` sets it so that the current position has the given values.
    fn set_coordinate_system_offset(&mut self, line: &mut LineWords, here: &Position) -> Result<(), GrblErrorCode> {
        let (kind, coordinate_system) = (line.take_value('L').ok_or(28)?, line.take_value('P').ok_or(28)?);
        if line.axis_words.is_empty() {
            return Err(26);
        }
        let coordinate_system = match coordinate_system {
            0.0 => self.coordinate_system_index,
            p if p.fract() == 0.0 && (1.0..=COORDINATE_SYSTEM_COUNT as f64).contains(&p) => p as usize - 1,
            _ => return Err(29),
        };
        for (axis, value) in &line.axis_words {
            let length = self.value_in_mm_or_rad(*axis, *value);
            let offset = match kind {
                2.0 => length,
                20.0 => here.get_or_zero(*axis) - self.g92_offset.get_or_zero(*axis) - length,
                _ => return Err(20),
            };
            self.offsets[coordinate_system].set(*axis, offset);
        }
        Ok(())
    }
}
