//! Correction of a linear drift between the revolutions of a channel.

use super::shared_revolutions::ChannelRevolutions;

impl ChannelRevolutions {
    /// Returns the revolutions without a deviation that is linear in time. The revolutions are consecutive and of
    /// equal duration: the first `forward_count` of them in the direction of the angle, the others in the opposite one.
    /// The mean over the revolutions at each angle does not change. If as many revolutions turn forward as
    /// backward, the drift affects neither this mean nor the scatter of the corrected revolutions.
    pub fn without_linear_drift(&self, forward_count: usize) -> Self {
        let count = self.revolutions.len();
        let samples = self.revolutions.first().map_or(0, Vec::len);
        let time = |r: usize, j: usize| (r * samples + if r < forward_count { j } else { samples - 1 - j }) as f64;
        let mean = |of: &dyn Fn(usize) -> f64| (0..count).map(of).sum::<f64>() / count as f64;
        let mut corrected = self.clone();
        let (mut products, mut squares) = (0.0, 0.0);
        for j in 0..samples {
            let (mean_time, mean_value) = (mean(&|r| time(r, j)), mean(&|r| self.revolutions[r][j]));
            for r in 0..count {
                let (after, by) = (time(r, j) - mean_time, self.revolutions[r][j] - mean_value);
                products += after * by;
                squares += after * after;
            }
        }
        let rate = if squares > 0.0 { products / squares } else { 0.0 };
        for j in 0..samples {
            let mean_time = mean(&|r| time(r, j));
            for r in 0..count {
                corrected.revolutions[r][j] -= rate * (time(r, j) - mean_time);
            }
        }
        corrected
    }
}
