//! One scan in motion: what a sensor said on the way, put to where the control says that the axes stood.

use crate::base::Position;
use crate::record::motion::{Block, Motion};
use crate::record::track::Track;
use crate::sensors::Sample;

/// Positions are the same so near, mm or rad: what is written with six decimals.
const SAME: f64 = 2e-6;
/// An axis under control stands still so nearly, mm or rad.
const STILL: f64 = 0.002;
/// A sensor that is faster by no more than this is as fast as the plan wants it.
const AS_FAST: f64 = 1.02;

/// The way to `first` and the rest of the motions, each a block of its own: on the way to the first point a
/// sensor may see nothing.
pub(super) fn apart(blocks: Vec<Block>, first: &Position) -> Option<(Block, Block)> {
    let mut way = blocks.first()?.clone();
    way.motions = blocks.into_iter().flat_map(|block| block.motions).collect();
    let mut stands = Position::new();
    let arrives = way.motions.iter().position(|motion| match motion {
        Motion::Feed { to, .. } => {
            stands = stands.updated_by(to);
            is_at(&stands, first)
        }
        Motion::Rapid { to } => {
            stands = stands.updated_by(to);
            false
        }
        _ => false,
    })?;
    let motions = way.motions.split_off(arrives + 1);
    let scan = Block { motions, ..way };
    (!scan.motions.is_empty()).then_some((way, scan))
}

/// Whether nothing of `stands` is elsewhere; where an axis did not have to move nothing is known of it.
fn is_at(stands: &Position, first: &Position) -> bool {
    stands.iter().all(|(axis, at)| first.get(axis).is_none_or(|first| (first - at).abs() <= SAME))
}

/// Samples with the positions at which their axes stood.
#[derive(Debug, Default)]
pub(super) struct Placed {
    pub samples: Vec<(Sample, Position)>,
    /// Taken while the axes moved, at a time of which the control says nothing.
    pub nowhere: usize,
    /// Left out because the sensor is faster than the plan wants.
    pub thinned: usize,
}

/// What of `samples` was taken while the axes of `track` moved, at most `rate_hz` a second.
pub(super) fn placed(samples: &[Sample], track: &Track, rate_hz: f64) -> Placed {
    let mut placed = Placed::default();
    let Some((from_s, to_s)) = track.moving_s(STILL) else { return placed };
    let meant: Vec<&Sample> =
        samples.iter().filter(|sample| (from_s..=to_s).contains(&sample.t_s)).collect();
    let keep = share(&meant, rate_hz);
    let mut due = 1.0;
    for sample in meant {
        // By number and not by time: samples come with jitter.
        due += keep * f64::from(1 + sample.missing);
        if due < 1.0 {
            placed.thinned += 1;
            continue;
        }
        due = (due - 1.0).min(1.0 - f64::EPSILON);
        match track.at(sample.t_s) {
            Some(position) => placed.samples.push((*sample, position)),
            None => placed.nowhere += 1,
        }
    }
    placed
}

/// The share of `samples` that is kept.
fn share(samples: &[&Sample], rate_hz: f64) -> f64 {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return 1.0 };
    let missing: u32 = samples.iter().skip(1).map(|sample| sample.missing).sum();
    let own_hz = ((samples.len() - 1) as f64 + f64::from(missing)) / (last.t_s - first.t_s);
    if own_hz > rate_hz * AS_FAST { rate_hz / own_hz } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Axis;
    use crate::record::reading::Flag;

    fn x(at: f64) -> Position {
        Position::new().with(Axis::X, at)
    }

    fn feed(to: Position) -> Motion {
        Motion::Feed { to, feed_mm_min: 600.0 }
    }

    /// X from 0 to 10 mm within 10 s, stamped every 0.1 s from 10 s before to 10 s after; none between
    /// 2.95 and 4.05 s.
    fn track() -> Track {
        let mut track = Track::of(vec![Axis::X]);
        for number in -100_i32..=200 {
            let t_s = f64::from(number) * 0.1;
            if (2.95..4.05).contains(&t_s) {
                track.gap();
            } else {
                track.push(t_s, [t_s.clamp(0.0, 10.0)]);
            }
        }
        track
    }

    /// Every 4 ms; the value is the time.
    fn samples() -> Vec<Sample> {
        let sample = |number: i32| {
            let t_s = f64::from(number) * 0.004 + 0.001;
            Sample { t_s, value_mm: Some(t_s), flag: Flag::None, missing: 0 }
        };
        (-1000..4000).map(sample).collect()
    }

    #[test]
    fn each_sample_has_the_position_of_its_own_time() {
        let placed = placed(&samples(), &track(), 1000.0);
        for (sample, position) in &placed.samples {
            assert!((position.at(Axis::X) - sample.t_s).abs() < 1e-9, "{sample:?} {position:?}");
        }
        // Ten seconds, less the gap from 2.9 to 4.1 s.
        assert!((2200 - placed.samples.len() as i32).abs() <= 2, "{}", placed.samples.len());
        assert!((300 - placed.nowhere as i32).abs() <= 2, "{}", placed.nowhere);
        assert_eq!(placed.thinned, 0);
    }

    #[test]
    fn a_fast_sensor_is_thinned_by_leaving_out() {
        let placed = placed(&samples(), &track(), 100.0);
        let times: Vec<f64> = placed.samples.iter().map(|(sample, _)| sample.t_s).collect();
        assert!((880 - times.len() as i32).abs() <= 2, "{}", times.len());
        // Two or three periods of the sensor apart, and never between two of its samples.
        for pair in times.windows(2).filter(|pair| pair[1] < 2.9 || pair[0] > 4.1) {
            let periods = (pair[1] - pair[0]) / 0.004;
            assert!((1.99..3.01).contains(&periods), "{pair:?}");
        }
        assert!(
            samples().iter().filter(|sample| times.contains(&sample.t_s)).count() == times.len()
        );
    }

    #[test]
    fn what_stood_still_all_the_while_is_no_scan() {
        let mut still = Track::of(vec![Axis::X]);
        for number in 0..100 {
            still.push(f64::from(number), [5.0 + 0.001 * f64::from(number % 2)]);
        }
        assert!(placed(&samples(), &still, 1000.0).samples.is_empty());
    }

    #[test]
    fn the_way_to_the_first_point_is_a_block_of_its_own() {
        let first = x(-10.0).with(Axis::Z, 60.0).with(Axis::C, 0.0);
        let up = Position::new().with(Axis::Z, 200.0);
        let motions = vec![
            Motion::Rapid { to: up },
            Motion::Rapid { to: x(-10.0) },
            Motion::Rapid { to: Position::new().with(Axis::Z, 70.0) },
            feed(Position::new().with(Axis::Z, 60.0)),
            feed(x(10.0)),
            feed(x(-10.0)),
        ];
        let block = Block { step: 7, repeat: 1, motions };
        let (way, scan) = apart(vec![block.clone()], &first).unwrap();
        assert_eq!((way.motions.len(), scan.motions.len()), (4, 2));
        assert_eq!((scan.step, scan.repeat), (7, 1));
        let mut none = block.clone();
        none.motions.truncate(4);
        assert_eq!(apart(vec![none], &first), None);
        assert_eq!(apart(vec![block], &x(3.0)), None);
    }
}
