//! Modal state of the simulated control, and the action that a line requests.

use machine::{Axis, Position};

use super::job::Job;
use super::line::{Line, Motion, Once};
use super::words::{Code, Word};

const MM_PER_INCH: f64 = 25.4;
const SLOTS: usize = 6;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Modal {
    motion: Motion,
    pub(super) inches: bool,
    pub(super) relative: bool,
    pub(super) plane: u32,
    pub(super) slot: usize,
    feed_mm_min: Option<f64>,
    offsets: [Position; SLOTS],
    /// Offset set by G92.
    shift: Position,
}

impl Default for Modal {
    fn default() -> Self {
        Self {
            motion: Motion::Rapid,
            inches: false,
            relative: false,
            plane: 17,
            slot: 0,
            feed_mm_min: None,
            offsets: Default::default(),
            shift: Position::new(),
        }
    }
}

impl Modal {
    /// The answer to `$G`, without the brackets.
    pub(super) fn report(&self) -> String {
        let motion = match self.motion {
            Motion::Rapid => "G0",
            Motion::Feed => "G1",
            Motion::Probe { strict: true } => "G38.2",
            Motion::Probe { strict: false } => "G38.3",
            Motion::Off => "G80",
        };
        let units = if self.inches { 20 } else { 21 };
        let distance = if self.relative { 91 } else { 90 };
        let (slot, plane, feed) = (54 + self.slot, self.plane, self.feed_mm_min.unwrap_or(0.0));
        format!(
            "GC:{motion} G{slot} G{plane} G{units} G{distance} G94 G49 G98 G50 M5 M9 T0 F{feed:.0} S0."
        )
    }

    /// The answer to `$#`: names and offsets.
    pub(super) fn offsets(&self) -> Vec<(String, Position)> {
        let slots = self.offsets.iter().enumerate();
        slots
            .map(|(slot, offset)| (format!("G{}", 54 + slot), offset.clone()))
            .chain([("G92".to_owned(), self.shift.clone())])
            .collect()
    }

    /// Action that `words` request of a control at `here`; a line in error does not change the modal state.
    pub(super) fn block(
        &mut self,
        words: &[Word],
        here: &Position,
        axes: &[Axis],
    ) -> Result<Option<Job>, Code> {
        let mut next = self.clone();
        let mut line = Line::default();
        for word in words {
            next.sort(*word, &mut line, axes)?;
        }
        let act = next.act(&mut line, here)?;
        if !line.values.is_empty() {
            return Err(36);
        }
        *self = next;
        Ok(act)
    }

    fn act(&mut self, line: &mut Line, here: &Position) -> Result<Option<Job>, Code> {
        let n = line.value('N').unwrap_or(0.0) as u32;
        if let Some(feed) = line.feed {
            self.feed_mm_min = Some(if self.inches { feed * MM_PER_INCH } else { feed });
        }
        if let Some(motion) = line.motion {
            self.motion = motion;
        }
        if line.ends {
            let offsets = self.offsets.clone();
            *self = Self { offsets, ..Self::default() };
        }
        match line.once {
            Some(Once::Dwell) => {
                let seconds = line.value('P').ok_or(28)?;
                return Ok(Some(Job::Dwell { seconds }));
            }
            Some(Once::SetOffset) => return self.set_offset(line, here).map(|()| None),
            Some(Once::Shift) => {
                if line.axes.is_empty() {
                    return Err(26);
                }
                for (axis, value) in &line.axes {
                    let slot = self.offsets[self.slot].at(*axis);
                    self.shift.set(*axis, here.at(*axis) - slot - self.length(*axis, *value));
                }
                return Ok(None);
            }
            Some(Once::ShiftOff) => self.shift = Position::new(),
            Some(Once::MachineCoordinates) | None => {}
        }
        if line.output {
            line.value('P').ok_or(28)?;
            return Ok(None);
        }
        if line.orient {
            let degrees = line.value('R').ok_or(28)?;
            return Ok(Some(Job::Orient { s: Axis::S.from_edge(degrees) }));
        }
        self.motion_act(line, here, n)
    }

    fn motion_act(&self, line: &Line, here: &Position, n: u32) -> Result<Option<Job>, Code> {
        let machine = line.once == Some(Once::MachineCoordinates);
        if machine && !matches!(self.motion, Motion::Rapid | Motion::Feed) {
            return Err(30);
        }
        if line.axes.is_empty() {
            let probing = matches!(line.motion, Some(Motion::Probe { .. }));
            return if probing { Err(26) } else { Ok(None) };
        }
        let to = self.target(line, here, machine);
        match self.motion {
            Motion::Off => Err(31),
            Motion::Rapid => Ok(Some(Job::Travel { to, feed_mm_min: None })),
            Motion::Feed => Ok(Some(Job::Travel { to, feed_mm_min: Some(self.feed()?) })),
            Motion::Probe { .. } if here.updated_by(&to) == *here => Err(33),
            Motion::Probe { strict } => {
                Ok(Some(Job::Probe { to, feed_mm_min: self.feed()?, strict, n }))
            }
        }
    }

    fn feed(&self) -> Result<f64, Code> {
        self.feed_mm_min.filter(|feed| *feed > 0.0).ok_or(22)
    }

    fn target(&self, line: &Line, here: &Position, machine: bool) -> Position {
        let place = |(axis, value): &(Axis, f64)| {
            let length = self.length(*axis, *value);
            let origin = if machine {
                0.0
            } else if self.relative {
                here.at(*axis)
            } else {
                self.offsets[self.slot].at(*axis) + self.shift.at(*axis)
            };
            (*axis, origin + length)
        };
        line.axes.iter().map(place).collect()
    }

    /// Value of a word in the active units, converted to mm or rad.
    fn length(&self, axis: Axis, value: f64) -> f64 {
        if axis.is_linear() && self.inches { value * MM_PER_INCH } else { axis.from_edge(value) }
    }

    /// `G10 L2 Pn` sets an offset; `G10 L20 Pn` sets it so that the current position has the given values.
    fn set_offset(&mut self, line: &mut Line, here: &Position) -> Result<(), Code> {
        let (kind, slot) = (line.value('L').ok_or(28)?, line.value('P').ok_or(28)?);
        if line.axes.is_empty() {
            return Err(26);
        }
        let slot = match slot {
            0.0 => self.slot,
            p if p.fract() == 0.0 && (1.0..=SLOTS as f64).contains(&p) => p as usize - 1,
            _ => return Err(29),
        };
        for (axis, value) in &line.axes {
            let length = self.length(*axis, *value);
            let offset = match kind {
                2.0 => length,
                20.0 => here.at(*axis) - self.shift.at(*axis) - length,
                _ => return Err(20),
            };
            self.offsets[slot].set(*axis, offset);
        }
        Ok(())
    }
}
