//! Basis functions of the rotary angle; each error motion is a linear combination of them.

use std::f64::consts::TAU;

/// Basis functions, the same for all six error motions.
#[derive(Debug, Clone, PartialEq)]
pub enum AngleBasis {
    /// cos kθ and sin kθ for k = 1..=`order`, then cos θ/n and sin θ/n for n = 2..=`sub_order` (paper 5, Eq.
    /// (2); the constant that the equation lacks is gauge). θ is the commanded angle, not wrapped.
    Fourier { order: usize, sub_order: usize },
    /// A separate value at each stop instead of functions of the angle; holds the number of stops.
    ValuePerStop(usize),
}

impl AngleBasis {
    pub fn function_count(&self) -> usize {
        match self {
            Self::Fourier { order, sub_order } => 2 * (order + sub_order.saturating_sub(1)),
            AngleBasis::ValuePerStop(count) => *count,
        }
    }

    pub fn has_sub_harmonics(&self) -> bool {
        matches!(self, Self::Fourier { sub_order, .. } if *sub_order > 1)
    }

    /// Values of the functions at the stop `stop` with the commanded `angle`, rad.
    pub fn function_values(&self, angle: f64, stop: usize) -> Vec<f64> {
        match self {
            Self::Fourier { .. } => {
                let pairs = self.periods_per_revolution().map(|frequency| (frequency * angle).sin_cos());
                pairs.flat_map(|(sin, cos)| [cos, sin]).collect()
            }
            AngleBasis::ValuePerStop(count) => (0..*count).map(|i| f64::from(u8::from(i == stop))).collect(),
        }
    }

    /// Suffix of each function in the symbol of a parameter: `c2`, `s2`, `c1/2`, `s1/2`.
    pub fn function_suffixes(&self) -> Vec<String> {
        match self {
            Self::Fourier { order, sub_order } => {
                let harmonics = (1..=*order).map(|k| k.to_string());
                let subs = (2..=*sub_order).map(|n| format!("1/{n}"));
                harmonics.chain(subs).flat_map(|k| [format!("c{k}"), format!("s{k}")]).collect()
            }
            AngleBasis::ValuePerStop(count) => (1..=*count).map(|stop| format!("stop{stop}")).collect(),
        }
    }

    /// Periods per revolution of each pair of cosine and sine; empty if each stop has a separate value.
    pub fn periods_per_revolution(&self) -> impl Iterator<Item = f64> {
        let (order, sub_order) = match self {
            Self::Fourier { order, sub_order } => (*order, *sub_order),
            AngleBasis::ValuePerStop(_) => (0, 0),
        };
        let subs = (2..=sub_order).map(|n| 1.0 / n as f64);
        (1..=order).map(|k| k as f64).chain(subs)
    }
}

/// Equally spaced angles from 0 in one revolution, rad.
pub fn equal_angles(count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| TAU * i as f64 / count as f64)
}
