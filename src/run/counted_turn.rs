//! Angles of a turn from the counts of a rotary encoder that come with the samples: the control's angle at rest
//! before the turn plus the counts since then. The clocks of sensor and control are not used.

use std::f64::consts::TAU;

use super::position_assignment::{PositionedSamples, REST_TOLERANCE_MM_OR_RAD, limit_sample_rate};
use crate::setup::EncoderScale;
use devices::sensors::Sample;
use machine::{Axis, Position};

/// Maximum difference between the angle from the counts and the angle that the control reports at rest after the turn,
/// degrees. With an eccentricity of 20 µm this difference changes a radius by less than 0.02 µm.
const MAX_COUNTED_TURN_DEVIATION_DEG: f64 = 0.05;
/// Maximum time between the acquisition of a sample and its arrival.
const MAX_SAMPLE_ARRIVAL_DELAY_S: f64 = 0.1;
/// Minimum ratio of a jump to the median step between two samples. A jump is also longer than the maximum speed
/// allows.
const MIN_JUMP_TO_MEDIAN_STEP_RATIO: f64 = 20.0;

/// One turn of the axis with the encoder counts in the samples of one sensor.
pub(super) struct CountedTurn<'a> {
    pub encoder_scale: EncoderScale,
    /// Positions that the control reports at rest, before and after the turn.
    pub rest_positions_before_and_after: [&'a Position; 2],
    /// Sample at rest before the turn.
    pub sample_before_turn: Sample,
    /// Maximum speed of the axis: the feed of the step.
    pub max_speed_deg_s: f64,
}

/// Reason why the encoder counts do not match the turn of the axis.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EncoderCountFault {
    /// `count`: before the turn; `turned_deg`: between the positions that the control reports at rest.
    #[error("the count of the encoder stayed at {count} while {axis} turned by {turned_deg:.3}°")]
    Stuck { axis: Axis, count: u32, turned_deg: f64 },
    /// `turned_deg`: between the positions at rest; `counts_per_turn`: as declared in the machine file.
    #[error(
        "{axis} turned by {counted_deg:.3}° according to the encoder, but by {turned_deg:.3}° according to \
        the control: a ratio of {:.4}", counted_deg / turned_deg
    )]
    TurnedAngleMismatch { axis: Axis, counted_deg: f64, turned_deg: f64, counts_per_turn: i64 },
    /// `at_deg`: angle before the jump; `jump_deg`: change of the angle in the jump.
    #[error(
        "the count of the encoder jumps by {jump_deg:.3}° at {axis} = {at_deg:.3}°, more than {axis} can turn \
        between two samples"
    )]
    Jump { axis: Axis, at_deg: f64, jump_deg: f64 },
}

impl EncoderCountFault {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        match self {
            Self::Stuck { .. } => {
                "check that the encoder is connected to the amplifier and turns with the axis; compare \
                `encoder_count` of the sensor with the manual of the sensor"
                    .to_owned()
            }
            EncoderCountFault::TurnedAngleMismatch { counted_deg, turned_deg, counts_per_turn, .. } => {
                let stated = *counts_per_turn as f64;
                let is_reversed = (counted_deg + turned_deg).abs() <= MAX_COUNTED_TURN_DEVIATION_DEG;
                let ratio = if is_reversed { -1.0 } else { counted_deg / turned_deg };
                format!(
                    "if the ratio is the same for each revolution, write counts_per_turn = {:.0} in \
                    [encoder] instead of {stated} and start a new run; otherwise counts are lost: check the \
                    cable and the maximum frequency of the encoder, then `trued resume` measures the \
                    revolution again",
                    stated * ratio
                )
            }
            Self::Jump { .. } => "check the cable and the maximum frequency of the encoder, and compare \
                `width` or `round` of `encoder_count` with the manual; `trued resume` then measures the \
                revolution again"
                .to_owned(),
        }
    }
}

/// Signed angle by which the axis turned between two samples, by the shorter way of the counter, rad; `None` if one
/// of them has no count.
pub(super) fn rotation_between_samples_rad(scale: EncoderScale, from: &Sample, to: &Sample) -> Option<f64> {
    counts_between(scale, from, to).map(|counts| counts_to_rad(scale, counts))
}

/// Difference of the counts, modulo the counter's range, by the shorter way.
fn counts_between(scale: EncoderScale, from: &Sample, to: &Sample) -> Option<i64> {
    let round = i64::try_from(scale.wrap_count).ok()?;
    let step = i64::from(to.encoder_count?) - i64::from(from.encoder_count?);
    let step = step.rem_euclid(round);
    Some(if step > round / 2 { step - round } else { step })
}

fn counts_to_rad(scale: EncoderScale, counts: i64) -> f64 {
    counts as f64 * TAU / scale.encoder.counts_per_turn as f64
}

impl CountedTurn<'_> {
    /// Samples from the start of the turn to its end, at most `rate_hz` per second.
    ///
    /// # Errors
    /// The counts do not match the motion of the axis. Then no sample of the turn gets a position.
    pub fn assign_positions(&self, samples: &[Sample], rate_hz: f64) -> Result<PositionedSamples, EncoderCountFault> {
        let axis = self.encoder_scale.encoder.axis;
        let [start, end] = self.rest_positions_before_and_after;
        let angles = self.samples_with_angles_rad(samples)?;
        let is_off = |(_, angle): &(Sample, f64), rest: &Position| {
            (angle - rest.get_or_zero(axis)).abs() > REST_TOLERANCE_MM_OR_RAD
        };
        let start_index = angles.iter().position(|sample| is_off(sample, start)).unwrap_or_default();
        let end_index = angles.iter().rposition(|sample| is_off(sample, end)).unwrap_or_default();
        let moving = angles.iter().take(end_index + 2).skip(start_index.saturating_sub(1));
        let place = |(sample, angle): &(Sample, f64)| (*sample, Some(start.clone().with(axis, *angle)));
        Ok(limit_sample_rate(&moving.map(place).collect::<Vec<_>>(), rate_hz))
    }

    /// Samples that carry a count, with the angle of each, rad.
    fn samples_with_angles_rad(&self, samples: &[Sample]) -> Result<Vec<(Sample, f64)>, EncoderCountFault> {
        let start = self.rest_positions_before_and_after[0].get_or_zero(self.encoder_scale.encoder.axis);
        let (mut count, mut last) = (0, self.sample_before_turn);
        let mut counted = vec![(last, 0)];
        for sample in samples {
            let Some(step) = counts_between(self.encoder_scale, &last, sample) else { continue };
            (count, last) = (count + step, *sample);
            counted.push((last, count));
        }
        self.check_for_jumps(&counted)?;
        self.check_turned_angle_at_rest(&counted)?;
        let angle = |(sample, count): (Sample, i64)| (sample, start + self.counts_to_rad(count));
        Ok(counted.into_iter().skip(1).map(angle).collect())
    }

    fn counts_to_rad(&self, counts: i64) -> f64 {
        counts_to_rad(self.encoder_scale, counts)
    }

    /// Checks for jumps of the count. A wrong `counts_per_turn` makes all steps longer, and is not a jump.
    fn check_for_jumps(&self, counted: &[(Sample, i64)]) -> Result<(), EncoderCountFault> {
        let of_a_sample =
            |step: i64, sample: &Sample| step.unsigned_abs() as f64 / (1.0 + f64::from(sample.lost_before_count));
        let steps = || counted.windows(2).filter_map(|pair| Some((pair.first()?, pair.last()?)));
        let mut lengths: Vec<f64> =
            steps().map(|(from, to)| of_a_sample(to.1 - from.1, &to.0)).filter(|length| *length > 0.0).collect();
        lengths.sort_by(f64::total_cmp);
        let median = lengths.get(lengths.len() / 2).copied().unwrap_or_default();
        let axis = self.encoder_scale.encoder.axis;
        for (from, to) in steps() {
            let (step, passed_s) = (to.1 - from.1, (to.0.received_s - from.0.received_s).max(0.0));
            let jump_deg = self.counts_to_rad(step).to_degrees();
            if jump_deg.abs() > self.max_speed_deg_s * (passed_s + MAX_SAMPLE_ARRIVAL_DELAY_S)
                && of_a_sample(step, &to.0) > MIN_JUMP_TO_MEDIAN_STEP_RATIO * median
            {
                let at_deg = axis.to_mm_or_deg(
                    self.rest_positions_before_and_after[0].get_or_zero(axis) + self.counts_to_rad(from.1),
                );
                return Err(EncoderCountFault::Jump { axis, at_deg, jump_deg });
            }
        }
        Ok(())
    }

    /// Checks that counts and control agree at rest after the turn.
    fn check_turned_angle_at_rest(&self, counted: &[(Sample, i64)]) -> Result<(), EncoderCountFault> {
        let axis = self.encoder_scale.encoder.axis;
        let [start, end] = self.rest_positions_before_and_after.map(|rest| rest.get_or_zero(axis));
        let turned_deg = (end - start).to_degrees();
        let counted_deg = counted.last().map_or(0.0, |(_, count)| self.counts_to_rad(*count).to_degrees());
        if (counted_deg - turned_deg).abs() <= MAX_COUNTED_TURN_DEVIATION_DEG {
            return Ok(());
        }
        if counted.iter().all(|(_, count)| count.abs() <= 1) {
            let count = self.sample_before_turn.encoder_count.unwrap_or_default();
            return Err(EncoderCountFault::Stuck { axis, count, turned_deg });
        }
        let counts_per_turn = self.encoder_scale.encoder.counts_per_turn;
        Err(EncoderCountFault::TurnedAngleMismatch { axis, counted_deg, turned_deg, counts_per_turn })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::machine_file::AxisEncoder;
    use machine::record::reading::ReadingFlag;

    /// A turn by 400° from -8° within 10 s, with one second at rest before and after it, at 200 samples per
    /// second.
    fn angle_of_sample_deg(number: u32) -> f64 {
        -8.0 + (f64::from(number) - 200.0).clamp(0.0, 2000.0) * 0.2
    }

    /// Count of an encoder with `counts_per_turn` counts per turn whose counter wraps at `wrap_count`.
    fn counter_value(angle_deg: f64, counts_per_turn: i64, wrap_count: u64) -> u32 {
        let count = (angle_deg * counts_per_turn as f64 / 360.0).floor() as i64 + 1_000_003;
        count.rem_euclid(wrap_count as i64) as u32
    }

    fn samples_of_turn(count: impl Fn(f64) -> u32) -> Vec<Sample> {
        let sample = |number: u32| Sample {
            received_s: f64::from(number) / 200.0,
            value_mm: Some(angle_of_sample_deg(number)),
            flag: ReadingFlag::None,
            lost_before_count: 0,
            encoder_count: Some(count(angle_of_sample_deg(number))),
        };
        (0..2400).map(sample).collect()
    }

    /// Result for an encoder declared with `counts_per_turn` and `wrap_count`.
    fn assign_turn_positions(
        samples: &[Sample],
        counts_per_turn: i64,
        wrap_count: u64,
    ) -> Result<PositionedSamples, EncoderCountFault> {
        let rest = |deg: f64| Position::new().with(Axis::X, 7.0).with(Axis::C, Axis::C.to_mm_or_rad(deg));
        let turn = CountedTurn {
            encoder_scale: EncoderScale { encoder: AxisEncoder { axis: Axis::C, counts_per_turn }, wrap_count },
            rest_positions_before_and_after: [&rest(-8.0), &rest(392.0)],
            sample_before_turn: samples[0],
            max_speed_deg_s: 40.0,
        };
        turn.assign_positions(&samples[1..], f64::INFINITY)
    }

    /// Counters of 16, 24 and 32 bits and of one turn, with both signs.
    #[test]
    fn counter_wraps_are_followed_in_both_directions() {
        for round in [1 << 16, 1 << 24, 1 << 32, 90_000] {
            for per_turn in [90_000, -90_000] {
                let samples = samples_of_turn(|deg| counter_value(deg, per_turn, round));
                let placed = assign_turn_positions(&samples, per_turn, round).unwrap();
                assert_eq!((placed.without_position_count, placed.dropped_by_rate_count), (0, 0));
                assert!((1990..2010).contains(&placed.samples.len()), "{}", placed.samples.len());
                for (sample, position) in &placed.samples {
                    let off_deg = position.get_or_zero(Axis::C).to_degrees() - sample.value_mm.unwrap();
                    assert!(off_deg.abs() <= 360.0 / 90_000.0 + 1e-9, "{round}: {off_deg}");
                    assert_eq!(position.get_or_zero(Axis::X), 7.0);
                }
            }
        }
    }

    #[test]
    fn missing_samples_do_not_shift_the_last_position() {
        let mut samples = samples_of_turn(|deg| counter_value(deg, 90_000, 1 << 16));
        samples.drain(900..960);
        samples[900].lost_before_count = 60;
        let placed = assign_turn_positions(&samples, 90_000, 1 << 16).unwrap();
        let (sample, position) = placed.samples.last().unwrap();
        let off_deg = position.get_or_zero(Axis::C).to_degrees() - sample.value_mm.unwrap();
        assert!(off_deg.abs() < 0.005, "{off_deg}");
    }

    fn fault_and_message(samples: &[Sample], per_turn: i64, round: u64) -> (EncoderCountFault, String) {
        let fault = assign_turn_positions(samples, per_turn, round).unwrap_err();
        (fault.clone(), format!("{fault}\n  -> {}", fault.remedy()))
    }

    #[test]
    fn wrong_sign_and_wrong_counts_per_turn_are_reported_with_their_ratio() {
        let right = samples_of_turn(|deg| counter_value(deg, -90_000, 1 << 32));
        let (_, text) = fault_and_message(&right, 90_000, 1 << 32);
        assert!(text.contains("a ratio of -1.0000") && text.contains("= -90000 in"), "{text}");
        let (_, text) = fault_and_message(&right, -72_000, 1 << 32);
        assert!(text.contains("turned by 500.0") && text.contains("a ratio of 1.2500"), "{text}");
        assert!(text.contains("counts_per_turn = -90000 in [encoder] instead of -72000"), "{text}");
        let (_, text) = fault_and_message(&right, -90, 1 << 32);
        assert!(text.contains("a ratio of 1000.0"), "{text}");
        // 100 of 90000 counts are lost.
        let lost = |deg: f64| counter_value(deg, 90_000, 1 << 32) - if deg > 100.0 { 100 } else { 0 };
        let (_, text) = fault_and_message(&samples_of_turn(lost), 90_000, 1 << 32);
        assert!(text.contains("a ratio of 0.9990") && text.contains("counts are lost"), "{text}");
    }

    #[test]
    fn stuck_counter_is_reported() {
        let dither = |deg: f64| 4711 + u32::from(deg.rem_euclid(1.0) > 0.5);
        let (fault, text) = fault_and_message(&samples_of_turn(dither), 90_000, 1 << 16);
        assert!(matches!(fault, EncoderCountFault::Stuck { .. }), "{fault:?}");
        assert!(text.contains("stayed at 4711 while C turned by 400.000°"), "{text}");
    }

    #[test]
    fn jump_is_reported_with_its_angle_although_the_end_is_right() {
        let spike = |deg: f64| {
            let count = counter_value(deg, 90_000, 1 << 24);
            if (120.0..121.0).contains(&deg) { count + 20_000 } else { count }
        };
        let (_, text) = fault_and_message(&samples_of_turn(spike), 90_000, 1 << 24);
        assert!(text.contains("jumps by 80.") && text.contains("at C = 119.8"), "{text}");
        // A 16-bit counter declared as 24 bits.
        let narrow = samples_of_turn(|deg| counter_value(deg, 90_000, 1 << 16));
        let (fault, _) = fault_and_message(&narrow, 90_000, 1 << 24);
        assert!(matches!(fault, EncoderCountFault::Jump { .. }), "{fault:?}");
    }
}
