//! Values at stops at equal angles.

use std::f64::consts::TAU;

use faer::Mat;

use super::resample::{AngleSample, ResampledChannel};
use crate::linear_least_squares::{self, LinearProblem, RANK_THRESHOLD};

/// Maximum share of the stops of a revolution that may be missing; if more are missing, none is filled.
const MAX_FILLED_STOP_SHARE: f64 = 0.15;
/// Maximum distance of a sample from its stop, relative to the distance between two stops.
const MAX_OFFSET_FROM_STOP_STEPS: f64 = 1e-6;

/// A scan with stops at equal angles.
#[derive(Debug, Clone, Copy)]
pub struct StopScan {
    /// Number of stops in one revolution.
    pub stops_per_revolution: usize,
    /// Unwrapped angles of the ends, in either order, rad.
    pub ends_rad: [f64; 2],
    /// Number of harmonics used to fill a few missing stops. `None`: missing stops are not filled.
    pub fill_harmonic_count: Option<usize>,
}

impl StopScan {
    /// Index of the stop nearest to an unwrapped angle; index 0 is at angle 0.
    pub fn stop_index(self, angle_rad: f64) -> i64 {
        (angle_rad.to_degrees() / 360.0 * self.stops_per_revolution as f64).round() as i64
    }

    /// Whether all samples, the invalid ones included, are at stops and none is between two stops.
    pub fn has_all_samples_at_stops(self, samples: &[AngleSample]) -> bool {
        let step = TAU / self.stops_per_revolution as f64;
        let is_at_stop = |angle: f64| (angle / step - (angle / step).round()).abs() < MAX_OFFSET_FROM_STOP_STEPS;
        samples.iter().all(|sample| is_at_stop(sample.angle_rad))
    }

    /// Mean of the valid samples at each stop. A few missing stops are filled from the harmonics of the others.
    pub fn mean_at_stops(self, samples: &[AngleSample]) -> ResampledChannel {
        let [one, other] = self.ends_rad.map(|end| self.stop_index(end));
        let (first, last) = (one.min(other), one.max(other));
        let mut sums = vec![(0.0, 0.0); (last - first + 1) as usize];
        for sample in samples.iter().filter(|sample| sample.is_valid) {
            let cell = usize::try_from(self.stop_index(sample.angle_rad) - first).ok();
            if let Some((sum, count)) = cell.and_then(|cell| sums.get_mut(cell)) {
                (*sum, *count) = (*sum + sample.value, *count + 1.0);
            }
        }
        let mean = |(sum, count): (f64, f64)| (count > 0.0).then_some(sum / count);
        let mut values: Vec<Option<f64>> = sums.into_iter().map(mean).collect();
        if let Some(harmonics) = self.fill_harmonic_count {
            let revolutions = values.chunks_mut(self.stops_per_revolution);
            revolutions.for_each(|revolution| fill_missing_stops(revolution, harmonics, self.stops_per_revolution));
        }
        ResampledChannel::from_stop_values(self.stops_per_revolution, first, values)
    }
}

/// Fills missing stops of a whole revolution from the least-squares fit of its mean and harmonics, so that the
/// harmonics of the filled revolution are those of the measured stops. Nothing is filled if more than
/// stops/(2·harmonics) adjacent stops are missing, or more than [`MAX_FILLED_STOP_SHARE`].
fn fill_missing_stops(values: &mut [Option<f64>], harmonic_count: usize, stops_per_revolution: usize) {
    let missing: Vec<usize> = (0..values.len()).filter(|i| values[*i].is_none()).collect();
    let known: Vec<usize> = (0..values.len()).filter(|i| values[*i].is_some()).collect();
    let longest = stops_per_revolution / (2 * harmonic_count.max(1));
    let is_long = missing.windows(longest + 1).any(|run| run[longest] - run[0] == longest);
    if missing.is_empty()
        || is_long
        || values.len() < stops_per_revolution
        || missing.len() > (MAX_FILLED_STOP_SHARE * stops_per_revolution as f64) as usize
    {
        return;
    }
    let row = |i: usize, j: usize| {
        let phase = (j.div_ceil(2) * i) as f64 * TAU / stops_per_revolution as f64;
        if j.is_multiple_of(2) { phase.cos() } else { phase.sin() }
    };
    let design = Mat::from_fn(known.len(), 2 * harmonic_count + 1, |i, j| row(known[i], j));
    let problem = LinearProblem {
        a: design.as_ref(),
        y: &known.iter().filter_map(|i| values[*i]).collect::<Vec<f64>>(),
        sigma: &vec![1.0; known.len()],
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    let Ok(solution) = linear_least_squares::solve_least_squares(&problem) else { return };
    for i in missing {
        values[i] = Some(solution.x.iter().enumerate().map(|(j, x)| x * row(i, j)).sum());
    }
}
