//! Detection of the ranges of a scan in which a channel is saturated.

use super::resample::{AngleRange, AngleSample};

/// Shortest saturated range that is reported, degrees.
const MIN_SATURATED_RANGE_DEG: f64 = 2.0;
/// A flat top counts as saturated if the signal changes by more than this, in display steps (smallest change other
/// than zero between two samples), within half the length of the flat top beyond an end. At an unsaturated peak the
/// signal changes by about three display steps there.
const MIN_FLAT_TOP_FALL_DISPLAY_STEPS: f64 = 8.0;

/// Ranges of a scan in which the signal stays at its largest or smallest value, and then changes abruptly.
pub(super) fn saturated_ranges(samples: &[AngleSample]) -> Vec<AngleRange> {
    let values = || samples.iter().map(|sample| sample.value);
    let (low, high) = values().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let steps = samples.windows(2).map(|pair| (pair[1].value - pair[0].value).abs());
    let step = steps.filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min);
    let mut ranges = Vec::new();
    let mut first = 0;
    for run in samples.chunk_by(|a, b| a.value == b.value) {
        let last = first + run.len() - 1;
        let is_extreme = [low, high].contains(&run[0].value) && step.is_finite();
        let [a, b] = [first, last].map(|i| samples[i].angle_rad.to_degrees());
        if is_extreme && (b - a).abs() >= MIN_SATURATED_RANGE_DEG {
            let reach = run.len() / 2;
            let outside = [first.checked_sub(reach), Some(last + reach)];
            let outside = outside.into_iter().flatten().filter_map(|i| samples.get(i));
            let drop = |s: &AngleSample| (s.value - run[0].value).abs();
            if outside.map(drop).fold(0.0, f64::max) > MIN_FLAT_TOP_FALL_DISPLAY_STEPS * step {
                ranges.push(AngleRange { from_deg: a.min(b), to_deg: a.max(b) });
            }
        }
        first = last + 1;
    }
    ranges
}

/// Marks the samples in saturated ranges as invalid.
pub fn invalidate_saturated_samples(samples: &mut [AngleSample]) {
    let valid: Vec<AngleSample> = samples.iter().filter(|sample| sample.is_valid).copied().collect();
    let saturated = saturated_ranges(&valid);
    let is_in = |deg: f64| saturated.iter().any(|AngleRange { from_deg, to_deg }| (*from_deg..=*to_deg).contains(&deg));
    samples.iter_mut().for_each(|sample| sample.is_valid &= !is_in(sample.angle_rad.to_degrees()));
}
