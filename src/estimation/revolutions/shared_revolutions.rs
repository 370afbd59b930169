//! The revolutions that the channels of one scan share.

use super::resample::{AngleRange, Resampled};

/// One channel in one repetition of the measurement. Channels of the same index are sampled together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ChannelAtIndex {
    pub index: usize,
    pub channel: usize,
}

/// Revolutions of one channel at one index, resampled to equal angles that start at 0.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelRevolutions {
    pub key: ChannelAtIndex,
    /// Values, revolutions × angles. All channels of one index have the same revolutions.
    pub revolutions: Vec<Vec<f64>>,
}

impl ChannelRevolutions {
    /// Mean of the revolutions at each angle.
    pub fn mean(&self) -> Vec<f64> {
        let angles = self.revolutions.first().map_or(0, Vec::len);
        let count = self.revolutions.len() as f64;
        let at = |i: usize| self.revolutions.iter().map(|values| values[i]).sum::<f64>() / count;
        (0..angles).map(at).collect()
    }
}

/// Revolutions of a channel that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{rejected} of {revolutions} revolutions have missing samples ({}); measure again, or move the sensor back into its range",
    AngleRange::format_ranges(.gaps)
)]
pub struct RejectedRevolutions {
    pub channel: usize,
    pub rejected: usize,
    pub revolutions: usize,
    pub gaps: Vec<AngleRange>,
}

/// The revolutions that all usable channels of one scan share. A channel without a usable revolution is left
/// out.
pub fn common_revolutions(index: usize, channels: &[Resampled]) -> (Vec<ChannelRevolutions>, Vec<RejectedRevolutions>) {
    let Some(Resampled { steps, .. }) = channels.first() else { return Default::default() };
    // The channels with the most whole revolutions define the range. Missing samples at an end of another channel
    // are a gap of that channel.
    let whole = |(from, to): (i64, i64)| usize::try_from(to - from + 1).unwrap_or(0) / steps;
    let most = channels.iter().map(|channel| whole(channel.index_range())).max().unwrap_or(0);
    let ends = || channels.iter().map(Resampled::index_range).filter(|ends| whole(*ends) == most);
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
            rejections.push(RejectedRevolutions { channel, rejected, revolutions: count, gaps });
        }
        let revolutions: Vec<Vec<f64>> = common.iter().filter_map(|r| of[*r].clone()).collect();
        if !revolutions.is_empty() {
            rows.push(ChannelRevolutions { key: ChannelAtIndex { index, channel }, revolutions });
        }
    }
    (rows, rejections)
}

/// Appends the revolutions of another scan of the same index.
pub fn append_revolutions(rows: &mut Vec<ChannelRevolutions>, more: Vec<ChannelRevolutions>) {
    for of_scan in more {
        match rows.iter_mut().find(|row| row.key == of_scan.key) {
            Some(row) => row.revolutions.extend(of_scan.revolutions),
            None => rows.push(of_scan),
        }
    }
}

/// Removes the rows of an index that have fewer revolutions than the other rows, and returns their keys.
pub fn remove_incomplete_rows(rows: &mut Vec<ChannelRevolutions>) -> Vec<ChannelAtIndex> {
    let most = rows.iter().map(|row| row.revolutions.len()).max().unwrap_or(0);
    let incomplete = rows.extract_if(.., |row| row.revolutions.len() < most);
    incomplete.map(|row| row.key).collect()
}
