//! Resampling from arbitrary angles to equal angles: the low-pass of `resample_filter.rs`, integrated over the
//! samples by the trapezoidal rule. Uneven spacing, changes of speed, stops and small reversals of the encoder
//! therefore need no special case.

use std::f64::consts::TAU;

use super::resample_filter::{KERNEL_HALF_WIDTH_OUTPUT_STEPS, ResampleFilter};

/// Longest distance between two samples, in output steps; a longer one is a gap. The spectral images of sparser
/// samples would pass the filter.
const MAX_SAMPLE_SPACING_STEPS: f64 = 1.0;

/// Range of angles, counter-clockwise from `from_deg` to `to_deg`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AngleRange {
    pub from_deg: f64,
    pub to_deg: f64,
}

impl AngleRange {
    /// The range from `centre_deg` − `half_width_deg` to `centre_deg` + `half_width_deg`.
    pub fn centred_range(centre_deg: f64, half_width_deg: f64) -> Self {
        Self { from_deg: centre_deg - half_width_deg, to_deg: centre_deg + half_width_deg }
    }

    pub fn format_ranges(ranges: &[Self]) -> String {
        let one = |range: &Self| format!("{:.1}° to {:.1}°", range.from_deg, range.to_deg);
        ranges.iter().map(one).collect::<Vec<String>>().join(", ")
    }

    /// Whether the angle is in the range, modulo 360°, ends included. Only for ranges shorter than 360°.
    pub fn contains(self, deg: f64) -> bool {
        (deg - self.from_deg).rem_euclid(360.0) <= (self.to_deg - self.from_deg).rem_euclid(360.0)
    }
}

/// One sample of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AngleSample {
    /// Angle of the axis at the sample, unwrapped: it continues beyond ±2π, up or down, from revolution to
    /// revolution.
    pub angle_rad: f64,
    pub value: f64,
    /// Whether the sample is neither saturated nor flagged by the sensor.
    pub is_valid: bool,
}

/// Resampler of one channel over one scan. It accepts one sample at a time and stores only the output angles.
#[derive(Debug, Clone)]
pub struct Resampler<'a> {
    filter: &'a ResampleFilter,
    /// Index of the first output angle: angle = index·2π/steps.
    first_angle_index: i64,
    /// Σ weight·value and Σ weight at each output angle.
    weighted_value_and_weight_sums: Vec<[f64; 2]>,
    /// Whether each output angle lies between two samples without a gap.
    is_angle_covered: Vec<bool>,
    /// Angle of the valid sample before the last one, in output steps.
    position_before_last: Option<f64>,
    /// Angle (in output steps) and value of the last valid sample.
    last_position_and_value: Option<(f64, f64)>,
    /// 1 if the scan is towards greater angles, otherwise −1.
    direction_sign: f64,
    gaps: Vec<AngleRange>,
}

/// One channel of one scan, resampled to equal angles.
#[derive(Debug, Clone, PartialEq)]
pub struct ResampledChannel {
    /// Number of output angles in one revolution.
    pub(super) steps_per_revolution: usize,
    /// Index of the angle of the first of `values`: angle = index·2π/steps.
    first_angle_index: i64,
    /// Values at the output angles. `None`: the angle is too near a gap or an end of the scan.
    values: Vec<Option<f64>>,
    /// Ranges without valid samples that are too long to interpolate, unwrapped.
    pub gaps: Vec<AngleRange>,
}

impl<'a> Resampler<'a> {
    /// Creates the resampler of a scan between two unwrapped angles, in either direction.
    pub fn new(filter: &'a ResampleFilter, from_rad: f64, to_rad: f64) -> Self {
        let step = TAU / filter.steps_per_revolution() as f64;
        let (low, high) = (from_rad.min(to_rad) / step, from_rad.max(to_rad) / step);
        let first = low.ceil() as i64;
        let count = (high.floor() as i64 - first + 1).max(0) as usize;
        Self {
            filter,
            first_angle_index: first,
            weighted_value_and_weight_sums: vec![[0.0; 2]; count],
            is_angle_covered: vec![false; count],
            position_before_last: None,
            last_position_and_value: None,
            direction_sign: if to_rad >= from_rad { 1.0 } else { -1.0 },
            gaps: Vec::new(),
        }
    }

    /// Resamples all samples of a scan between two unwrapped angles.
    pub fn resample_scan(filter: &ResampleFilter, ends_rad: [f64; 2], samples: &[AngleSample]) -> ResampledChannel {
        let mut resampler = Resampler::new(filter, ends_rad[0], ends_rad[1]);
        samples.iter().for_each(|sample| resampler.push(*sample));
        resampler.finish()
    }

    /// Adds the next sample; an invalid one is ignored.
    pub fn push(&mut self, sample: AngleSample) {
        if !sample.is_valid || !sample.value.is_finite() {
            return;
        }
        let position = sample.angle_rad * self.filter.steps_per_revolution() as f64 / TAU;
        if let Some((last, value)) = self.last_position_and_value {
            self.add_weighted_sample(last, value, (position - self.position_before_last.unwrap_or(last)) / 2.0);
            self.mark_covered_or_record_gap(last, position);
            self.position_before_last = Some(last);
        }
        self.last_position_and_value = Some((position, sample.value));
    }

    /// Adds a sample, weighted with the length of its part of the path.
    fn add_weighted_sample(&mut self, position: f64, value: f64, length: f64) {
        let half = KERNEL_HALF_WIDTH_OUTPUT_STEPS as f64;
        let from = (position - half).ceil() as i64 - self.first_angle_index;
        let to = (position + half).floor() as i64 - self.first_angle_index + 1;
        let cell = |i: i64| (i.max(0) as usize).min(self.weighted_value_and_weight_sums.len());
        for i in cell(from)..cell(to) {
            let distance = (self.first_angle_index + i as i64) as f64 - position;
            let weight = self.direction_sign * length * self.filter.kernel_value(distance);
            self.weighted_value_and_weight_sums[i][0] += weight * value;
            self.weighted_value_and_weight_sums[i][1] += weight;
        }
    }

    /// Marks the output angles between two neighbouring samples as covered, or records the gap.
    fn mark_covered_or_record_gap(&mut self, from: f64, to: f64) {
        let (low, high) = (from.min(to), from.max(to));
        if high - low > MAX_SAMPLE_SPACING_STEPS {
            let deg = |steps: f64| steps * 360.0 / self.filter.steps_per_revolution() as f64;
            self.gaps.push(AngleRange { from_deg: deg(low), to_deg: deg(high) });
            return;
        }
        for number in low.ceil() as i64..=high.floor() as i64 {
            let cell = usize::try_from(number - self.first_angle_index).ok();
            if let Some(covered) = cell.and_then(|cell| self.is_angle_covered.get_mut(cell)) {
                *covered = true;
            }
        }
    }

    /// Ends the scan. An angle nearer to a gap or an end than the half width of the kernel has no value.
    pub fn finish(mut self) -> ResampledChannel {
        if let (Some((last, value)), Some(before)) = (self.last_position_and_value, self.position_before_last) {
            self.add_weighted_sample(last, value, (last - before) / 2.0);
        }
        let half = KERNEL_HALF_WIDTH_OUTPUT_STEPS;
        let mut missing_before = vec![0_usize];
        for covered in &self.is_angle_covered {
            missing_before.push(missing_before[missing_before.len() - 1] + usize::from(!covered));
        }
        let is_whole = |i: usize| {
            i >= half
                && i + half < self.weighted_value_and_weight_sums.len()
                && missing_before[i + half + 1] == missing_before[i - half]
        };
        let value = |(i, [sum, weight]): (usize, &[f64; 2])| is_whole(i).then(|| sum / weight);
        ResampledChannel {
            steps_per_revolution: self.filter.steps_per_revolution(),
            first_angle_index: self.first_angle_index,
            values: self.weighted_value_and_weight_sums.iter().enumerate().map(value).collect(),
            gaps: self.gaps,
        }
    }
}

impl ResampledChannel {
    /// Unwrapped angles in rad and values, from the first angle with a value to the last. `None`: too near a gap.
    pub fn angles_and_values(&self) -> impl Iterator<Item = (f64, Option<f64>)> {
        let (from, to) = self.index_range_with_values();
        let step = TAU / self.steps_per_revolution as f64;
        let value = |number: i64| self.values[(number - self.first_angle_index) as usize];
        (from..=to).map(move |number| (number as f64 * step, value(number)))
    }

    /// Creates the result of a scan with `steps` stops per revolution at equal angles. The first of `values` belongs to
    /// the angle with the index `first_index`.
    pub(super) fn from_stop_values(steps: usize, first_index: i64, values: Vec<Option<f64>>) -> Self {
        let deg = |number: i64| number as f64 * 360.0 / steps as f64;
        let missing = (first_index..).zip(&values).filter(|(_, value)| value.is_none());
        let mut gaps: Vec<AngleRange> = Vec::new();
        for (number, _) in missing {
            let (from_deg, to_deg) = (deg(number - 1), deg(number + 1));
            match gaps.last_mut() {
                Some(gap) if gap.to_deg >= deg(number) => gap.to_deg = to_deg,
                _ => gaps.push(AngleRange { from_deg, to_deg }),
            }
        }
        Self { steps_per_revolution: steps, first_angle_index: first_index, values, gaps }
    }

    /// The `count` whole revolutions from the output angle with the index `start_angle_index`. The values of each begin
    /// at angle 0. `None`: the revolution has a gap.
    pub(super) fn revolutions(&self, start_angle_index: i64, count: usize) -> Vec<Option<Vec<f64>>> {
        let value = |number: i64| {
            let cell = usize::try_from(number - self.first_angle_index).ok()?;
            self.values.get(cell).copied().flatten()
        };
        let steps = self.steps_per_revolution as i64;
        let revolution = |r: usize| {
            let start = start_angle_index + r as i64 * steps;
            let angles = (0..steps).map(|angle| start + (angle - start).rem_euclid(steps));
            angles.map(value).collect()
        };
        (0..count).map(revolution).collect()
    }

    /// Indices of the first and the last angle with a value; the first is greater than the last if there is none.
    pub(super) fn index_range_with_values(&self) -> (i64, i64) {
        let first = self.values.iter().position(Option::is_some).unwrap_or(self.values.len());
        let last = self.values.iter().rposition(Option::is_some).map_or(-1, |i| i as i64);
        (self.first_angle_index + first as i64, self.first_angle_index + last)
    }
}
