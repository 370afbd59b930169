//! Outlier detection by one rule for all methods. An outlier is a measurement whose externally studentised
//! residual exceeds the limit of Student's t, or of Fisher's F for several rows, for the number of
//! measurements (Bonferroni). A residual is compared with the variance that the declared sources leave in it.
//! The scatter of all other residuals counts, but not less than declared.

use std::ops::Range;

use estimation::coverage::{two_sided_t_factor, variance_ratio_bound};
use estimation::misfit::Misfit;

use super::checked_measurement::MeasurementToCheck;
use super::observation_model::SolvedModel;
use machine::record::measurement_check::{MeasurementCheck, Outlier, OutlierCandidate};

/// Probability of a false alarm over all measurements.
const FALSE_ALARM_PROBABILITY: f64 = 1e-3;
/// Minimum share of the variance of a row that must remain in its residual. Below it no other row checks this
/// row.
const MIN_CHECKABLE_RESIDUAL_VARIANCE: f64 = 1e-4;
/// Squared cosine between the residual patterns of two measurements above which they are indistinguishable.
const MIN_PATTERN_COSINE_SQUARED: f64 = 1.0 - 1e-6;
/// Probability of detecting a deviation of the stated smallest detectable size.
const DETECTION_PROBABILITY: f64 = 0.95;

/// Result of the comparison of each measurement with all others.
pub struct OutlierCheck {
    /// Outliers, each with all measurements that may be its cause.
    pub outliers: Vec<Outlier>,
    /// Residual and smallest detectable deviation of each measurement.
    pub measurement_checks: Vec<MeasurementCheck>,
    /// One sentence for each outlier.
    pub warnings: Vec<String>,
}

impl OutlierCheck {
    /// `variances`: variance of each weighted residual from the declared sources.
    pub fn new(solution: &SolvedModel<'_>, misfit: &Misfit, variances: &[f64]) -> Self {
        let leverage = solution.model.leverage();
        let residuals = ResidualStatistics {
            weighted_residuals: solution.weighted_residuals,
            residual_variances: variances,
            effective_dof: misfit.effective_dof,
            scaled_chi2: misfit.chi2 * misfit.effective_dof / misfit.expected_chi2,
            has_declared_source_sizes: solution.has_declared_source_sizes,
        };
        let measurements = solution.measurements;
        let check = OutlierSearch { solution, residuals, leverage: &leverage };
        let outliers = check.find_outliers();
        let warnings = outliers.iter().map(|outlier| outlier_warning(outlier, measurements)).collect();
        let measurement_checks = measurements.iter().map(|m| check.check_measurement(m)).collect();
        Self { outliers, measurement_checks, warnings }
    }

    /// Text on the smallest detectable deviations. `None`: no measurement is checked.
    pub fn describe_detection_limits(&self) -> Option<String> {
        let mut sizes: Vec<(f64, &str)> = self
            .measurement_checks
            .iter()
            .map(|one| (one.min_detectable_deviation_um.unwrap_or(f64::INFINITY), one.label.as_str()))
            .collect();
        sizes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (middle, (largest, least_checked)) = (sizes.get(sizes.len() / 2)?.0, sizes.last()?);
        let found = |um: f64| match um.is_finite() {
            true => format!("{um:.1} µm"),
            false => "any size".to_owned(),
        };
        Some(format!(
            "deviations of a single measurement below {} (median of all measurements) to {} (measurement \
            {least_checked}): the probability of detection is less than 95 %",
            found(middle),
            found(*largest),
        ))
    }
}

struct OutlierSearch<'a> {
    solution: &'a SolvedModel<'a>,
    residuals: ResidualStatistics<'a>,
    leverage: &'a [f64],
}

impl OutlierSearch<'_> {
    fn find_outliers(&self) -> Vec<Outlier> {
        let mut list: Vec<Outlier> = Vec::new();
        for measurement in self.solution.measurements {
            let Some(limit) = self.studentised_residual_limit(measurement) else { continue };
            let t = self.residuals.studentised_residual(measurement.residual_rows.clone());
            if t <= limit {
                continue;
            }
            let candidates: Vec<OutlierCandidate> = self
                .measurements_indistinguishable_from(measurement)
                .into_iter()
                .map(|m| self.deviation_if_outlier(m))
                .collect();
            if list.iter().all(|known| known.candidates != candidates) {
                list.push(Outlier { candidates, studentised_residual: t, resolution: None });
            }
        }
        list
    }

    /// Limit of the measurement's studentised residual. `None`: no other measurement checks it.
    fn studentised_residual_limit(&self, measurement: &MeasurementToCheck) -> Option<f64> {
        let all = self.solution.measurements.len();
        self.residuals.studentised_limit(measurement.residual_rows.clone(), FALSE_ALARM_PROBABILITY / all as f64)
    }

    /// Measurements, `measurement` included, whose deviations leave the same pattern in the residuals. Measurements of
    /// several rows are distinguishable.
    fn measurements_indistinguishable_from<'m>(
        &'m self,
        measurement: &'m MeasurementToCheck,
    ) -> Vec<&'m MeasurementToCheck> {
        let SolvedModel { model, weighted_residuals: residuals, measurements, .. } = self.solution;
        if measurement.residual_rows.len() > 1 || model.observation_count() != residuals.len() {
            return vec![measurement];
        }
        let pattern = |of: &MeasurementToCheck| {
            let mut change = vec![0.0; residuals.len()];
            change[of.residual_rows.start] = of.u_mm;
            model.linear_response(&change).residual_changes
        };
        let own = pattern(measurement);
        let has_one_row = |other: &&MeasurementToCheck| other.residual_rows.len() == 1;
        measurements.iter().filter(has_one_row).filter(|other| are_indistinguishable([&own, &pattern(other)])).collect()
    }

    /// Deviation of this measurement if it is the only outlier.
    fn deviation_if_outlier(&self, measurement: &MeasurementToCheck) -> OutlierCandidate {
        let deviation_um = 1e3 * measurement.residual_mm / self.residual_share_of_deviation(measurement);
        OutlierCandidate { label: measurement.label.clone(), deviation_um }
    }

    /// Fraction of the measurement's deviation that remains in its residual.
    fn residual_share_of_deviation(&self, measurement: &MeasurementToCheck) -> f64 {
        let rows = measurement.residual_rows.clone();
        let sum: f64 = rows.filter_map(|row| self.leverage.get(row)).sum();
        1.0 - sum / measurement.residual_rows.len() as f64
    }

    /// Residual of the measurement, and its smallest detectable deviation in the direction in which the residuals show
    /// a deviation least.
    fn check_measurement(&self, measurement: &MeasurementToCheck) -> MeasurementCheck {
        let rows = measurement.residual_rows.clone();
        let least = rows.map(|row| self.residuals.residual_variances[row]).fold(0.0, f64::max).sqrt();
        let um = |limit: f64| {
            let residual = (limit + self.residuals.detection_margin()) * least;
            1e3 * residual * measurement.u_mm / self.residual_share_of_deviation(measurement)
        };
        let deviation_um = self.studentised_residual_limit(measurement).map(um);
        MeasurementCheck {
            label: measurement.label.clone(),
            t_s: Some(measurement.mean_time_s),
            residual_um: Some(1e3 * measurement.residual_mm),
            min_detectable_deviation_um: deviation_um,
        }
    }
}

/// The weighted residuals of all rows, and statistics of all of them together.
pub struct ResidualStatistics<'a> {
    /// Residuals divided by the standard uncertainties, measured minus model.
    pub weighted_residuals: &'a [f64],
    /// Variance of each weighted residual from the declared sources.
    pub residual_variances: &'a [f64],
    /// Sum of squares of all weighted residuals, scaled so that its expectation equals `effective_dof`.
    pub scaled_chi2: f64,
    /// Effective degrees of freedom of `scaled_chi2`.
    pub effective_dof: f64,
    /// Whether the standard uncertainties are declared; otherwise the scatter comes from the residuals alone.
    pub has_declared_source_sizes: bool,
}

impl ResidualStatistics<'_> {
    /// Rows that other rows check.
    fn checkable_rows(&self, rows: Range<usize>) -> impl Iterator<Item = usize> {
        rows.filter(|row| self.residual_variances[*row] >= MIN_CHECKABLE_RESIDUAL_VARIANCE)
    }

    /// The value that [`Self::studentised_residual`] of rows without an outlier exceeds with this `probability`.
    /// `None`: no other row checks them.
    pub fn studentised_limit(&self, rows: Range<usize>, probability: f64) -> Option<f64> {
        let own = self.checkable_rows(rows).count() as f64;
        let others = self.effective_dof - own;
        match own {
            _ if own < 1.0 || others < 1.0 => None,
            1.0 => Some(two_sided_t_factor(1.0 - probability, others)),
            _ => Some((own * variance_ratio_bound(1.0 - probability, own, others)?).sqrt()),
        }
    }

    /// Length of the residual relative to the scatter of all others; 0 for rows that no other row checks.
    pub fn studentised_residual(&self, rows: Range<usize>) -> f64 {
        let count = self.checkable_rows(rows.clone()).count() as f64;
        let square = |row: usize| self.weighted_residuals[row].powi(2) / self.residual_variances[row];
        let own: f64 = self.checkable_rows(rows).map(square).sum();
        // Residuals smaller than declared must not make a measurement an outlier.
        let least = if self.has_declared_source_sizes { 1.0 } else { f64::MIN_POSITIVE };
        (own / ((self.scaled_chi2 - own) / (self.effective_dof - count)).max(least)).sqrt()
    }

    /// Excess of a deviation over the limit that gives a detection probability of 0.95, as a multiple of the standard
    /// deviation of the residual.
    fn detection_margin(&self) -> f64 {
        two_sided_t_factor(2.0 * DETECTION_PROBABILITY - 1.0, self.effective_dof - 1.0)
    }
}

/// Whether deviations of two measurements leave the same pattern in the residuals. `patterns`: the residuals
/// that a deviation of each measurement leaves.
pub fn are_indistinguishable(patterns: [&[f64]; 2]) -> bool {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let [one, other] = patterns;
    product(one, other).powi(2) > MIN_PATTERN_COSINE_SQUARED * product(one, one) * product(other, other)
}

fn outlier_warning(outlier: &Outlier, measurements: &[MeasurementToCheck]) -> String {
    let candidate = |candidate: &OutlierCandidate| {
        let own = measurements.iter().find(|m| m.label == candidate.label);
        let in_words = own.map_or(&*candidate.label, |own| &own.description);
        format!("{in_words} by {:.1} µm", candidate.deviation_um)
    };
    let candidates: Vec<String> = outlier.candidates.iter().map(candidate).collect();
    let doubt = if candidates.len() > 1 { " (not distinguishable)" } else { "" };
    format!(
        "outlier, deviation from the fit to all others: {}{doubt}, {:.1} standard deviations. The declared \
        sources do not explain the deviation. Check for dirt, chips and loose parts. The result includes \
        this measurement; flag the readings `excluded` to remove the measurement",
        candidates.join(" or "),
        outlier.studentised_residual
    )
}
