//! Measurements that are far from all others, by one rule for all methods: an externally studentised residual beyond
//! the limit of Student's t for so many rows (Bonferroni). The scatter of all others counts, but not less than declared.

use estimation::coverage::two_sided;

/// Probability of a false alarm over all measurements.
const FALSE_ALARM: f64 = 1e-3;
/// A row that is explained by itself to this degree is checked by no other.
const UNCHECKED: f64 = 1.0 - 1e-4;
/// Two measurements whose residual patterns are parallel to this degree cannot be told apart.
const ALIKE: f64 = 1.0 - 1e-6;
/// Probability with which a deviation of the size of [`RowResiduals::smallest_found`] is found.
const POWER: f64 = 0.95;

/// Residuals of a solved fit, row by row.
pub struct RowResiduals<'a> {
    /// Weighted (divided by the standard uncertainties), measured less model.
    pub residuals: &'a [f64],
    /// How far each row is explained by itself, 0 to 1.
    pub leverage: &'a [f64],
    /// Rows less rank.
    pub dof: usize,
    /// Whether the standard uncertainties are declared; otherwise the residuals alone judge.
    pub is_declared: bool,
    /// Rows of each measurement.
    pub rows: Vec<std::ops::Range<usize>>,
}

/// A measurement that is far from all others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FarMeasurement {
    /// Its number among those given.
    pub number: usize,
    /// Largest externally studentised residual of its rows.
    pub t: f64,
}

impl RowResiduals<'_> {
    /// In the order of the measurements. With fewer than two degrees of freedom nothing is checked.
    pub fn far_measurements(&self) -> Vec<FarMeasurement> {
        let Some(limit) = self.limit() else { return Vec::new() };
        let chi2: f64 = self.residuals.iter().map(|r| r * r).sum();
        // Residuals smaller than declared make nothing far.
        let least = if self.is_declared { 1.0 } else { f64::MIN_POSITIVE };
        let studentised = |row: usize| {
            if self.leverage[row] > UNCHECKED {
                return 0.0;
            }
            let own = self.residuals[row].powi(2) / (1.0 - self.leverage[row]);
            let others = ((chi2 - own) / (self.dof - 1) as f64).max(least);
            (own / others).sqrt()
        };
        let all = self.rows.iter().enumerate().map(|(number, rows)| {
            let t = rows.clone().map(studentised).fold(0.0, f64::max);
            FarMeasurement { number, t }
        });
        all.filter(|far| far.t > limit).collect()
    }

    /// Smallest deviation of a row, in its standard uncertainties, that is found with a probability of 0.95. Infinite
    /// for a row that no other checks.
    pub fn smallest_found(&self, row: usize) -> f64 {
        match self.limit() {
            Some(limit) if self.leverage[row] <= UNCHECKED => {
                let margin = two_sided(2.0 * POWER - 1.0, (self.dof - 1) as f64);
                (limit + margin) / (1.0 - self.leverage[row]).sqrt()
            }
            _ => f64::INFINITY,
        }
    }

    fn limit(&self) -> Option<f64> {
        let rows: usize = self.rows.iter().map(|rows| rows.len()).sum();
        let probability = 1.0 - FALSE_ALARM / rows.max(1) as f64;
        (self.dof >= 2).then(|| two_sided(probability, (self.dof - 1) as f64))
    }
}

/// Whether deviations of two measurements leave the same pattern in the residuals. `patterns`: the residuals that a
/// deviation of each leaves.
pub fn are_alike(patterns: [&[f64]; 2]) -> bool {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let [one, other] = patterns;
    product(one, other).powi(2) > ALIKE * product(one, one) * product(other, other)
}
