//! Control charts of single values (NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2 and
//! 6.3.2.4).

use serde::Serialize;

/// Expected range of two standard normal values (control chart factor d₂).
const CHART_FACTOR_D2: f64 = 1.128;
/// Half width of the control limits, in standard deviations.
const CONTROL_LIMIT_SIGMAS: f64 = 3.0;
/// Weight of the newest value: small enough to detect changes that single values do not show; the value of
/// the e-Handbook's example.
const EWMA_WEIGHT: f64 = 0.3;

/// Rounding error of a mean near `centre`. Identical values have no scatter and must lie within their limits.
fn rounding_error(centre: f64) -> f64 {
    64.0 * f64::EPSILON * centre.abs()
}

/// Individuals chart. Its scatter comes from successive differences, so that a slow change does not widen it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IndividualsChart {
    /// Mean of the values.
    pub centre: f64,
    /// Standard deviation of a single value: mean absolute successive difference divided by d₂.
    pub sigma: f64,
}

impl IndividualsChart {
    /// Individuals chart of the values. `None`: fewer than two values.
    pub fn from_values(values: &[f64]) -> Option<Self> {
        let ranges = values.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        let count = values.len().checked_sub(1).filter(|count| *count > 0)? as f64;
        let sigma = ranges.sum::<f64>() / count / CHART_FACTOR_D2;
        Some(Self { centre: values.iter().sum::<f64>() / values.len() as f64, sigma })
    }

    /// Lower and upper control limit.
    pub fn control_limits(&self) -> [f64; 2] {
        [self.centre - CONTROL_LIMIT_SIGMAS * self.sigma, self.centre + CONTROL_LIMIT_SIGMAS * self.sigma]
    }

    pub fn is_within_limits(&self, value: f64) -> bool {
        (value - self.centre).abs() <= CONTROL_LIMIT_SIGMAS * self.sigma + rounding_error(self.centre)
    }
}

/// Exponentially weighted moving average (EWMA) chart, with narrower limits at the first values.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EwmaChart {
    /// Centre of the limits, from which the average starts.
    pub centre: f64,
    /// Moving average at each value.
    pub means: Vec<f64>,
    /// Half width of the control limits at each value.
    pub widths: Vec<f64>,
}

impl EwmaChart {
    /// Chart of `values`, whose average starts at `centre`. `sigma`: standard deviation of a single value.
    pub fn from_values(values: &[f64], centre: f64, sigma: f64) -> Self {
        let means = values.iter().scan(centre, |mean, value| {
            *mean += EWMA_WEIGHT * (value - *mean);
            Some(*mean)
        });
        let width = |number: usize| {
            let settled = 1.0 - (1.0 - EWMA_WEIGHT).powi(2 * (number as i32 + 1));
            CONTROL_LIMIT_SIGMAS * sigma * (EWMA_WEIGHT / (2.0 - EWMA_WEIGHT) * settled).sqrt()
        };
        let widths = (0..values.len()).map(width).collect();
        Self { centre, means: means.collect(), widths }
    }

    /// Whether the newest mean lies outside its limits.
    pub fn is_newest_mean_outside_limits(&self) -> bool {
        let newest = self.means.last().zip(self.widths.last());
        let beyond = |mean: f64, width: f64| (mean - self.centre).abs() > width + rounding_error(self.centre);
        newest.is_some_and(|(mean, width)| beyond(*mean, *width))
    }
}
