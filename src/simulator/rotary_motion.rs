//! Error motions of a rotary axis that are declared by magnitude.

use serde::{Deserialize, Serialize};

use machine::Axis;

/// `[[simulated.rotary_motion]]`: drawn from the seed, with these standard deviations of each component at
/// every angle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotaryMotionMagnitudes {
    pub axis: Axis,
    /// Standard deviation of the part of EX., EY. and EZ. that repeats in each revolution.
    #[serde(default)]
    pub linear_um: f64,
    /// Standard deviation of EA. and EB.; all of it repeats.
    #[serde(default)]
    pub angular_urad: f64,
    /// Highest whole order of the part that repeats; the orders start at 1; 0: none.
    #[serde(default)]
    pub max_order: u32,
    /// Largest n of the additional orders 1/2 to 1/n; 0: none.
    #[serde(default)]
    pub sub_harmonics: u32,
    /// Standard deviation of the part of EX., EY. and EZ. that does not repeat.
    #[serde(default)]
    pub asynchronous_um: f64,
}

impl RotaryMotionMagnitudes {
    /// Orders of the part that repeats: whole orders, then the fractions 1/2, 1/3 and so on.
    pub(super) fn synchronous_orders(&self) -> Vec<f64> {
        let whole = (1..=self.max_order).map(f64::from);
        whole.chain((2..=self.sub_harmonics).map(|n| 1.0 / f64::from(n))).collect()
    }

    /// Whether the axis is rotary and the standard deviations are finite and not negative.
    pub(super) fn is_valid(&self) -> bool {
        let sizes = [self.linear_um, self.angular_urad, self.asynchronous_um];
        !self.axis.is_linear() && sizes.iter().all(|size| size.is_finite() && *size >= 0.0)
    }
}
