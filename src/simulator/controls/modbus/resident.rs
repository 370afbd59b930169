//! The resident program of the simulated control: executes the rows of a table one after the other, each in at
//! least one scan, and shows a result until it is acknowledged. Register addresses come from
//! `docs/resident-program.md` alone.

use std::time::Duration;

use super::chunk::{BAD_LENGTH, BAD_ROW};
use super::layout::AXES;
use super::{Entry, FaultKind, Firmware};
use crate::interpreter::Job;
use machine::{Axis, Position};

const NUMBER: u16 = 1;
/// Number of the tool in the spindle. The client sends 0 if it does not check the tool.
const TOOL: u16 = 1;
const NO_SUCH_PROGRAM: u16 = 7;
const OTHER_TOOL: u16 = 8;

/// Size of a row, registers.
const ROW: usize = 16;
/// Positions in the table count in 0.0001 mm or degree, other values in 0.001.
const POSITIONS_PER_UNIT: f64 = 10_000.0;
const VALUES_PER_UNIT: f64 = 1000.0;
/// Scan period of the control's program.
pub(super) const SCAN: Duration = Duration::from_millis(1);

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Rapid,
    Feed,
    Guarded,
    Touch,
    Dwell,
    Orient,
}

#[derive(Debug, Clone)]
struct Row {
    kind: Kind,
    to: Position,
    value: f64,
}

/// A result that is handed to the client.
#[derive(Debug, Clone, Default)]
pub(super) struct Slot {
    pub number: u16,
    pub sequence: u16,
    pub row: u16,
    pub contact: bool,
    pub valid: bool,
    pub latch: Position,
    pub t_s: f64,
}

#[derive(Debug, Default)]
pub(super) struct Resident {
    rows: Vec<Row>,
    step: u32,
    /// Current row, from 1; 0: none.
    pub at: usize,
    pub slot: Slot,
    /// The previous result.
    pub before: Option<Slot>,
    /// Faults: ignores the next acknowledgement; counts a result that it does not show; starts once more where
    /// it should end.
    pub deaf: bool,
    pub skips: bool,
    pub begins_again: bool,
}

impl Resident {
    pub(super) fn is_running(&self) -> bool {
        self.at > 0
    }

    pub(super) fn stop(&mut self) {
        self.rows.clear();
        self.at = 0;
    }

    /// Handles a write of the acknowledge register.
    pub(super) fn acknowledged(&mut self, number: u16) {
        if number == self.slot.number && !std::mem::take(&mut self.deaf) {
            self.slot.valid = false;
        }
    }

    /// The current row.
    fn row(&self) -> Option<&Row> {
        self.at.checked_sub(1).and_then(|place| self.rows.get(place))
    }

    fn touches(&self) -> bool {
        self.row().is_some_and(|row| row.kind == Kind::Touch)
    }

    /// Advances to the next row; returns whether there is one.
    fn advance(&mut self) -> bool {
        self.at = if self.at < self.rows.len() { self.at + 1 } else { 0 };
        self.at > 0
    }
}

impl Firmware {
    /// Starts the program with a complete table.
    pub(super) fn begin_program(&mut self, sequence: u16, words: &[u16]) -> Result<String, u16> {
        let [bound, number, tool, high, low, touches, count, _, table @ ..] = words else {
            return Err(BAD_LENGTH);
        };
        if *number != NUMBER {
            return Err(NO_SUCH_PROGRAM);
        }
        if ![0, TOOL].contains(tool) {
            return Err(OTHER_TOOL);
        }
        if table.len() != ROW * usize::from(*count) || table.is_empty() {
            return Err(BAD_LENGTH);
        }
        let rows: Option<Vec<Row>> = table.chunks(ROW).map(row).collect();
        let rows = rows.filter(|rows| rows.iter().all(|row| self.can(row))).ok_or(BAD_ROW)?;
        let counted = rows.iter().filter(|row| row.kind == Kind::Touch).count();
        if *bound != sequence || counted != usize::from(*touches) {
            return Err(BAD_ROW);
        }
        let step = u32::from(*high) << 16 | u32::from(*low);
        let told: Vec<String> = rows.iter().map(said).collect();
        if let Some(resident) = &mut self.resident {
            (resident.rows, resident.step, resident.at) = (rows, step, 1);
        }
        Ok(format!("step {step}: {}", told.join("; ")))
    }

    fn can(&self, row: &Row) -> bool {
        let moves = matches!(row.kind, Kind::Rapid | Kind::Feed | Kind::Guarded | Kind::Touch);
        let fed = matches!(row.kind, Kind::Rapid | Kind::Orient) || row.value > 0.0;
        fed && row.to.is_empty() != moves && self.options.reader.within_limits(&row.to)
    }

    /// Starts the current row; `false` where no row can start now.
    pub(super) fn next_row(&mut self) -> bool {
        let Some(resident) = &self.resident else { return false };
        let (Some(row), step) = (resident.row().cloned(), resident.step) else { return false };
        if row.kind == Kind::Touch && resident.slot.valid {
            // The slot holds a result that is not acknowledged.
            return false;
        }
        let (to, feed) = (row.to, row.value);
        let job = match row.kind {
            Kind::Rapid => Job::Travel { to, feed_mm_min: None },
            Kind::Feed => Job::Travel { to, feed_mm_min: Some(feed) },
            Kind::Guarded | Kind::Touch => {
                Job::Probe { to, feed_mm_min: feed, strict: false, n: step }
            }
            Kind::Dwell => Job::Dwell { seconds: feed },
            Kind::Orient => Job::Orient { s: Axis::S.from_edge(feed) },
        };
        self.start(job);
        if let Some(active) = &mut self.active {
            active.ends = active.ends.max(self.now + SCAN);
        }
        true
    }

    /// Handles the end of the current row.
    pub(super) fn row_done(&mut self, contact: Option<bool>) {
        let Some(resident) = &self.resident else { return };
        let Some(row) = resident.row() else { return };
        let ends =
            matches!((row.kind, contact), (Kind::Guarded, Some(true)) | (Kind::Touch, Some(false)));
        if row.kind == Kind::Feed && self.tripped() {
            return self.alarm(super::STILL_CLOSED);
        }
        if resident.touches() || ends {
            self.hand_over(contact == Some(true));
        }
        let Some(resident) = &mut self.resident else { return };
        if ends {
            resident.stop();
        } else if !resident.advance() && std::mem::take(&mut resident.begins_again) {
            resident.at = 1;
            self.note(Entry::Wrong(FaultKind::StartedTwice));
        }
    }

    fn hand_over(&mut self, contact: bool) {
        let (latch, t_s, sequence) = (self.latch.clone(), self.latch_time_s, self.accepted);
        let Some(resident) = &mut self.resident else { return };
        let before = resident.slot.clone();
        let skipped = std::mem::take(&mut resident.skips);
        let count = 1 + u16::from(skipped);
        let number = (0..count).fold(before.number, |number, _| number.checked_add(1).unwrap_or(1));
        let row = u16::try_from(resident.at).unwrap_or(u16::MAX);
        resident.slot = Slot { number, sequence, row, contact, valid: true, latch, t_s };
        resident.before = (before.number > 0).then_some(before);
        if skipped {
            self.note(Entry::Wrong(FaultKind::SkippedResult));
        }
    }
}

fn row(words: &[u16]) -> Option<Row> {
    let [kind, axes, high, low, places @ ..] = words else { return None };
    let kind = match kind {
        1 => Kind::Rapid,
        2 => Kind::Feed,
        3 => Kind::Guarded,
        4 => Kind::Touch,
        5 => Kind::Dwell,
        6 => Kind::Orient,
        _ => return None,
    };
    let long = |pair: &[u16]| pair.iter().fold(0_u32, |long, word| long << 16 | u32::from(*word));
    let value = f64::from(long(&[*high, *low])) / VALUES_PER_UNIT;
    let named = AXES.into_iter().zip(places.chunks(2)).zip(0..);
    let named = named.filter(|(_, bit)| axes >> bit & 1 == 1);
    let to = named.map(|((axis, pair), _)| {
        let steps = i32::from_be_bytes(long(pair).to_be_bytes());
        (axis, axis.from_edge(f64::from(steps) / POSITIONS_PER_UNIT))
    });
    (axes >> AXES.len() == 0).then(|| Row { kind, to: to.collect(), value })
}

fn said(row: &Row) -> String {
    let to = row.to.iter().map(|(axis, value)| format!(" {axis}{:.4}", axis.to_edge(value)));
    format!("{:?}{} {}", row.kind, to.collect::<String>(), row.value)
}
