//! Interruptions of the run. Their duration is removed from the times, and the drift model has a step at each
//! interruption.
//!
//! The drift model does not interpolate through hours without measurements. After an interruption the drift
//! continues at the same rate, from the machine position that the references determine.

use super::model::RadiusObservation;
use crate::IdentifyError;

/// Minimum number of directions touched between two interruptions, so that the step in X, Y and radius is
/// determined. Any three different directions are sufficient.
const MIN_SEGMENT_DIRECTIONS: usize = 3;

/// Removes the interruptions from the times (s), and the observations of each segment between interruptions that has
/// fewer than [`MIN_SEGMENT_DIRECTIONS`] directions. Returns the times of the interruptions on the remaining time
/// scale, and the number of removed observations.
///
/// # Errors
/// The readings have no times, so it is unknown which readings precede an interruption; or no segment has enough
/// directions.
pub fn remove_interruptions(
    observations: &mut Vec<RadiusObservation>,
    gaps_s: &[f64],
) -> Result<(Vec<f64>, usize), IdentifyError> {
    if gaps_s.is_empty() {
        return Ok((Vec::new(), 0));
    }
    if observations.iter().all(|observation| observation.relative_time == observations[0].relative_time) {
        return Err(IdentifyError::IdentificationFailed(
            "the measurement was interrupted, but the readings have no times (t_s)".to_owned(),
        ));
    }
    let count = observations.len();
    let segment = |time: f64| gaps_s.iter().filter(|gap| time > **gap).count();
    let mut segments: Vec<Vec<RadiusObservation>> = vec![Vec::new(); gaps_s.len() + 1];
    for observation in observations.iter() {
        segments[segment(observation.relative_time)].push(*observation);
    }
    segments.retain(|observation| direction_count(observation) >= MIN_SEGMENT_DIRECTIONS);
    let gaps = join_segments(&mut segments);
    *observations = segments.concat();
    let short_segment_reading_count = count - observations.len();
    if observations.is_empty() {
        return Err(IdentifyError::IdentificationFailed(
            "too few directions were touched between the interruptions".to_owned(),
        ));
    }
    Ok((gaps, short_segment_reading_count))
}

/// Number of different probe angles.
fn direction_count(observations: &[RadiusObservation]) -> usize {
    let mut angles: Vec<usize> = observations.iter().map(|observation| observation.phi_index).collect();
    angles.sort_unstable();
    angles.dedup();
    angles.len()
}

/// Shifts each segment to begin one mean touch interval after the end of the segment before. Returns the middle times
/// between the segments.
fn join_segments(segments: &mut [Vec<RadiusObservation>]) -> Vec<f64> {
    let span = |observations: &[RadiusObservation]| {
        let times = || observations.iter().map(|observation| observation.relative_time);
        (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max))
    };
    let measured: f64 = segments.iter().map(|s| span(s)).map(|(first, last)| last - first).sum();
    let pauses: usize = segments.iter().map(|s| s.len() - 1).sum();
    let pause = measured / pauses.max(1) as f64;
    let mut gaps = Vec::new();
    let mut end = None;
    for segment in segments {
        let (first, last) = span(segment);
        if let Some(end) = end {
            gaps.push(end + pause / 2.0);
            segment.iter_mut().for_each(|observation| observation.relative_time += end + pause - first);
        }
        end = Some(end.map_or(last, |end| end + pause + last - first));
    }
    gaps
}
