//! Samples of a turn in motion, filtered to equal angles. The number of readings per revolution does not depend
//! on the sample rate of the sensor.

use std::collections::BTreeMap;

use devices::sensors::Sample;
use estimation::revolutions::{self, AngleRange, ResampleFilter, Resampler, invalidate_saturated_samples};
use machine::record::plan::{Sampling, Scan};
use machine::record::reading::ReadingFlag;
use machine::{Axis, Position};

/// The axis that turns and the angles per revolution, if the plan requests equal angles.
pub(super) fn axis_and_angles_per_revolution(scan: &Scan) -> Option<(Axis, usize)> {
    let Sampling::Continuous { per_revolution: Some(count), .. } = scan.sampling else {
        return None;
    };
    Some((scan.single_rotary_axis()?, count))
}

/// Samples of one turn, resampled at equal angles of the axis.
#[derive(Debug)]
pub(super) struct ResampledTurn {
    /// Samples from the first angle with a value to the last; an angle without a value has [`ReadingFlag::Gap`].
    pub samples_with_positions: Vec<(Sample, Position)>,
    /// Ranges of angles in which the sensor has no valid value.
    angle_gaps: Vec<AngleRange>,
}

/// Resamples `positioned`, the samples in order of time with the positions of the axes.
pub(super) fn resample_turn(
    positioned: &[(Sample, Position)],
    axis: Axis,
    angles_per_revolution: usize,
) -> ResampledTurn {
    let (Some((_, first)), Some((_, last))) = (positioned.first(), positioned.last()) else {
        return ResampledTurn { samples_with_positions: Vec::new(), angle_gaps: Vec::new() };
    };
    let filter = ResampleFilter::new(angles_per_revolution);
    let ends_rad = [first, last].map(|position| position.get_or_zero(axis));
    let of_turn = |value: &dyn Fn(&Sample) -> Option<f64>| {
        let sample = |(sample, position): &(Sample, Position)| revolutions::AngleSample {
            angle_rad: position.get_or_zero(axis),
            value: value(sample).unwrap_or(f64::NAN),
            is_valid: value(sample).is_some(),
        };
        positioned.iter().map(sample).collect::<Vec<_>>()
    };
    let mut values = of_turn(&|sample| sample.value_mm);
    invalidate_saturated_samples(&mut values);
    let values = Resampler::resample_scan(&filter, ends_rad, &values);
    // The times pass through the same filter as the values, so that each time matches its angle even where the speed
    // changes.
    let times = Resampler::resample_scan(&filter, ends_rad, &of_turn(&|sample| Some(sample.received_s)));
    let number = |angle: f64| (angle * angles_per_revolution as f64 / std::f64::consts::TAU).round() as i64;
    let times: BTreeMap<i64, f64> =
        times.angles_and_values().filter_map(|(angle, t_s)| Some((number(angle), t_s?))).collect();
    let sample = |(angle, value_mm): (f64, Option<f64>)| {
        let flag = if value_mm.is_some() { ReadingFlag::None } else { ReadingFlag::Gap };
        let t_s = *times.get(&number(angle))?;
        let sample = Sample { received_s: t_s, value_mm, flag, lost_before_count: 0, encoder_count: None };
        Some((sample, first.clone().with(axis, angle)))
    };
    ResampledTurn {
        samples_with_positions: values.angles_and_values().filter_map(sample).collect(),
        angle_gaps: values.gaps,
    }
}

impl ResampledTurn {
    /// Message about angles without a value; `None` if there are none.
    pub fn gap_message(&self, label: &str, sensor: &str) -> Option<String> {
        (!self.angle_gaps.is_empty()).then(|| {
            format!(
                "{label}: {sensor} has no value within its range at {}; the equally \
                spaced angles near there have no value",
                AngleRange::format_ranges(&self.angle_gaps)
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN_DURATION_S: f64 = 3.0;
    const SAMPLES_PER_TURN: usize = 72;

    /// Two revolutions from -40° with constant acceleration, sampled at 2 kHz.
    fn angle_deg(t_s: f64) -> f64 {
        -40.0 + 400.0 * t_s / TURN_DURATION_S + 420.0 * (t_s / TURN_DURATION_S).powi(2)
    }

    fn positioned_samples(value: impl Fn(f64, f64) -> Option<f64>) -> Vec<(Sample, Position)> {
        let sample = |number: i32| {
            let t_s = f64::from(number) / 2000.0;
            let angle = angle_deg(t_s);
            let value_mm = value(angle, t_s);
            let sample = Sample {
                received_s: t_s,
                value_mm,
                flag: ReadingFlag::None,
                lost_before_count: 0,
                encoder_count: None,
            };
            let at = Position::new().with(Axis::X, 3.0).with(Axis::C, angle.to_radians());
            (sample, at)
        };
        (0..=6000).map(sample).collect()
    }

    /// Value and time belong to the angle. The filter removes a disturbance above its cut-off frequency.
    #[test]
    fn each_resampled_value_belongs_to_its_angle() {
        let smooth = |deg: f64| 0.01 * (3.0 * deg.to_radians()).cos();
        let disturbed = |deg: f64, _: f64| Some(smooth(deg) + 0.01 * (150.0 * deg.to_radians()).sin());
        let turn = resample_turn(&positioned_samples(disturbed), Axis::C, SAMPLES_PER_TURN);
        assert!(turn.samples_with_positions.len() > 2 * SAMPLES_PER_TURN, "{}", turn.samples_with_positions.len());
        assert_eq!(turn.gap_message("turn", "s1"), None);
        for (sample, position) in &turn.samples_with_positions {
            let deg = position.get_or_zero(Axis::C).to_degrees();
            assert!((deg / 5.0 - (deg / 5.0).round()).abs() < 1e-9, "{deg}");
            assert_eq!(position.get_or_zero(Axis::X), 3.0);
            let off = sample.value_mm.unwrap() - smooth(deg);
            assert!(off.abs() < 1e-6, "{deg}: {off}");
            let off_deg = angle_deg(sample.received_s) - deg;
            assert!(off_deg.abs() < 0.01, "{deg}: {off_deg}");
        }
    }

    #[test]
    fn gaps_and_range_ends_have_no_value_and_are_reported() {
        let lost = |deg: f64, _: f64| {
            let value = 0.01 * deg.to_radians().cos();
            let is_lost = (90.0..97.0).contains(&deg);
            (!is_lost).then_some(value.min(0.0099))
        };
        let turn = resample_turn(&positioned_samples(lost), Axis::C, SAMPLES_PER_TURN);
        let at = |wanted: f64| {
            let near = |position: &Position| (position.get_or_zero(Axis::C).to_degrees() - wanted).abs() < 1e-6;
            turn.samples_with_positions.iter().find(|(_, position)| near(position)).map(|(sample, _)| *sample)
        };
        let gap = at(95.0).unwrap();
        assert_eq!((gap.value_mm, gap.flag), (None, ReadingFlag::Gap));
        assert_eq!(at(360.0).unwrap().value_mm, None, "{turn:?}");
        assert!(at(200.0).unwrap().value_mm.is_some());
        let text = turn.gap_message("index/1", "s1").unwrap();
        assert!(text.contains("index/1: s1") && text.contains("89.9° to 97.1°"), "{text}");
    }
}
