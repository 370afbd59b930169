//! Modal state of the reader.

use std::collections::{BTreeMap, BTreeSet};

use super::declared_commands::{DeclaredCommands, SwitchState};
use super::line::{GcodeLine, GcodeWords, parse_code};
use super::{LineError, MotionFrame, MotionKind, ReadMotion};
use machine::{Axis, Position};

const MM_PER_INCH: f64 = 25.4;
/// Work offset slots by their P number in G10 L2, and their G words times ten.
const WORK_OFFSET_SLOTS: [(&str, u32); 9] = [
    ("G54", 540),
    ("G55", 550),
    ("G56", 560),
    ("G57", 570),
    ("G58", 580),
    ("G59", 590),
    ("G59.1", 591),
    ("G59.2", 592),
    ("G59.3", 593),
];
/// G words for the plane and for cutter compensation off: they do not affect straight lines.
const IGNORED_G_WORDS: [u32; 2] = [170, 400];

#[derive(Debug, Clone, Copy, PartialEq)]
enum DistanceMode {
    Absolute,
    Incremental,
}

/// Modal state; `None`: not set by the text so far.
#[derive(Debug, Default)]
struct ModalState {
    mm_per_unit: Option<f64>,
    distance_mode: Option<DistanceMode>,
    motion_kind: Option<MotionKind>,
    feed_mm_min: Option<f64>,
    work_offset_slot: Option<&'static str>,
    is_g92_off: bool,
    is_tool_length_off: bool,
    /// G61 or G61.1: each move reaches its target before the next begins. G64 cuts corners.
    is_exact_path: bool,
    /// G94: F words are mm/min.
    is_feed_per_minute: bool,
}

#[derive(Debug)]
pub(super) struct ReaderState {
    modal: ModalState,
    /// Position of each axis, as far as the text determines it.
    position: Position,
    /// Axes whose offset the text has set to zero, by slot.
    zeroed_axes: BTreeMap<&'static str, BTreeSet<Axis>>,
    switches: SwitchState,
    /// Name of the open condition, and whether it stops the program.
    open_condition: Option<(String, bool)>,
    has_started: bool,
    has_ended: bool,
}

impl ReaderState {
    pub fn new(zero_slot: Option<&str>, declared: &DeclaredCommands) -> Self {
        let known = WORK_OFFSET_SLOTS.iter().filter(|(name, _)| Some(*name) == zero_slot);
        let zeroed_axes = known.map(|(name, _)| (*name, Axis::ALL.into_iter().collect())).collect();
        Self {
            modal: ModalState::default(),
            position: Position::new(),
            zeroed_axes,
            switches: SwitchState::new(declared),
            open_condition: None,
            has_started: false,
            has_ended: false,
        }
    }

    /// Checks that the program does not end inside a condition.
    pub fn check_end(&self) -> Result<(), LineError> {
        match &self.open_condition {
            Some((name, _)) => Err(format!("the condition {name} has no end").into()),
            None => Ok(()),
        }
    }

    pub fn apply(&mut self, line: GcodeLine) -> Result<Option<ReadMotion>, LineError> {
        match line {
            GcodeLine::Percent => {
                self.has_ended = self.has_started;
                self.has_started = true;
                Ok(None)
            }
            GcodeLine::If(name) if self.open_condition.is_none() => {
                self.open_condition = Some((name, false));
                Ok(None)
            }
            GcodeLine::If(_) => Err("a condition inside a condition is not supported".into()),
            GcodeLine::EndIf(name) => match self.open_condition.take() {
                Some((open, true)) if open == name => Ok(None),
                Some((open, false)) if open == name => {
                    Err(format!("the condition {name} does not stop the program").into())
                }
                _ => Err(format!("the condition {name} ends, but is not open").into()),
            },
            GcodeLine::Words(words) if self.open_condition.is_some() => self.apply_in_condition(words).map(|()| None),
            GcodeLine::Words(words) => self.apply_words(words),
        }
    }

    /// Accepts only a stop, and before it a restore of the modal state.
    fn apply_in_condition(&mut self, mut words: GcodeWords) -> Result<(), LineError> {
        words.take_m(72);
        let stops = words.has_abort_comment || words.take_m(2) || words.take_m(30);
        if let Some((_, stopped)) = &mut self.open_condition {
            *stopped |= stops;
        }
        refuse_unread_words(&words)
    }

    fn apply_words(&mut self, mut words: GcodeWords) -> Result<Option<ReadMotion>, LineError> {
        if words.g_words_tenfold.is_empty() && words.m_words.is_empty() && words.first_unread_word().is_none() {
            return Ok(None);
        }
        if self.has_ended {
            return Err("a word after the end of the program".into());
        }
        self.has_started = true;
        let n = words.take_value('N').map(|n| parse_code(n, 'N')).transpose()?;
        if self.switches.apply(&words) {
            return Ok(None);
        }
        self.set_modal(&mut words)?;
        self.has_ended |= words.take_m(2) || words.take_m(30);
        let motion = self.take_action(&mut words)?;
        refuse_unread_words(&words)?;
        if words.has_abort_comment {
            self.has_ended = true;
        }
        // A dwell without a step belongs to the template, not to a motion.
        let own = |motion: &ReadMotion| n.is_none() && matches!(motion.kind, MotionKind::Dwell { .. });
        Ok(motion.filter(|motion| !own(motion)).map(|motion| ReadMotion { step_number: n, ..motion }))
    }

    fn set_modal(&mut self, words: &mut GcodeWords) -> Result<(), LineError> {
        // M66 L0 reads an input immediately: it waits for the moves before it and does not move.
        if words.take_m(66) && (words.take_value('L'), words.take_value('P').is_some()) != (Some(0.0), true) {
            return Err("M66 is supported only with P and L0".into());
        }
        // M70 saves the modal state; after M72 the text does not determine it.
        words.take_m(70);
        if words.take_m(72) {
            self.modal = ModalState::default();
        }
        let modal = &mut self.modal;
        set_modal_group(words, &[(200, MM_PER_INCH), (210, 1.0)], &mut modal.mm_per_unit)?;
        let distances = [(900, DistanceMode::Absolute), (910, DistanceMode::Incremental)];
        set_modal_group(words, &distances, &mut modal.distance_mode)?;
        set_modal_group(words, &WORK_OFFSET_SLOTS.map(|(name, g)| (g, name)), &mut modal.work_offset_slot)?;
        let motions = [
            (0, MotionKind::Rapid),
            (10, MotionKind::Feed),
            (382, MotionKind::Probe { must_touch: true }),
            (383, MotionKind::Probe { must_touch: false }),
        ];
        set_modal_group(words, &motions, &mut modal.motion_kind)?;
        if words.take_g(800) {
            modal.motion_kind = None;
        }
        modal.is_tool_length_off |= words.take_g(490);
        modal.is_g92_off |= words.take_g(921) || words.take_g(922);
        if words.take_g(640) {
            return Err("G64 rounds corners; only G61 and G61.1 are supported".into());
        }
        modal.is_exact_path |= words.take_g(610) | words.take_g(611);
        modal.is_feed_per_minute |= words.take_g(940);
        for g in IGNORED_G_WORDS {
            words.take_g(g);
        }
        if let Some(feed) = words.take_value('F') {
            modal.feed_mm_min = Some(feed * modal.mm_per_unit.ok_or(UNITS_NOT_SET)?);
        }
        Ok(())
    }

    /// Action of the line; a line has at most one.
    fn take_action(&mut self, words: &mut GcodeWords) -> Result<Option<ReadMotion>, LineError> {
        let (dwell, offset, machine) = (words.take_g(40), words.take_g(100), words.take_g(530));
        let (orient, stop) = (words.take_m(19), words.take_m(0));
        if let Some(code) = words.first_unread_code() {
            return Err(format!("{code} is not supported").into());
        }
        if dwell {
            let seconds = words.take_value('P').ok_or("G4 without P")?;
            return Ok(Some(motion_without_target(MotionKind::Dwell { seconds })));
        }
        if orient {
            let s = Axis::S.to_mm_or_rad(words.take_value('R').ok_or("M19 without R")?);
            words.take_value('Q');
            return Ok(Some(motion_without_target(MotionKind::Orient { s })));
        }
        if stop {
            // The operator who restarts the program may have moved the machine.
            self.position = Position::new();
            return Ok(Some(motion_without_target(MotionKind::Stop)));
        }
        if offset {
            return self.zero_work_offset(words).map(|()| None);
        }
        let named: Vec<(Axis, f64)> = Axis::ALL
            .into_iter()
            .filter_map(|axis| words.take_value(axis.letter()).map(|value| (axis, value)))
            .collect();
        if named.is_empty() && !machine {
            return Ok(None);
        }
        self.straight_move(machine, &named).map(Some)
    }

    /// G10 L2: a zero offset is recorded; any other offset is refused.
    fn zero_work_offset(&mut self, words: &mut GcodeWords) -> Result<(), LineError> {
        let slot = words.take_value('P').map(|p| parse_code(p, 'P')).transpose()?;
        let (Some(2.0), Some(p @ 1..=9)) = (words.take_value('L'), slot) else {
            return Err("G10 is supported only with L2 and P1 to P9".into());
        };
        for axis in Axis::ALL {
            match words.take_value(axis.letter()) {
                Some(0.0) => {
                    self.zeroed_axes.entry(WORK_OFFSET_SLOTS[p as usize - 1].0).or_default().insert(axis);
                }
                Some(value) => {
                    return Err(format!("a work offset of {value} in {axis}; only 0 is supported").into());
                }
                None => {}
            }
        }
        Ok(())
    }

    fn straight_move(&mut self, machine: bool, named: &[(Axis, f64)]) -> Result<ReadMotion, LineError> {
        let kind = self.modal.motion_kind.ok_or("the line has axis words, but no motion mode is set")?;
        let scale = self.modal.mm_per_unit.ok_or(UNITS_NOT_SET)?;
        let distance = self.modal.distance_mode.ok_or("neither G90 nor G91 is set")?;
        if !self.modal.is_exact_path {
            return Err("neither G61 nor G61.1 is set".into());
        }
        if !self.modal.is_feed_per_minute {
            return Err("G94 is not set".into());
        }
        if machine && (matches!(kind, MotionKind::Probe { .. }) || distance == DistanceMode::Incremental) {
            return Err("G53 is supported only with G90 and G0 or G1".into());
        }
        self.switches.check_clamps_open(named.iter().map(|(axis, _)| *axis))?;
        if matches!(kind, MotionKind::Probe { .. }) {
            self.switches.check_ready_to_probe()?;
        }
        let feed_mm_min = match kind {
            MotionKind::Rapid => None,
            _ => Some(self.modal.feed_mm_min.filter(|feed| *feed > 0.0).ok_or("no feed is set")?),
        };
        let mut target = Position::new();
        for (axis, word) in named {
            let value = if axis.is_linear() { word * scale } else { axis.to_mm_or_rad(*word) };
            let from = match distance {
                DistanceMode::Absolute => 0.0,
                DistanceMode::Incremental => {
                    self.position.get(*axis).ok_or_else(|| format!("the position of {axis} is unknown"))?
                }
            };
            target.set(*axis, from + value);
        }
        let frame = if machine { MotionFrame::Machine } else { self.target_frame(&target) };
        self.position = match kind {
            // Contact may have stopped the move before its target.
            MotionKind::Probe { .. } => self.position.filter_axes(|axis| target.get(axis).is_none()),
            _ => self.position.updated_by(&target),
        };
        Ok(ReadMotion { line: 0, step_number: None, kind, target, frame, feed_mm_min })
    }

    fn target_frame(&self, target: &Position) -> MotionFrame {
        let Some(slot) = self.modal.work_offset_slot else {
            return MotionFrame::Work("an unknown work offset".to_owned());
        };
        let zero = self.zeroed_axes.get(slot);
        let is_zero = target.iter().all(|(axis, _)| zero.is_some_and(|axes| axes.contains(&axis)));
        if is_zero && self.modal.is_g92_off && self.modal.is_tool_length_off {
            MotionFrame::Machine
        } else {
            MotionFrame::Work(slot.to_owned())
        }
    }
}

const UNITS_NOT_SET: &str = "neither G20 nor G21 is set";

fn motion_without_target(kind: MotionKind) -> ReadMotion {
    let (target, frame) = (Position::new(), MotionFrame::Machine);
    ReadMotion { line: 0, step_number: None, kind, target, frame, feed_mm_min: None }
}

/// Sets `to` from the word of a modal group in the line; a line has at most one word of a group.
fn set_modal_group<T: Copy>(words: &mut GcodeWords, group: &[(u32, T)], to: &mut Option<T>) -> Result<(), LineError> {
    let mut found = group.iter().filter(|(g, _)| words.take_g(*g));
    if let Some((_, value)) = found.next() {
        *to = Some(*value);
    }
    match found.next() {
        Some((g, _)) => {
            Err(format!("G{} and another word of its modal group are in one line", f64::from(*g) / 10.0).into())
        }
        None => Ok(()),
    }
}

fn refuse_unread_words(words: &GcodeWords) -> Result<(), LineError> {
    match words.first_unread_word() {
        Some(word) => Err(format!("{word} is not supported").into()),
        None => Ok(()),
    }
}
