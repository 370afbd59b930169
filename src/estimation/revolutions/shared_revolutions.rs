//! The revolutions that the channels of one scan share.

use super::resample::{AngleRange, ResampledChannel};

/// One channel at one mounting of the artefact, both counted from 0. The channels of one mounting are sampled
/// together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ChannelAtMounting {
    pub mounting_index: usize,
    pub channel_index: usize,
}

/// Revolutions of one channel at one mounting of the artefact, resampled to equal angles that start at 0.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelRevolutions {
    pub key: ChannelAtMounting,
    /// Values, revolutions × angles. Entry r is the same turn of the table for all channels of one mounting.
    pub revolutions: Vec<Vec<f64>>,
}

impl ChannelRevolutions {
    /// Mean of the revolutions at each angle.
    pub fn mean_revolution(&self) -> Vec<f64> {
        let angles = self.revolutions.first().map_or(0, Vec::len);
        let count = self.revolutions.len() as f64;
        let at = |i: usize| self.revolutions.iter().map(|values| values[i]).sum::<f64>() / count;
        (0..angles).map(at).collect()
    }
}

/// Revolutions of a channel that are rejected because of missing samples.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{rejected_count} of {revolution_count} revolutions have missing samples ({}); measure again, or move the sensor back into its range",
    describe_gaps(.gaps)
)]
pub struct RejectedRevolutions {
    pub channel_index: usize,
    /// Number of rejected revolutions of this channel.
    pub rejected_count: usize,
    /// Number of whole revolutions of the scan within the range of the channels with the most of them.
    pub revolution_count: usize,
    /// Angles without samples within the range of the samples.
    pub gaps: Vec<AngleRange>,
}

fn describe_gaps(gaps: &[AngleRange]) -> String {
    match gaps {
        [] => "the samples begin too late or end too early".to_owned(),
        gaps => format!("at {}", AngleRange::format_ranges(gaps)),
    }
}

/// Returns the revolutions that are complete in all usable channels of one scan, and the channels with rejected
/// revolutions. A channel without a complete revolution is not usable. `mounting_index`: number of the mounting of the
/// scan.
pub fn common_and_rejected_revolutions(
    mounting_index: usize,
    channels: &[ResampledChannel],
) -> (Vec<ChannelRevolutions>, Vec<RejectedRevolutions>) {
    let Some(ResampledChannel { steps_per_revolution: steps, .. }) = channels.first() else {
        return Default::default();
    };
    // The channels with the most whole revolutions define the range. Missing samples at an end of another channel
    // are a gap of that channel.
    let whole = |(from, to): (i64, i64)| usize::try_from(to - from + 1).unwrap_or(0) / steps;
    let most = channels.iter().map(|channel| whole(channel.index_range_with_values())).max().unwrap_or(0);
    let ends = || channels.iter().map(ResampledChannel::index_range_with_values).filter(|ends| whole(*ends) == most);
    let from = ends().map(|(from, _)| from).max().unwrap_or(0);
    let to = ends().map(|(_, to)| to).min().unwrap_or(0);
    let count = whole((from, to));
    let all: Vec<_> = channels.iter().map(|channel| channel.revolutions(from, count)).collect();
    let is_usable = |of: &&Vec<Option<Vec<f64>>>| of.iter().any(Option::is_some);
    let is_common = |r: &usize| all.iter().filter(is_usable).all(|of| of[*r].is_some());
    let common: Vec<usize> = (0..count).filter(is_common).collect();
    let (mut rows, mut rejections) = (Vec::new(), Vec::new());
    for (channel, of) in all.iter().enumerate() {
        let rejected = of.iter().filter(|revolution| revolution.is_none()).count();
        if rejected > 0 {
            let gaps = channels[channel].gaps.clone();
            rejections.push(RejectedRevolutions {
                channel_index: channel,
                rejected_count: rejected,
                revolution_count: count,
                gaps,
            });
        }
        let revolutions: Vec<Vec<f64>> = common.iter().filter_map(|r| of[*r].clone()).collect();
        if !revolutions.is_empty() {
            rows.push(ChannelRevolutions {
                key: ChannelAtMounting { mounting_index, channel_index: channel },
                revolutions,
            });
        }
    }
    (rows, rejections)
}

/// Appends the revolutions of another scan at the same mounting.
pub fn append_revolutions(rows: &mut Vec<ChannelRevolutions>, more: Vec<ChannelRevolutions>) {
    for of_scan in more {
        match rows.iter_mut().find(|row| row.key == of_scan.key) {
            Some(row) => row.revolutions.extend(of_scan.revolutions),
            None => rows.push(of_scan),
        }
    }
}

/// Removes the rows with fewer revolutions than another row, and returns their keys. All rows are of one mounting.
pub fn remove_channels_with_fewer_revolutions(rows: &mut Vec<ChannelRevolutions>) -> Vec<ChannelAtMounting> {
    let most = rows.iter().map(|row| row.revolutions.len()).max().unwrap_or(0);
    let incomplete = rows.extract_if(.., |row| row.revolutions.len() < most);
    incomplete.map(|row| row.key).collect()
}
