//! Detection of a channel whose time stamps come from a separate clock.

use std::f64::consts::TAU;

use faer::c64;

use super::harmonics::HarmonicBasis;
use super::shared_revolutions::ChannelRevolutions;

/// A clock deviation is accepted if it reduces the squared difference between revolutions to less than this
/// fraction.
const MAX_RESIDUAL_RATIO_AFTER_CLOCK_FIT: f64 = 0.25;
/// Smallest relative clock deviation that is reported. A smaller one shifts the twentieth harmonic by less than 15°
/// in one revolution.
const MIN_REPORTED_CLOCK_RATE_ERROR: f64 = 2e-3;
/// Largest relative clock deviation in the search.
const MAX_SEARCHED_CLOCK_RATE_ERROR: f64 = 0.05;

/// Relative deviation of the clock rate of one channel, positive if its clock is fast, from the shift of its pattern
/// between revolutions. The revolutions of a row are consecutive and in the same direction. `None`: no clear
/// deviation.
pub fn estimate_clock_rate_error<'a>(rows: impl Iterator<Item = &'a ChannelRevolutions>) -> Option<f64> {
    let mut pairs: Vec<(usize, c64, c64)> = Vec::new();
    for row in rows {
        let samples = row.revolutions.first()?.len();
        let basis = HarmonicBasis::new(samples, (samples / 8).clamp(1, 20));
        let harmonics: Vec<Vec<c64>> = row.revolutions.iter().map(|r| basis.harmonics(r)).collect();
        for revolution in harmonics.windows(2) {
            let orders = revolution[0].iter().zip(&revolution[1]).enumerate();
            pairs.extend(orders.map(|(k, (before, after))| (k + 1, *before, *after)));
        }
    }
    // A clock that is fast by ε gives M·e^(−ik·2πε) one revolution later.
    let misfit = |relative: f64| -> f64 {
        let of = |(order, before, after): &(usize, c64, c64)| {
            (*after * c64::cis(*order as f64 * TAU * relative) - *before).norm_sqr()
        };
        pairs.iter().map(of).sum()
    };
    let candidates = (-500..=500).map(|i| f64::from(i) / 500.0 * MAX_SEARCHED_CLOCK_RATE_ERROR);
    let best = candidates.min_by(|a, b| misfit(*a).total_cmp(&misfit(*b)))?;
    let is_clear = misfit(best) < MAX_RESIDUAL_RATIO_AFTER_CLOCK_FIT * misfit(0.0);
    (is_clear && best.abs() >= MIN_REPORTED_CLOCK_RATE_ERROR).then_some(best)
}
