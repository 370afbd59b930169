//! Converts tick numbers to times of the host clock. The servo thread counts ticks; how long after its tick a
//! line arrives is unknown, because lines come in batches and are sometimes late. But no line is early: of all
//! lines within some seconds, the one with the least delay relates the tick number to the time. The remaining
//! delay is constant and belongs to the latency between positions and sensor.

use std::collections::VecDeque;

/// Width of the bins into which ticks are grouped, s.
const BIN_WIDTH_S: f64 = 0.25;
/// Number of bins on each side of a tick's own bin that determine its time: within them, two clocks whose rates differ
/// by 20 ppm diverge by less than 0.1 ms.
const NEIGHBOUR_BINS_PER_SIDE: i64 = 20;
/// Largest excess of a bin's least delay over that of its neighbours, s. A bin with a larger excess is not used: the
/// counting or the transmission was interrupted.
const MAX_EXCESS_BIN_DELAY_S: f64 = 0.02;
/// Maximum number of bins that are kept: half an hour.
const MAX_BINS: usize = 8192;
/// Largest relative deviation of the measured period from the configured one; beyond it the configured period is
/// wrong.
const MAX_RELATIVE_PERIOD_ERROR: f64 = 0.02;

/// A tick, identified by its number within a segment. A restart of the numbers, or ticks that were lost without
/// being counted, begin another segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Tick {
    pub segment_index: u32,
    pub number: i64,
}

impl Tick {
    pub fn is_next_after(self, before: Self) -> bool {
        self.segment_index == before.segment_index && before.number.checked_add(1) == Some(self.number)
    }
}

/// Ticks within `BIN_WIDTH_S`, of which only the least delay is kept.
#[derive(Debug)]
struct TickBin {
    /// Index of the segment, and of the bin within the segment.
    segment_and_bin_index: (u32, i64),
    /// Minimum of the time of arrival minus number times period, s.
    min_arrival_offset_s: f64,
}

/// Relation of the tick numbers to the time of the host clock.
#[derive(Debug)]
pub(super) struct TickClock {
    /// Configured period of the servo thread, s.
    period_s: f64,
    segment_index: u32,
    /// In ascending order, at most `MAX_BINS`.
    bins: VecDeque<TickBin>,
    /// Tick registered last.
    newest_tick: Option<Tick>,
}

impl TickClock {
    pub fn with_period(period_s: f64) -> Self {
        Self { period_s, segment_index: 0, bins: VecDeque::new(), newest_tick: None }
    }

    /// Starts a new segment: the numbers that follow do not continue the previous ones.
    pub fn start_new_segment(&mut self) {
        self.segment_index += 1;
    }

    /// Registers the tick `number` that arrived at `arrival_s`. A number that is not greater than the last one
    /// starts a new segment.
    pub fn register_tick(&mut self, number: i64, arrival_s: f64) -> Tick {
        if self.newest_tick.is_some_and(|last| last.segment_index == self.segment_index && last.number >= number) {
            self.start_new_segment();
        }
        let tick = Tick { segment_index: self.segment_index, number };
        self.newest_tick = Some(tick);
        let (index, min_offset_s) = (self.segment_and_bin_index(tick), arrival_s - self.nominal_time_s(tick));
        match self.bins.back_mut().filter(|bin| bin.segment_and_bin_index == index) {
            Some(bin) => bin.min_arrival_offset_s = bin.min_arrival_offset_s.min(min_offset_s),
            None => self.bins.push_back(TickBin { segment_and_bin_index: index, min_arrival_offset_s: min_offset_s }),
        }
        if self.bins.len() > MAX_BINS {
            self.bins.pop_front();
        }
        tick
    }

    /// Time of the tick on the host clock, s; `None` if no bin shows it reliably.
    pub fn time_s(&self, tick: Tick) -> Option<f64> {
        let (count_index, number) = self.segment_and_bin_index(tick);
        let from = self
            .bins
            .partition_point(|bin| bin.segment_and_bin_index < (count_index, number - NEIGHBOUR_BINS_PER_SIDE));
        let neighbours = || {
            self.bins
                .range(from..)
                .take_while(|bin| bin.segment_and_bin_index <= (count_index, number + NEIGHBOUR_BINS_PER_SIDE))
        };
        let min_offset_s = neighbours().map(|bin| bin.min_arrival_offset_s).fold(f64::INFINITY, f64::min);
        let own = neighbours().find(|bin| bin.segment_and_bin_index == (count_index, number))?;
        (own.min_arrival_offset_s <= min_offset_s + MAX_EXCESS_BIN_DELAY_S)
            .then(|| min_offset_s + self.nominal_time_s(tick))
    }

    /// True period, s, from the bins after `since`; `None` if it agrees with the configured period, or if the bins
    /// are too few or of different segments.
    pub fn true_period_s_if_different(&self, since: Tick) -> Option<f64> {
        let mut bins = self.bins.iter().filter(|bin| bin.segment_and_bin_index > self.segment_and_bin_index(since));
        // The minimum of the last bin is not final: some of its lines are still in transit.
        let (first, last) = (bins.next()?, bins.rev().nth(1)?);
        let elapsed_s = (last.segment_and_bin_index.1 - first.segment_and_bin_index.1) as f64 * BIN_WIDTH_S;
        let relative_error = (last.min_arrival_offset_s - first.min_arrival_offset_s) / elapsed_s;
        (first.segment_and_bin_index.0 == last.segment_and_bin_index.0
            && relative_error.abs() > MAX_RELATIVE_PERIOD_ERROR)
            .then_some(self.period_s * (1.0 + relative_error))
    }

    /// Time since tick 0 of the segment by the configured period, s.
    fn nominal_time_s(&self, tick: Tick) -> f64 {
        tick.number as f64 * self.period_s
    }

    fn segment_and_bin_index(&self, tick: Tick) -> (u32, i64) {
        (tick.segment_index, (self.nominal_time_s(tick) / BIN_WIDTH_S).floor() as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.001;
    /// Time of tick 0, s.
    const TICK_ZERO_TIME_S: f64 = 100.0;

    /// Registers `count` ticks from `first` on in batches of `batch_size`. A batch arrives after its last tick,
    /// with the delay `delay_s` of the batch's number.
    fn feed_ticks(clock: &mut TickClock, (first, count): (i64, i64), batch_size: i64, delay_s: impl Fn(i64) -> f64) {
        for number in first..first + count {
            let batch = number / batch_size;
            let last_tick = batch * batch_size + batch_size - 1;
            clock.register_tick(number, TICK_ZERO_TIME_S + last_tick as f64 * PERIOD_S + delay_s(batch));
        }
    }

    fn time_error_s(ticks: &TickClock, number: i64) -> Option<f64> {
        let time_s = ticks.time_s(Tick { segment_index: 0, number })?;
        Some(((time_s - TICK_ZERO_TIME_S - number as f64 * PERIOD_S) * 1e9).round() / 1e9)
    }

    #[test]
    fn batches_and_jitter_do_not_change_time_stamps() {
        let mut ticks = TickClock::with_period(PERIOD_S);
        // Delays between 0.2 and 9.2 ms, in a sequence that does not repeat soon.
        feed_ticks(&mut ticks, (0, 20_000), 10, |of| 2e-4 + ((of * 37) % 91) as f64 * 1e-4);
        for number in [0, 1, 5, 4_321, 19_999] {
            let off = time_error_s(&ticks, number).unwrap();
            assert!((off - 2e-4).abs() < 1e-9, "tick {number}: off by {off} s");
        }
        assert_eq!(time_error_s(&ticks, -1), None);
        assert_eq!(time_error_s(&ticks, 20_300), None);
    }

    #[test]
    fn small_clock_rate_difference_is_followed() {
        let mut ticks = TickClock::with_period(PERIOD_S);
        feed_ticks(&mut ticks, (0, 600_000), 10, |of| of as f64 * 10.0 * PERIOD_S * 20e-6);
        // The clocks have diverged by 12 ms; each time is off by no more than 0.11 ms, always to the same
        // side.
        for number in [50_000, 300_000, 590_000] {
            let off = time_error_s(&ticks, number).unwrap() - number as f64 * PERIOD_S * 20e-6;
            assert!((-1.1e-4..=0.0).contains(&off), "tick {number}: off by {off} s");
        }
    }

    #[test]
    fn ticks_soon_after_an_interruption_have_no_time() {
        let mut ticks = TickClock::with_period(PERIOD_S);
        // After tick 10000 nothing arrives for 3 s (the sampler was disabled), then the numbers continue.
        feed_ticks(&mut ticks, (0, 10_000), 10, |_| 0.0);
        feed_ticks(&mut ticks, (10_000, 20_000), 10, |_| 3.0);
        assert_eq!(time_error_s(&ticks, 5_000), Some(0.0));
        assert_eq!(time_error_s(&ticks, 12_000), None);
        assert!((time_error_s(&ticks, 20_000).unwrap() - 3.0).abs() < 1e-9);
    }

    #[test]
    fn restarted_counter_starts_a_new_segment() {
        let mut ticks = TickClock::with_period(PERIOD_S);
        feed_ticks(&mut ticks, (5_000, 5_000), 1, |_| 0.0);
        let late_s = TICK_ZERO_TIME_S + 20.0;
        let again = ticks.register_tick(3, late_s);
        assert_eq!((again, ticks.newest_tick), (Tick { segment_index: 1, number: 3 }, Some(again)));
        assert!((ticks.time_s(again).unwrap() - late_s).abs() < 1e-9);
        assert_eq!(time_error_s(&ticks, 7_000), Some(0.0));
        assert!(!Tick { segment_index: 1, number: 4 }.is_next_after(Tick { segment_index: 0, number: 3 }));
    }

    #[test]
    fn wrong_period_is_detected_within_two_seconds() {
        let since = Tick { segment_index: 0, number: 0 };
        for (period_s, wrong) in [(PERIOD_S, None), (0.0005, Some(PERIOD_S)), (0.00095, Some(PERIOD_S))] {
            let mut ticks = TickClock::with_period(period_s);
            feed_ticks(&mut ticks, (0, 2_000), 10, |of| ((of * 37) % 91) as f64 * 1e-4);
            match (ticks.true_period_s_if_different(since), wrong) {
                (None, None) => {}
                (Some(found), Some(true_s)) => {
                    assert!((found / true_s - 1.0).abs() < 0.01, "{found} instead of {true_s}");
                }
                other => panic!("{period_s}: {other:?}"),
            }
        }
    }

    #[test]
    fn bin_count_is_bounded() {
        let mut ticks = TickClock::with_period(BIN_WIDTH_S);
        feed_ticks(&mut ticks, (0, 3 * MAX_BINS as i64), 1, |_| 0.0);
        assert_eq!(ticks.bins.len(), MAX_BINS);
    }
}
