//! State of the G-code reader from line to line: modal state, positions, switches and conditions.

use std::collections::{BTreeMap, BTreeSet};

use super::declared_commands::{DeclaredCommands, SwitchState};
use super::gcode_line::{GcodeLine, GcodeWords, parse_word_integer};
use super::{LineError, MotionFrame, MotionKind, ReadMotion};
use machine::{Axis, Position};

const MM_PER_INCH: f64 = 25.4;
/// Work offset slots in the order of their P numbers in G10 L2 (P1 is G54), with their G words times ten.
const WORK_OFFSETS_AND_G_WORDS_TENFOLD: [(&str, u32); 9] = [
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
const IGNORED_G_WORDS_TENFOLD: [u32; 2] = [170, 400];

/// Distance mode: G90 or G91.
#[derive(Debug, Clone, Copy, PartialEq)]
enum DistanceMode {
    Absolute,
    Incremental,
}

/// Modal state; `None` or `false`: not set by the text so far, or not since M72.
#[derive(Debug, Default)]
struct ModalState {
    /// 1 after G21, 25.4 after G20.
    mm_per_unit: Option<f64>,
    distance_mode: Option<DistanceMode>,
    /// Active motion mode, for lines with axis words; `None` also after G80.
    motion_kind: Option<MotionKind>,
    /// Last F word, converted to mm/min.
    feed_mm_min: Option<f64>,
    /// Active slot, such as `G54`.
    work_offset_slot: Option<&'static str>,
    /// G92.1 or G92.2 has been read. G92 itself is refused.
    is_g92_off: bool,
    /// G49 has been read. G43 is refused.
    is_tool_length_off: bool,
    /// G61 or G61.1: each move reaches its target before the next begins. G64 cuts corners.
    is_exact_path: bool,
    /// G94: F words are mm/min.
    is_feed_per_minute: bool,
}

/// State of the G-code reader after the lines read so far.
#[derive(Debug, Default)]
pub(super) struct GcodeReaderState {
    modal_state: ModalState,
    /// Position of each axis, mm and rad, as far as the text determines it. Not known: the axes of a probing move
    /// after that move, and all axes after M0.
    known_position: Position,
    /// Axes whose work offset is known to be zero, by slot: set to zero by G10 L2, or stated when the reader was
    /// created.
    zeroed_axes_by_slot: BTreeMap<&'static str, BTreeSet<Axis>>,
    switch_state: SwitchState,
    /// Name of the open condition, and whether it stops the program.
    open_condition_and_has_stop: Option<(String, bool)>,
    /// `%` or a word has been read.
    has_program_started: bool,
    /// The program has ended: by a `%` after the program has started, or by M2, M30 or an ABORT comment outside a
    /// condition. Any word that follows outside a condition is an error.
    has_program_ended: bool,
}

impl GcodeReaderState {
    /// State before the first line. `zero_offset_slot`: slot whose offsets are known to be zero in all axes; a name
    /// that is not a slot has no effect.
    pub fn new(zero_offset_slot: Option<&str>, declared: &DeclaredCommands) -> Self {
        let known = WORK_OFFSETS_AND_G_WORDS_TENFOLD.iter().filter(|(name, _)| Some(*name) == zero_offset_slot);
        let zeroed_axes_by_slot = known.map(|(name, _)| (*name, Axis::ALL.into_iter().collect())).collect();
        Self { zeroed_axes_by_slot, switch_state: SwitchState::new(declared), ..Self::default() }
    }

    /// Checks that the program does not end inside a condition.
    pub fn check_no_open_condition(&self) -> Result<(), LineError> {
        match &self.open_condition_and_has_stop {
            Some((name, _)) => Err(format!("the condition {name} has no end").into()),
            None => Ok(()),
        }
    }

    /// Updates the state by one line. Returns the motion of the line, if it has one.
    pub fn apply_line(&mut self, line: GcodeLine) -> Result<Option<ReadMotion>, LineError> {
        match line {
            GcodeLine::Percent => {
                self.has_program_ended = self.has_program_started;
                self.has_program_started = true;
                Ok(None)
            }
            GcodeLine::IfLabel(name) if self.open_condition_and_has_stop.is_none() => {
                self.open_condition_and_has_stop = Some((name, false));
                Ok(None)
            }
            GcodeLine::IfLabel(_) => Err("a condition inside a condition is not supported".into()),
            GcodeLine::EndIfLabel(name) => match self.open_condition_and_has_stop.take() {
                Some((open, true)) if open == name => Ok(None),
                Some((open, false)) if open == name => {
                    Err(format!("the condition {name} does not stop the program").into())
                }
                _ => Err(format!("the condition {name} ends, but is not open").into()),
            },
            GcodeLine::Words(words) if self.open_condition_and_has_stop.is_some() => {
                self.apply_words_in_condition(words).map(|()| None)
            }
            GcodeLine::Words(words) => self.apply_words(words),
        }
    }

    /// Accepts only M72 and a stop (M2, M30 or an ABORT comment), and records the stop.
    fn apply_words_in_condition(&mut self, mut words: GcodeWords) -> Result<(), LineError> {
        words.take_m_word(72);
        let stops = words.has_abort_comment || words.take_m_word(2) || words.take_m_word(30);
        if let Some((_, stopped)) = &mut self.open_condition_and_has_stop {
            *stopped |= stops;
        }
        refuse_unread_words(&words)
    }

    /// Applies a line outside a condition, and returns its motion. A dwell without an N word returns no motion.
    fn apply_words(&mut self, mut words: GcodeWords) -> Result<Option<ReadMotion>, LineError> {
        if words.g_words_tenfold.is_empty() && words.m_words.is_empty() && words.first_unread_word().is_none() {
            return Ok(None);
        }
        if self.has_program_ended {
            return Err("a word after the end of the program".into());
        }
        self.has_program_started = true;
        let n = words.take_word_value('N').map(|n| parse_word_integer(n, 'N')).transpose()?;
        if self.switch_state.apply_if_declared(&words) {
            return Ok(None);
        }
        self.apply_modal_words(&mut words)?;
        self.has_program_ended |= words.take_m_word(2) || words.take_m_word(30);
        let motion = self.apply_action_words(&mut words)?;
        refuse_unread_words(&words)?;
        if words.has_abort_comment {
            self.has_program_ended = true;
        }
        // A dwell without an N word comes from a template (e.g. a wait for a clamp) and is not a motion of the plan.
        let own = |motion: &ReadMotion| n.is_none() && matches!(motion.kind, MotionKind::Dwell { .. });
        Ok(motion.filter(|motion| !own(motion)).map(|motion| ReadMotion { step_number: n, ..motion }))
    }

    /// Takes the words that set modes, the F word, and M66, M70 and M72.
    fn apply_modal_words(&mut self, words: &mut GcodeWords) -> Result<(), LineError> {
        // M66 L0 reads an input immediately: it waits for the moves before it and does not move.
        if words.take_m_word(66)
            && (words.take_word_value('L'), words.take_word_value('P').is_some()) != (Some(0.0), true)
        {
            return Err("M66 is supported only with P and L0".into());
        }
        // M70 saves the modal state; after M72 the text does not determine it.
        words.take_m_word(70);
        if words.take_m_word(72) {
            self.modal_state = ModalState::default();
        }
        let modal = &mut self.modal_state;
        set_modal_group(words, &[(200, MM_PER_INCH), (210, 1.0)], &mut modal.mm_per_unit)?;
        let distances = [(900, DistanceMode::Absolute), (910, DistanceMode::Incremental)];
        set_modal_group(words, &distances, &mut modal.distance_mode)?;
        let work_offsets = WORK_OFFSETS_AND_G_WORDS_TENFOLD.map(|(name, g)| (g, name));
        set_modal_group(words, &work_offsets, &mut modal.work_offset_slot)?;
        let motions = [
            (0, MotionKind::Rapid),
            (10, MotionKind::Feed),
            (382, MotionKind::Probe { must_touch: true }),
            (383, MotionKind::Probe { must_touch: false }),
        ];
        set_modal_group(words, &motions, &mut modal.motion_kind)?;
        if words.take_g_word(800) {
            modal.motion_kind = None;
        }
        modal.is_tool_length_off |= words.take_g_word(490);
        modal.is_g92_off |= words.take_g_word(921) || words.take_g_word(922);
        if words.take_g_word(640) {
            return Err("G64 rounds corners; only G61 and G61.1 are supported".into());
        }
        modal.is_exact_path |= words.take_g_word(610) | words.take_g_word(611);
        modal.is_feed_per_minute |= words.take_g_word(940);
        for g in IGNORED_G_WORDS_TENFOLD {
            words.take_g_word(g);
        }
        if let Some(feed) = words.take_word_value('F') {
            modal.feed_mm_min = Some(feed * modal.mm_per_unit.ok_or(UNITS_NOT_SET_MESSAGE)?);
        }
        Ok(())
    }

    /// Action of the line; a line has at most one.
    fn apply_action_words(&mut self, words: &mut GcodeWords) -> Result<Option<ReadMotion>, LineError> {
        let (dwell, offset, machine) = (words.take_g_word(40), words.take_g_word(100), words.take_g_word(530));
        let (orient, stop) = (words.take_m_word(19), words.take_m_word(0));
        if let Some(code) = words.first_unread_g_or_m_word() {
            return Err(format!("{code} is not supported").into());
        }
        if dwell {
            let seconds = words.take_word_value('P').ok_or("G4 without P")?;
            return Ok(Some(motion_without_target(MotionKind::Dwell { seconds })));
        }
        if orient {
            let s = Axis::S.to_mm_or_rad(words.take_word_value('R').ok_or("M19 without R")?);
            words.take_word_value('Q');
            return Ok(Some(motion_without_target(MotionKind::OrientSpindle { s })));
        }
        if stop {
            // The operator who restarts the program may have moved the machine.
            self.known_position = Position::new();
            return Ok(Some(motion_without_target(MotionKind::ProgramStop)));
        }
        if offset {
            return self.record_zeroed_work_offset(words).map(|()| None);
        }
        let named: Vec<(Axis, f64)> = Axis::ALL
            .into_iter()
            .filter_map(|axis| words.take_word_value(axis.letter()).map(|value| (axis, value)))
            .collect();
        if named.is_empty() && !machine {
            return Ok(None);
        }
        self.straight_move(machine, &named).map(Some)
    }

    /// G10 L2: a zero offset is recorded; any other offset is refused.
    fn record_zeroed_work_offset(&mut self, words: &mut GcodeWords) -> Result<(), LineError> {
        let slot = words.take_word_value('P').map(|p| parse_word_integer(p, 'P')).transpose()?;
        let (Some(2.0), Some(p @ 1..=9)) = (words.take_word_value('L'), slot) else {
            return Err("G10 is supported only with L2 and P1 to P9".into());
        };
        let (slot_name, _) = WORK_OFFSETS_AND_G_WORDS_TENFOLD[p as usize - 1];
        let zeroed_axes = self.zeroed_axes_by_slot.entry(slot_name).or_default();
        for axis in Axis::ALL {
            match words.take_word_value(axis.letter()) {
                Some(0.0) => {
                    zeroed_axes.insert(axis);
                }
                Some(value) => return Err(format!("a work offset of {value} in {axis}; only 0 is supported").into()),
                None => {}
            }
        }
        Ok(())
    }

    /// Checks the modal state and the switches for a straight move, and returns the move. Its line and N word are set
    /// by the caller.
    fn straight_move(
        &mut self,
        in_machine_coordinates: bool,
        axis_values: &[(Axis, f64)],
    ) -> Result<ReadMotion, LineError> {
        let kind = self.modal_state.motion_kind.ok_or("the line has axis words, but no motion mode is set")?;
        let scale = self.modal_state.mm_per_unit.ok_or(UNITS_NOT_SET_MESSAGE)?;
        let distance = self.modal_state.distance_mode.ok_or("neither G90 nor G91 is set")?;
        if !self.modal_state.is_exact_path {
            return Err("neither G61 nor G61.1 is set".into());
        }
        if !self.modal_state.is_feed_per_minute {
            return Err("G94 is not set".into());
        }
        if in_machine_coordinates && (matches!(kind, MotionKind::Probe { .. }) || distance == DistanceMode::Incremental)
        {
            return Err("G53 is supported only with G90 and G0 or G1".into());
        }
        self.switch_state.check_clamps_open(axis_values.iter().map(|(axis, _)| *axis))?;
        if matches!(kind, MotionKind::Probe { .. }) {
            self.switch_state.check_probe_on_and_clamps_closed()?;
        }
        let feed_mm_min = match kind {
            MotionKind::Rapid => None,
            _ => Some(self.modal_state.feed_mm_min.filter(|feed| *feed > 0.0).ok_or("no feed is set")?),
        };
        let mut target = Position::new();
        for (axis, word) in axis_values {
            let value = if axis.is_linear() { word * scale } else { axis.to_mm_or_rad(*word) };
            let from = match distance {
                DistanceMode::Absolute => 0.0,
                DistanceMode::Incremental => {
                    self.known_position.get(*axis).ok_or_else(|| format!("the position of {axis} is unknown"))?
                }
            };
            target.set(*axis, from + value);
        }
        let frame = if in_machine_coordinates { MotionFrame::Machine } else { self.target_frame(&target) };
        self.known_position = match kind {
            // Contact may have stopped the move before its target.
            MotionKind::Probe { .. } => self.known_position.filter_axes(|axis| target.get(axis).is_none()),
            _ => self.known_position.updated_by(&target),
        };
        Ok(ReadMotion { line: 0, step_number: None, kind, target, frame, feed_mm_min })
    }

    /// Machine frame if the offset of the active slot is zero for every axis of the target, and G92 and tool length
    /// offset are off; otherwise the work frame of the slot.
    fn target_frame(&self, target: &Position) -> MotionFrame {
        let Some(slot) = self.modal_state.work_offset_slot else {
            return MotionFrame::Work("an unknown work offset".to_owned());
        };
        let zero = self.zeroed_axes_by_slot.get(slot);
        let is_zero = target.iter().all(|(axis, _)| zero.is_some_and(|axes| axes.contains(&axis)));
        if is_zero && self.modal_state.is_g92_off && self.modal_state.is_tool_length_off {
            MotionFrame::Machine
        } else {
            MotionFrame::Work(slot.to_owned())
        }
    }
}

const UNITS_NOT_SET_MESSAGE: &str = "neither G20 nor G21 is set";

/// Motion with an empty target, in the machine frame. Its line and N word are set by the caller.
fn motion_without_target(kind: MotionKind) -> ReadMotion {
    let (target, frame) = (Position::new(), MotionFrame::Machine);
    ReadMotion { line: 0, step_number: None, kind, target, frame, feed_mm_min: None }
}

/// Sets `to` from the word of a modal group in the line; a line has at most one word of a group.
fn set_modal_group<T: Copy>(words: &mut GcodeWords, group: &[(u32, T)], to: &mut Option<T>) -> Result<(), LineError> {
    let mut found = group.iter().filter(|(g, _)| words.take_g_word(*g));
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
