//! One scan in motion: the samples of a sensor with the axis positions that the control reports for their
//! times.

use devices::sensors::Sample;
use machine::Position;
use machine::record::axis_track::AxisTrack;

/// Maximum deviation of a controlled axis at rest, mm or rad.
pub(super) const REST_TOLERANCE_MM_OR_RAD: f64 = 0.002;
/// Maximum ratio of the sensor's rate to the planned rate at which no sample is left out.
const MAX_UNTHINNED_RATE_RATIO: f64 = 1.02;
/// Number of samples of a group whose rate is one value of the median.
const RATE_WINDOW_SAMPLES: usize = 50;
/// Maximum distance from a path point, mm or rad, at which the reported path counts as having reached the point: the
/// axes lag behind their commands and stop at the points.
const PATH_POINT_TOLERANCE_MM_OR_RAD: f64 = 0.2;

/// Reason why a track does not cover all of `path`, or `None` if it does. Without this check, samples
/// missing beyond the ends of the track would not be detected.
pub(super) fn reason_for_uncovered_path(track: &AxisTrack, path: &[Position]) -> Option<String> {
    let reached = track.reached_point_count(path, PATH_POINT_TOLERANCE_MM_OR_RAD);
    (reached < path.len())
        .then(|| format!("the control reported the time of only {reached} of the {} points on the path", path.len()))
}

/// Samples with the axis positions at their times.
#[derive(Debug, Default)]
pub(super) struct PositionedSamples {
    pub samples: Vec<(Sample, Position)>,
    /// Number of samples taken in motion, and not left out by rate, at a time without a position from the control.
    pub without_position_count: usize,
    /// Number of samples left out because the sensor is faster than the planned rate.
    pub dropped_by_rate_count: usize,
}

/// The `samples` taken while the axes of `track` moved, at most `rate_hz` per second.
pub(super) fn assign_positions(samples: &[Sample], track: &AxisTrack, rate_hz: f64) -> PositionedSamples {
    let Some((from_s, to_s)) = track.motion_interval_s(REST_TOLERANCE_MM_OR_RAD) else {
        return PositionedSamples::default();
    };
    let moving = samples.iter().filter(|sample| (from_s..=to_s).contains(&sample.received_s));
    let positions = moving.map(|sample| (*sample, track.position_at(sample.received_s)));
    limit_sample_rate(&positions.collect::<Vec<_>>(), rate_hz)
}

/// At most `rate_hz` samples per second with their positions. `None`: the position is unknown.
pub(super) fn limit_sample_rate(samples: &[(Sample, Option<Position>)], rate_hz: f64) -> PositionedSamples {
    let mut placed = PositionedSamples::default();
    let keep = kept_share(samples, rate_hz);
    let mut due = 1.0;
    for (sample, position) in samples {
        // Samples are selected by number and not by time, because sample times have jitter.
        due += keep * (1.0 + f64::from(sample.lost_before_count));
        if due < 1.0 {
            placed.dropped_by_rate_count += 1;
            continue;
        }
        due = (due - 1.0).min(1.0 - f64::EPSILON);
        match position {
            Some(position) => placed.samples.push((*sample, position.clone())),
            None => placed.without_position_count += 1,
        }
    }
    placed
}

/// Share of `samples` that is kept, at most 1. Sample times have jitter, and a counter that wraps reports far too
/// many missing samples. The rate is therefore the median over groups of [`RATE_WINDOW_SAMPLES`] samples.
fn kept_share(samples: &[(Sample, Option<Position>)], rate_hz: f64) -> f64 {
    let own_hz = |window: &[(Sample, Option<Position>)]| {
        let ((first, _), rest) = window.split_first()?;
        let came: f64 = rest.iter().map(|(sample, _)| 1.0 + f64::from(sample.lost_before_count)).sum();
        Some(came / (rest.last()?.0.received_s - first.received_s))
    };
    let mut rates: Vec<f64> = samples.chunks(RATE_WINDOW_SAMPLES).filter_map(own_hz).collect();
    rates.sort_by(f64::total_cmp);
    let own_hz = rates.get(rates.len() / 2).copied().unwrap_or_default();
    if own_hz > rate_hz * MAX_UNTHINNED_RATE_RATIO { rate_hz / own_hz } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::Axis;
    use machine::record::reading::ReadingFlag;

    fn x_position(at: f64) -> Position {
        Position::new().with(Axis::X, at)
    }

    /// X moves from 0 to 10 mm within 10 s, stamped every 0.1 s from 10 s before to 10 s after the motion; no
    /// stamps from 2.95 to 4.05 s.
    fn straight_track() -> AxisTrack {
        let mut track = AxisTrack::new(vec![Axis::X]);
        for number in -100_i32..=200 {
            let t_s = f64::from(number) * 0.1;
            if (2.95..4.05).contains(&t_s) {
                track.record_gap();
            } else {
                track.push(t_s, [t_s.clamp(0.0, 10.0)]);
            }
        }
        track
    }

    /// A sample every 4 ms whose value is its time.
    fn evenly_timed_samples() -> Vec<Sample> {
        let sample = |number: i32| {
            let t_s = f64::from(number) * 0.004 + 0.001;
            Sample {
                received_s: t_s,
                value_mm: Some(t_s),
                flag: ReadingFlag::None,
                lost_before_count: 0,
                encoder_count: None,
            }
        };
        (-1000..4000).map(sample).collect()
    }

    #[test]
    fn each_sample_has_the_position_of_its_own_time() {
        let placed = assign_positions(&evenly_timed_samples(), &straight_track(), 1000.0);
        for (sample, position) in &placed.samples {
            assert!((position.get_or_zero(Axis::X) - sample.received_s).abs() < 1e-9, "{sample:?} {position:?}");
        }
        // Ten seconds minus the gap from 2.9 to 4.1 s.
        assert!((2200 - placed.samples.len() as i32).abs() <= 2, "{}", placed.samples.len());
        assert!((300 - placed.without_position_count as i32).abs() <= 2, "{}", placed.without_position_count);
        assert_eq!(placed.dropped_by_rate_count, 0);
    }

    #[test]
    fn fast_sensor_is_thinned_by_omission() {
        let placed = assign_positions(&evenly_timed_samples(), &straight_track(), 100.0);
        let times: Vec<f64> = placed.samples.iter().map(|(sample, _)| sample.received_s).collect();
        assert!((880 - times.len() as i32).abs() <= 2, "{}", times.len());
        // Kept samples are two or three sensor periods apart, and no sample is interpolated.
        for pair in times.windows(2).filter(|pair| pair[1] < 2.9 || pair[0] > 4.1) {
            let periods = (pair[1] - pair[0]) / 0.004;
            assert!((1.99..3.01).contains(&periods), "{pair:?}");
        }
        assert!(
            evenly_timed_samples().iter().filter(|sample| times.contains(&sample.received_s)).count() == times.len()
        );
    }

    #[test]
    fn track_without_motion_gives_no_samples() {
        let mut still = AxisTrack::new(vec![Axis::X]);
        for number in 0..100 {
            still.push(f64::from(number), [5.0 + 0.001 * f64::from(number % 2)]);
        }
        assert!(assign_positions(&evenly_timed_samples(), &still, 1000.0).samples.is_empty());
    }

    /// A counter that wraps reports tens of thousands of missing samples. This number must not
    /// cause the loss of other samples.
    #[test]
    fn implausible_lost_counts_do_not_change_the_thinning() {
        let mut samples = evenly_timed_samples();
        samples[1500].lost_before_count = 60_000;
        samples[2000].lost_before_count = u32::MAX;
        samples[2100].lost_before_count = u32::MAX;
        assert_eq!(assign_positions(&samples, &straight_track(), 1000.0).dropped_by_rate_count, 0);
        let dropped_by_rate = assign_positions(&samples, &straight_track(), 100.0);
        assert!((880 - dropped_by_rate.samples.len() as i32).abs() <= 4, "{}", dropped_by_rate.samples.len());
    }

    #[test]
    fn track_must_cover_the_begin_and_end_of_the_path() {
        let path = |points: &[f64]| points.iter().map(|at| x_position(*at)).collect::<Vec<Position>>();
        assert_eq!(reason_for_uncovered_path(&straight_track(), &path(&[0.0, 10.0])), None);
        let why = reason_for_uncovered_path(&straight_track(), &path(&[0.0, 10.0, 0.0])).unwrap();
        assert!(why.contains("2 of the 3 points"), "{why}");
        assert!(reason_for_uncovered_path(&straight_track(), &path(&[-1.0, 10.0])).unwrap().contains("0 of the 2"));
    }
}
