//! Detection of a program scan of a PLC between contact and latch.

use super::fit::{FeedScatter, FittedDelay};
use super::observe::ObservedTouches;
use estimation::coverage::{coverage_factor, variance_ratio_bound};

/// Significance level of the detection: probability of a false detection.
pub const SIGNIFICANCE_LEVEL: f64 = 0.01;
/// Fourth moment of a rectangular distribution divided by its squared variance.
const RECTANGULAR_KURTOSIS: f64 = 1.8;

/// Where contacts are latched (control or PLC), as far as the touches determine this.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LatchDiagnosis {
    /// The control latches. No PLC scan is detected. A scan longer than `max_undetected_s` would have been detected.
    NoPlcScan { max_undetected_s: f64 },
    /// A scan of a PLC of this duration latches the contact.
    PlcScan(PlcScanTime),
    /// Fast touches scatter more than slow touches, but the delay is too short for the PLC scan that would explain the
    /// scatter.
    ExcessScatter(PlcScanTime),
}

/// Duration of a PLC scan that explains the scatter, with its standard uncertainty and degrees of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlcScanTime {
    pub duration_s: f64,
    pub u_s: f64,
    pub dof: f64,
}

impl PlcScanTime {
    pub fn expanded_uncertainty_s(&self) -> f64 {
        coverage_factor(self.dof) * self.u_s
    }

    /// Scan duration plus its expanded uncertainty, s.
    pub fn upper_bound_s(&self) -> f64 {
        self.duration_s + self.expanded_uncertainty_s()
    }
}

/// Result of the F test for a scan.
pub struct PlcScanTest {
    pub latch_diagnosis: LatchDiagnosis,
    /// Variance at the fast feed divided by the variance at the slow feed.
    pub fast_to_slow_variance_ratio: f64,
    /// Upper limit of the ratio. Without a PLC scan, the ratio exceeds the limit with probability
    /// [`SIGNIFICANCE_LEVEL`].
    pub variance_ratio_limit: f64,
}

/// One-sided F test whether touches scatter more at the fast feed than at the slow one, as they do with a PLC scan, and
/// the resulting diagnosis of the latch.
pub fn test_for_plc_scan(observed: &ObservedTouches, fitted: &FittedDelay) -> PlcScanTest {
    let [slow, fast] = fitted.scatter_by_feed;
    let fast_to_slow_variance_ratio = (fast.std_dev_mm / slow.std_dev_mm).powi(2);
    let variance_ratio_limit =
        variance_ratio_bound(1.0 - SIGNIFICANCE_LEVEL, fast.dof, slow.dof).unwrap_or(f64::INFINITY);
    let latch_diagnosis = if fast_to_slow_variance_ratio > variance_ratio_limit {
        let time = plc_scan_time(observed.speeds_mm_s(), slow, fast);
        // The mean delay of a scan is at least half of its duration.
        let missing_delay_s = time.duration_s / 2.0 - fitted.delay_s;
        let delay = &fitted.delay_uncertainty;
        let dof = delay.dof.map_or(time.dof, |dof| dof.min(time.dof));
        match missing_delay_s > coverage_factor(dof) * delay.u.hypot(time.u_s / 2.0) {
            true => LatchDiagnosis::ExcessScatter(time),
            false => LatchDiagnosis::PlcScan(time),
        }
    } else {
        let speeds = observed.speeds_mm_s();
        let max_undetected_s = max_undetected_plc_scan_s(speeds, fitted, fast_to_slow_variance_ratio);
        LatchDiagnosis::NoPlcScan { max_undetected_s }
    };
    PlcScanTest { latch_diagnosis, fast_to_slow_variance_ratio, variance_ratio_limit }
}

/// Scan duration T from s₂² − s₁² = (v₂² − v₁²)·T²/12, with index 1 for the slow feed. The variance of n touches has
/// the variance μ₄/n − σ⁴(n − 3)/(n(n − 1)). For a rectangular part A and a normal part B, μ₄ is 1.8 A² + 6 AB + 3
/// B².
fn plc_scan_time(speeds: [f64; 2], slow: FeedScatter, fast: FeedScatter) -> PlcScanTime {
    let span = speeds[1].powi(2) - speeds[0].powi(2);
    let more = fast.std_dev_mm.powi(2) - slow.std_dev_mm.powi(2);
    let t_s = (12.0 * more / span).sqrt();
    let all = fast.std_dev_mm.powi(2);
    let flat = ((speeds[1] * t_s).powi(2) / 12.0).min(all);
    let normal = all - flat;
    let fourth = RECTANGULAR_KURTOSIS * flat * flat + 6.0 * flat * normal + 3.0 * normal * normal;
    let n = fast.dof + 1.0;
    let of_fast = fourth / n - all * all * (n - 3.0) / (n * (n - 1.0));
    let of_slow = 2.0 * slow.std_dev_mm.powi(4) / slow.dof;
    let variance = of_fast.max(0.0) + of_slow;
    let u_s = 6.0 * variance.sqrt() / (span * t_s);
    PlcScanTime { duration_s: t_s, u_s, dof: 2.0 * more * more / variance }
}

/// Longest scan duration that is compatible with the scatter and with the mean delay plus its U, s. The mean delay is
/// at least half of the scan duration.
fn max_undetected_plc_scan_s(speeds: [f64; 2], fitted: &FittedDelay, variance_ratio: f64) -> f64 {
    let [slow, fast] = fitted.scatter_by_feed;
    let widest_ratio = variance_ratio_bound(1.0 - SIGNIFICANCE_LEVEL, slow.dof, fast.dof).unwrap_or(f64::INFINITY);
    let more = (variance_ratio.max(1.0) * widest_ratio - 1.0).max(0.0) * slow.std_dev_mm.powi(2);
    let by_scatter = (12.0 * more / (speeds[1].powi(2) - speeds[0].powi(2))).sqrt();
    by_scatter.min(2.0 * (fitted.delay_s.max(0.0) + fitted.delay_uncertainty.expanded()))
}
