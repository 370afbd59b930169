//! Lines of `halsampler -t`: the number of the tick, the position of each axis, and a bit that is set after
//! ticks for which the sampler had no room. (Those ticks are not counted: the numbers continue as if
//! nothing were lost, contrary to sampler(9). Seen in LinuxCNC 2.9.0.)

use super::tick_clock::{Tick, TickClock};
use crate::finite_numbers::parse_finite_numbers;
use machine::Axis;
use machine::record::axis_track::AxisTrack;

/// Maximum length of an incomplete line, bytes. A longer input without a line end is discarded.
const MAX_LINE_BYTES: usize = 1024;
/// Maximum number of ticks of one block, a quarter of an hour at 1 kHz: a block with more ticks has no track.
const MAX_BLOCK_TICKS: usize = 1_000_000;

/// Positions at a tick, one for each axis of the record in its order, in the control's own unit of length and in
/// degrees.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TickPositions {
    pub tick: Tick,
    pub positions: Vec<f64>,
}

/// Parses the sampler's lines and times their ticks; while a block runs, it also keeps all ticks of the block.
#[derive(Debug)]
pub(super) struct TickRecord {
    axes: Vec<Axis>,
    pub tick_clock: TickClock,
    /// Start of a line whose end has not been received.
    partial_line: Vec<u8>,
    /// Positions of the last valid line, whether a recording runs or not; `None` before the first one.
    pub newest_positions: Option<TickPositions>,
    /// Start of the last line that is not in the sampler's format, or a message about a line without an end; a valid
    /// line does not clear it.
    pub last_invalid_line: Option<String>,
    /// Ticks of the running block; `None` if no recording runs.
    block_ticks: Option<MotionBlockTicks>,
}

/// All ticks of one recording, with their positions.
#[derive(Debug, Default)]
struct MotionBlockTicks {
    ticks: Vec<Tick>,
    /// The positions of the ticks, flat: one value per axis for each tick, in the control's units.
    flat_positions: Vec<f64>,
    /// Whether a tick was dropped because [`MAX_BLOCK_TICKS`] ticks were kept.
    is_full: bool,
}

impl TickRecord {
    /// `axes`: axes in the order of a line's positions. `period_s`: configured period of a tick.
    pub fn new(axes: Vec<Axis>, period_s: f64) -> Self {
        let tick_clock = TickClock::with_period(period_s);
        Self {
            axes,
            tick_clock,
            partial_line: Vec::new(),
            newest_positions: None,
            last_invalid_line: None,
            block_ticks: None,
        }
    }

    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// Processes bytes that were read at `read_s` of the host clock.
    pub fn push_bytes(&mut self, bytes: &[u8], read_s: f64) {
        for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
            self.partial_line.extend_from_slice(piece);
            if piece.ends_with(b"\n") {
                let line = std::mem::take(&mut self.partial_line);
                self.process_line(String::from_utf8_lossy(&line).trim(), read_s);
            } else if self.partial_line.len() > MAX_LINE_BYTES {
                self.partial_line.clear();
                self.last_invalid_line = Some(format!("{MAX_LINE_BYTES} bytes without a line end"));
            }
        }
    }

    /// Discards the incomplete line: bytes after it were lost before they were read.
    pub fn discard_partial_line(&mut self) {
        self.partial_line.clear();
    }

    /// Processes a line without its end. A line in another format is stored as `last_invalid_line` and otherwise
    /// ignored; the line `overrun` is only ignored.
    fn process_line(&mut self, line: &str, read_s: f64) {
        // The numbers that follow show which ticks are missing.
        if line == "overrun" {
            return;
        }
        let Some((number, at, has_missing_ticks)) = parse_tick_line(line, self.axes.len()) else {
            self.last_invalid_line = Some(line.chars().take(80).collect());
            return;
        };
        if has_missing_ticks {
            self.tick_clock.start_new_segment();
        }
        let tick = self.tick_clock.register_tick(number, read_s);
        if let Some(block_ticks) = &mut self.block_ticks {
            block_ticks.is_full |= block_ticks.ticks.len() >= MAX_BLOCK_TICKS;
            if !block_ticks.is_full {
                block_ticks.ticks.push(tick);
                block_ticks.flat_positions.extend(&at);
            }
        }
        self.newest_positions = Some(TickPositions { tick, positions: at });
    }

    /// Starts to keep all ticks; discards the ticks of an earlier recording.
    pub fn start_recording(&mut self) {
        self.block_ticks = Some(MotionBlockTicks::default());
    }

    /// Ends the recording. Returns its positions, mm and rad, at times of the host clock; missing ticks and ticks
    /// without a known time are gaps. `None` if there were more than [`MAX_BLOCK_TICKS`] ticks; an empty track if no
    /// recording was running.
    pub fn finish_recording(&mut self, mm_per_unit: f64) -> Option<AxisTrack> {
        let block_ticks = self.block_ticks.take().unwrap_or_default();
        let mut track = AxisTrack::new(self.axes.clone());
        let mut before = None;
        for (tick, at) in block_ticks.ticks.iter().zip(block_ticks.flat_positions.chunks(self.axes.len().max(1))) {
            if !before.is_some_and(|before| tick.is_next_after(before)) {
                track.record_gap();
            }
            before = self.tick_clock.time_s(*tick).map(|t_s| {
                track.push(t_s, self.to_internal_units(at, mm_per_unit));
                *tick
            });
        }
        (!block_ticks.is_full).then_some(track)
    }

    /// Converts positions to mm and rad; `mm_per_unit` is the control's unit of length, mm.
    pub fn to_internal_units<'a>(&'a self, positions: &'a [f64], mm_per_unit: f64) -> impl Iterator<Item = f64> + 'a {
        let scaled = move |(axis, position): (&Axis, &f64)| match axis.is_linear() {
            true => position * mm_per_unit,
            false => axis.to_mm_or_rad(*position),
        };
        self.axes.iter().zip(positions).map(scaled)
    }
}

/// Returns the number of the tick, `axis_count` positions, and whether ticks before it are missing; `None` if the
/// line is not in this format.
fn parse_tick_line(line: &str, axis_count: usize) -> Option<(i64, Vec<f64>, bool)> {
    let mut words = line.split_whitespace();
    let number = words.next()?.parse().ok()?;
    let at = parse_finite_numbers(words.by_ref().take(axis_count))?;
    let has_missing_ticks = match (words.next()?, words.next()) {
        ("0", None) => false,
        ("1", None) => true,
        _ => return None,
    };
    (at.len() == axis_count).then_some((number, at, has_missing_ticks))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn new_record() -> TickRecord {
        TickRecord::new(vec![Axis::X, Axis::C], 0.001)
    }

    /// Adds a line for each tick, as halsampler writes it; X is a tenth of the number, C is at 90°.
    fn push_lines(record: &mut TickRecord, numbers: impl IntoIterator<Item = i64>) {
        for number in numbers {
            let x = number as f64 / 10.0;
            let line = format!("{number} {x:.6} 90.000000 0 \n");
            record.push_bytes(line.as_bytes(), number as f64 * 0.001);
        }
    }

    #[test]
    fn lines_split_anywhere_give_the_same_track() {
        let text = b"overrun\n7 1.500000 90.000000 0 \n8 2.500000 -90.000000 0 \n";
        for cut in 0..text.len() {
            let mut record = new_record();
            record.start_recording();
            record.push_bytes(&text[..cut], 0.008);
            record.push_bytes(&text[cut..], 0.008);
            assert_eq!(record.last_invalid_line, None);
            let track = record.finish_recording(25.4).unwrap();
            let at = track.position_at(0.0075).unwrap();
            assert!(
                (at.get_or_zero(Axis::X) - 2.0 * 25.4).abs() < 1e-9 && at.get_or_zero(Axis::C).abs() < 1e-9,
                "{at:?}"
            );
            let first = track.position_at(0.007 + 1e-9).unwrap();
            assert!((first.get_or_zero(Axis::C) - FRAC_PI_2).abs() < 1e-5);
        }
    }

    #[test]
    fn missing_ticks_and_an_overrun_are_gaps() {
        let mut record = new_record();
        push_lines(&mut record, 0..10);
        record.start_recording();
        push_lines(&mut record, (10..20).chain(23..30));
        record.push_bytes(b"overrun\n", 0.031);
        push_lines(&mut record, 35..40);
        let track = record.finish_recording(1.0).unwrap();
        assert_eq!((track.position_count(), track.gap_count()), (22, 2));
        assert_eq!(track.position_at(0.009), None);
        assert!((track.position_at(0.0155).unwrap().get_or_zero(Axis::X) - 1.55).abs() < 1e-9);
        assert_eq!((track.position_at(0.021), track.position_at(0.032)), (None, None));
        assert_eq!(record.finish_recording(1.0).unwrap().position_count(), 0);
    }

    #[test]
    fn ticks_after_an_overrun_are_timed_anew_after_a_gap() {
        let mut record = new_record();
        record.start_recording();
        push_lines(&mut record, 0..100);
        // Half a second has passed that the numbers do not count.
        record.push_bytes(b"100 10.000000 90.000000 1 \n101 10.100000 90.000000 0 \n", 0.601);
        let track = record.finish_recording(1.0).unwrap();
        assert_eq!(track.gap_count(), 1);
        assert!((track.position_at(0.6 + 1e-9).unwrap().get_or_zero(Axis::X) - 10.0).abs() < 1e-5);
        assert_eq!((track.position_at(0.1), track.position_at(0.3)), (None, None));
    }

    #[test]
    fn invalid_sampler_line_is_reported() {
        for line in ["1 2 0", "1 2 3", "1 2 3 4 0", "1 2 3 2", "x 2 3 0", "1 nan 3 0", "1.5 2 3 0", ""] {
            let mut record = new_record();
            record.push_bytes(format!("{line}\n").as_bytes(), 0.0);
            assert_eq!((record.newest_positions, record.last_invalid_line.as_deref()), (None, Some(line)));
        }
        let mut record = new_record();
        for _ in 0..100 {
            record.push_bytes(&[b'7'; 500], 0.0);
        }
        assert!(record.last_invalid_line.is_some() && record.partial_line.len() <= MAX_LINE_BYTES + 500);
    }

    #[test]
    fn record_longer_than_the_buffer_gives_no_track() {
        let mut record = new_record();
        record.start_recording();
        push_lines(&mut record, 0..MAX_BLOCK_TICKS as i64 + 1);
        assert_eq!(record.finish_recording(1.0), None);
    }
}
