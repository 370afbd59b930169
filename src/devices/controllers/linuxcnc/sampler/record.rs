//! Lines of `halsampler -t`: the number of the tick, the position of each axis, and a bit that is set after
//! ticks for which the sampler had no room. (Those ticks are not counted: the numbers continue as if
//! nothing were lost, contrary to sampler(9). Seen in LinuxCNC 2.9.0.)

use super::ticks::{Tick, Ticks};
use machine::Axis;
use machine::record::track::Track;

/// Maximum length of a line, bytes; longer input is not a line.
const LONGEST: usize = 1024;
/// Maximum number of ticks of one block that are kept: a quarter of an hour at 1 kHz.
const MAX_TICKS: usize = 1_000_000;

/// Positions of the axes at a tick, in the control's own units and degrees.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TickPositions {
    pub tick: Tick,
    pub at: Vec<f64>,
}

#[derive(Debug)]
pub(super) struct Record {
    axes: Vec<Axis>,
    pub ticks: Ticks,
    partial: Vec<u8>,
    pub newest: Option<TickPositions>,
    /// The last line that is not in the sampler's format.
    pub strange: Option<String>,
    /// Ticks of the running block.
    kept: Option<BlockTicks>,
}

#[derive(Debug, Default)]
struct BlockTicks {
    ticks: Vec<Tick>,
    values: Vec<f64>,
    full: bool,
}

impl Record {
    pub fn of(axes: Vec<Axis>, period_s: f64) -> Self {
        let ticks = Ticks::every(period_s);
        Self { axes, ticks, partial: Vec::new(), newest: None, strange: None, kept: None }
    }

    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// Processes bytes that were read at `at_s`.
    pub fn came(&mut self, bytes: &[u8], at_s: f64) {
        for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
            self.partial.extend_from_slice(piece);
            if piece.ends_with(b"\n") {
                let line = std::mem::take(&mut self.partial);
                self.line(String::from_utf8_lossy(&line).trim(), at_s);
            } else if self.partial.len() > LONGEST {
                self.partial.clear();
                self.strange = Some(format!("{LONGEST} bytes without a line's end"));
            }
        }
    }

    /// Handles bytes that were lost before they were read.
    pub fn missed(&mut self) {
        self.partial.clear();
    }

    fn line(&mut self, line: &str, at_s: f64) {
        // The numbers that follow show which ticks are missing.
        if line == "overrun" {
            return;
        }
        let Some((number, at, full)) = understood(line, self.axes.len()) else {
            self.strange = Some(line.chars().take(80).collect());
            return;
        };
        if full {
            self.ticks.begin_anew();
        }
        let tick = self.ticks.came(number, at_s);
        if let Some(kept) = &mut self.kept {
            kept.full |= kept.ticks.len() >= MAX_TICKS;
            if !kept.full {
                kept.ticks.push(tick);
                kept.values.extend(&at);
            }
        }
        self.newest = Some(TickPositions { tick, at });
    }

    /// Starts to keep all ticks.
    pub fn begin(&mut self) {
        self.kept = Some(BlockTicks::default());
    }

    /// Returns the ticks kept since [`Self::begin`], with the times as they are known now; `None` if there
    /// were too many.
    pub fn end(&mut self, mm: f64) -> Option<Track> {
        let kept = self.kept.take().unwrap_or_default();
        let mut track = Track::of(self.axes.clone());
        let mut before = None;
        for (tick, at) in kept.ticks.iter().zip(kept.values.chunks(self.axes.len().max(1))) {
            if !before.is_some_and(|before| tick.follows(before)) {
                track.gap();
            }
            before = self.ticks.time_s(*tick).map(|t_s| {
                track.push(t_s, self.inside(at, mm));
                *tick
            });
        }
        (!kept.full).then_some(track)
    }

    /// Converts positions to mm and rad; `mm` is the control's unit of length, mm.
    pub fn inside<'a>(&'a self, at: &'a [f64], mm: f64) -> impl Iterator<Item = f64> + 'a {
        let scaled = move |(axis, at): (&Axis, &f64)| match axis.is_linear() {
            true => at * mm,
            false => axis.from_edge(*at),
        };
        self.axes.iter().zip(at).map(scaled)
    }
}

/// Returns the number of the tick, `axes` positions, and whether ticks before it are missing.
fn understood(line: &str, axes: usize) -> Option<(i64, Vec<f64>, bool)> {
    let mut words = line.split_whitespace();
    let number = words.next()?.parse().ok()?;
    let at: Vec<f64> = words
        .by_ref()
        .take(axes)
        .map(|word| word.parse().ok().filter(|value: &f64| value.is_finite()))
        .collect::<Option<_>>()?;
    let full = match (words.next()?, words.next()) {
        ("0", None) => false,
        ("1", None) => true,
        _ => return None,
    };
    (at.len() == axes).then_some((number, at, full))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn record() -> Record {
        Record::of(vec![Axis::X, Axis::C], 0.001)
    }

    /// Adds a line for each tick, as halsampler writes it; X is a tenth of the number, C is at 90°.
    fn lines(record: &mut Record, numbers: impl IntoIterator<Item = i64>) {
        for number in numbers {
            let x = number as f64 / 10.0;
            let line = format!("{number} {x:.6} 90.000000 0 \n");
            record.came(line.as_bytes(), number as f64 * 0.001);
        }
    }

    #[test]
    fn lines_however_they_are_cut_become_a_track() {
        let text = b"overrun\n7 1.500000 90.000000 0 \n8 2.500000 -90.000000 0 \n";
        for cut in 0..text.len() {
            let mut record = record();
            record.begin();
            record.came(&text[..cut], 0.008);
            record.came(&text[cut..], 0.008);
            assert_eq!(record.strange, None);
            let track = record.end(25.4).unwrap();
            let at = track.at(0.0075).unwrap();
            assert!(
                (at.at(Axis::X) - 2.0 * 25.4).abs() < 1e-9 && at.at(Axis::C).abs() < 1e-9,
                "{at:?}"
            );
            let first = track.at(0.007 + 1e-9).unwrap();
            assert!((first.at(Axis::C) - FRAC_PI_2).abs() < 1e-5);
        }
    }

    #[test]
    fn missing_ticks_and_an_overrun_are_gaps() {
        let mut record = record();
        lines(&mut record, 0..10);
        record.begin();
        lines(&mut record, (10..20).chain(23..30));
        record.came(b"overrun\n", 0.031);
        lines(&mut record, 35..40);
        let track = record.end(1.0).unwrap();
        assert_eq!((track.positions(), track.gaps()), (22, 2));
        assert_eq!(track.at(0.009), None);
        assert!((track.at(0.0155).unwrap().at(Axis::X) - 1.55).abs() < 1e-9);
        assert_eq!((track.at(0.021), track.at(0.032)), (None, None));
        assert_eq!(record.end(1.0).unwrap().positions(), 0);
    }

    #[test]
    fn after_ticks_without_room_the_count_begins_anew() {
        let mut record = record();
        record.begin();
        lines(&mut record, 0..100);
        // Half a second has passed that the numbers do not count.
        record.came(b"100 10.000000 90.000000 1 \n101 10.100000 90.000000 0 \n", 0.601);
        let track = record.end(1.0).unwrap();
        assert_eq!(track.gaps(), 1);
        assert!((track.at(0.6 + 1e-9).unwrap().at(Axis::X) - 10.0).abs() < 1e-5);
        assert_eq!((track.at(0.1), track.at(0.3)), (None, None));
    }

    #[test]
    fn what_is_no_line_of_the_sampler_is_told() {
        for line in
            ["1 2 0", "1 2 3", "1 2 3 4 0", "1 2 3 2", "x 2 3 0", "1 nan 3 0", "1.5 2 3 0", ""]
        {
            let mut record = record();
            record.came(format!("{line}\n").as_bytes(), 0.0);
            assert_eq!((record.newest, record.strange.as_deref()), (None, Some(line)));
        }
        let mut record = record();
        for _ in 0..100 {
            record.came(&[b'7'; 500], 0.0);
        }
        assert!(record.strange.is_some() && record.partial.len() <= LONGEST + 500);
    }

    #[test]
    fn more_than_is_kept_is_no_track() {
        let mut record = record();
        record.begin();
        lines(&mut record, 0..MAX_TICKS as i64 + 1);
        assert_eq!(record.end(1.0), None);
    }
}
