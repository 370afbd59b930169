//! Modal state of the reader.

use std::collections::{BTreeMap, BTreeSet};

use super::declared::{Declared, Switches};
use super::line::{Line, Words, code};
use super::{Frame, Kind, ReadMotion};
use machine::{Axis, Position};

const MM_PER_INCH: f64 = 25.4;
/// Work offset slots by their P number in G10 L2, and their G words times ten.
const SLOTS: [(&str, u32); 9] = [
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
const WITHOUT_EFFECT: [u32; 2] = [170, 400];

#[derive(Debug, Clone, Copy, PartialEq)]
enum Distance {
    Absolute,
    Incremental,
}

/// Modal state; `None`: not set by the text so far.
#[derive(Debug, Default)]
struct Modal {
    mm_per_unit: Option<f64>,
    distance: Option<Distance>,
    motion: Option<Kind>,
    feed_mm_min: Option<f64>,
    slot: Option<&'static str>,
    g92_off: bool,
    tool_length_off: bool,
    /// G61 or G61.1: each move reaches its target before the next begins. G64 cuts corners.
    exact_path: bool,
    /// G94: F words are mm/min.
    feed_per_minute: bool,
}

#[derive(Debug)]
pub(super) struct State {
    modal: Modal,
    /// Position of each axis, as far as the text determines it.
    position: Position,
    /// Axes whose offset the text has set to zero, by slot.
    zeroed: BTreeMap<&'static str, BTreeSet<Axis>>,
    switches: Switches,
    /// Name of the open condition, and whether it stops the program.
    condition: Option<(String, bool)>,
    started: bool,
    ended: bool,
}

impl State {
    pub fn new(zero_slot: Option<&str>, declared: &Declared) -> Self {
        let known = SLOTS.iter().filter(|(name, _)| Some(*name) == zero_slot);
        let zeroed = known.map(|(name, _)| (*name, Axis::ALL.into_iter().collect())).collect();
        Self {
            modal: Modal::default(),
            position: Position::new(),
            zeroed,
            switches: Switches::new(declared),
            condition: None,
            started: false,
            ended: false,
        }
    }

    /// Checks that the program does not end inside a condition.
    pub fn end(&self) -> Result<(), String> {
        match &self.condition {
            Some((name, _)) => Err(format!("the condition {name} has no end")),
            None => Ok(()),
        }
    }

    pub fn apply(&mut self, line: Line) -> Result<Option<ReadMotion>, String> {
        match line {
            Line::Percent => {
                self.ended = self.started;
                self.started = true;
                Ok(None)
            }
            Line::If(name) if self.condition.is_none() => {
                self.condition = Some((name, false));
                Ok(None)
            }
            Line::If(_) => Err("a condition inside a condition".to_owned()),
            Line::EndIf(name) => match self.condition.take() {
                Some((open, true)) if open == name => Ok(None),
                Some((open, false)) if open == name => {
                    Err(format!("the condition {name} does something other than stop"))
                }
                _ => Err(format!("the end of a condition {name} that is not open")),
            },
            Line::Words(words) if self.condition.is_some() => {
                self.within_condition(words).map(|()| None)
            }
            Line::Words(words) => self.words(words),
        }
    }

    /// Accepts only a stop, and before it a restore of the modal state.
    fn within_condition(&mut self, mut words: Words) -> Result<(), String> {
        words.take_m(72);
        let stops = words.aborts || words.take_m(2) || words.take_m(30);
        if let Some((_, stopped)) = &mut self.condition {
            *stopped |= stops;
        }
        refuse_left_over(&words)
    }

    fn words(&mut self, mut words: Words) -> Result<Option<ReadMotion>, String> {
        if words.g.is_empty() && words.m.is_empty() && words.left_over().is_none() {
            return Ok(None);
        }
        if self.ended {
            return Err("a word after the program's end".to_owned());
        }
        self.started = true;
        let n = words.take('N').map(|n| code(n, 'N')).transpose()?;
        if self.switches.obey(&words) {
            return Ok(None);
        }
        self.set_modal(&mut words)?;
        self.ended |= words.take_m(2) || words.take_m(30);
        let motion = self.action(&mut words)?;
        refuse_left_over(&words)?;
        if words.aborts {
            self.ended = true;
        }
        // A dwell without a step belongs to the template, not to a motion.
        let own = |motion: &ReadMotion| n.is_none() && matches!(motion.kind, Kind::Dwell { .. });
        Ok(motion.filter(|motion| !own(motion)).map(|motion| ReadMotion { n, ..motion }))
    }

    fn set_modal(&mut self, words: &mut Words) -> Result<(), String> {
        // M66 L0 reads an input immediately: it waits for the moves before it and does not move.
        if words.take_m(66) && (words.take('L'), words.take('P').is_some()) != (Some(0.0), true) {
            return Err("of M66 only P with L0 is understood".to_owned());
        }
        // M70 saves the modal state; after M72 the text does not determine it.
        words.take_m(70);
        if words.take_m(72) {
            self.modal = Modal::default();
        }
        let modal = &mut self.modal;
        one_of(words, &[(200, MM_PER_INCH), (210, 1.0)], &mut modal.mm_per_unit)?;
        let distances = [(900, Distance::Absolute), (910, Distance::Incremental)];
        one_of(words, &distances, &mut modal.distance)?;
        one_of(words, &SLOTS.map(|(name, g)| (g, name)), &mut modal.slot)?;
        let motions = [
            (0, Kind::Rapid),
            (10, Kind::Feed),
            (382, Kind::Probe { must_touch: true }),
            (383, Kind::Probe { must_touch: false }),
        ];
        one_of(words, &motions, &mut modal.motion)?;
        if words.take_g(800) {
            modal.motion = None;
        }
        modal.tool_length_off |= words.take_g(490);
        modal.g92_off |= words.take_g(921) || words.take_g(922);
        if words.take_g(640) {
            return Err("G64 cuts corners; only G61 and G61.1 are understood".to_owned());
        }
        modal.exact_path |= words.take_g(610) | words.take_g(611);
        modal.feed_per_minute |= words.take_g(940);
        for g in WITHOUT_EFFECT {
            words.take_g(g);
        }
        if let Some(feed) = words.take('F') {
            modal.feed_mm_min = Some(feed * modal.mm_per_unit.ok_or(NO_UNITS)?);
        }
        Ok(())
    }

    /// Action of the line; a line has at most one.
    fn action(&mut self, words: &mut Words) -> Result<Option<ReadMotion>, String> {
        let (dwell, offset, machine) = (words.take_g(40), words.take_g(100), words.take_g(530));
        let (orient, stop) = (words.take_m(19), words.take_m(0));
        if let Some(code) = words.left_over_code() {
            return Err(format!("{code} is not understood"));
        }
        if dwell {
            let seconds = words.take('P').ok_or("G4 without P")?;
            return Ok(Some(standing(Kind::Dwell { seconds })));
        }
        if orient {
            let s = Axis::S.from_edge(words.take('R').ok_or("M19 without R")?);
            words.take('Q');
            return Ok(Some(standing(Kind::Orient { s })));
        }
        if stop {
            // The operator who restarts the program may have moved the machine.
            self.position = Position::new();
            return Ok(Some(standing(Kind::Stop)));
        }
        if offset {
            return self.zero_slot(words).map(|()| None);
        }
        let named: Vec<(Axis, f64)> = Axis::ALL
            .into_iter()
            .filter_map(|axis| words.take(axis.letter()).map(|value| (axis, value)))
            .collect();
        if named.is_empty() && !machine {
            return Ok(None);
        }
        self.straight(machine, &named).map(Some)
    }

    /// G10 L2: a zero offset is recorded; any other offset is refused.
    fn zero_slot(&mut self, words: &mut Words) -> Result<(), String> {
        let slot = words.take('P').map(|p| code(p, 'P')).transpose()?;
        let (Some(2.0), Some(p @ 1..=9)) = (words.take('L'), slot) else {
            return Err("of G10 only L2 with P1 to P9 is understood".to_owned());
        };
        for axis in Axis::ALL {
            match words.take(axis.letter()) {
                Some(0.0) => {
                    self.zeroed.entry(SLOTS[p as usize - 1].0).or_default().insert(axis);
                }
                Some(value) => return Err(format!("an offset of {value} in {axis}")),
                None => {}
            }
        }
        Ok(())
    }

    fn straight(&mut self, machine: bool, named: &[(Axis, f64)]) -> Result<ReadMotion, String> {
        let kind = self.modal.motion.ok_or("axis words, but no motion is set")?;
        let scale = self.modal.mm_per_unit.ok_or(NO_UNITS)?;
        let distance = self.modal.distance.ok_or("neither G90 nor G91 is set")?;
        if !self.modal.exact_path {
            return Err("neither G61 nor G61.1 is set".to_owned());
        }
        if !self.modal.feed_per_minute {
            return Err("G94 is not set".to_owned());
        }
        if machine && (matches!(kind, Kind::Probe { .. }) || distance == Distance::Incremental) {
            return Err("G53 goes with G0 and G1 and with G90 only".to_owned());
        }
        self.switches.may_move(named.iter().map(|(axis, _)| *axis))?;
        if matches!(kind, Kind::Probe { .. }) {
            self.switches.may_probe()?;
        }
        let feed_mm_min = match kind {
            Kind::Rapid => None,
            _ => Some(self.modal.feed_mm_min.filter(|feed| *feed > 0.0).ok_or("no feed is set")?),
        };
        let mut target = Position::new();
        for (axis, word) in named {
            let value = if axis.is_linear() { word * scale } else { axis.from_edge(*word) };
            let from = match distance {
                Distance::Absolute => 0.0,
                Distance::Incremental => self
                    .position
                    .get(*axis)
                    .ok_or_else(|| format!("{axis} stands nobody knows where"))?,
            };
            target.set(*axis, from + value);
        }
        let frame = if machine { Frame::Machine } else { self.frame(&target) };
        self.position = match kind {
            // Contact may have stopped the move before its target.
            Kind::Probe { .. } => self.position.only(|axis| target.get(axis).is_none()),
            _ => self.position.updated_by(&target),
        };
        Ok(ReadMotion { line: 0, n: None, kind, target, frame, feed_mm_min })
    }

    fn frame(&self, target: &Position) -> Frame {
        let Some(slot) = self.modal.slot else {
            return Frame::Work("an unknown slot".to_owned());
        };
        let zero = self.zeroed.get(slot);
        let is_zero = target.iter().all(|(axis, _)| zero.is_some_and(|axes| axes.contains(&axis)));
        if is_zero && self.modal.g92_off && self.modal.tool_length_off {
            Frame::Machine
        } else {
            Frame::Work(slot.to_owned())
        }
    }
}

const NO_UNITS: &str = "neither G20 nor G21 is set";

fn standing(kind: Kind) -> ReadMotion {
    let (target, frame) = (Position::new(), Frame::Machine);
    ReadMotion { line: 0, n: None, kind, target, frame, feed_mm_min: None }
}

/// Sets `to` from the word of a modal group in the line; a line has at most one word of a group.
fn one_of<T: Copy>(
    words: &mut Words,
    group: &[(u32, T)],
    to: &mut Option<T>,
) -> Result<(), String> {
    let mut found = group.iter().filter(|(g, _)| words.take_g(*g));
    if let Some((_, value)) = found.next() {
        *to = Some(*value);
    }
    match found.next() {
        Some((g, _)) => Err(format!("G{} and another word of its group", f64::from(*g) / 10.0)),
        None => Ok(()),
    }
}

fn refuse_left_over(words: &Words) -> Result<(), String> {
    match words.left_over() {
        Some(word) => Err(format!("{word} is not understood")),
        None => Ok(()),
    }
}
