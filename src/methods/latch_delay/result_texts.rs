//! Texts of the results for the operator.

use super::evaluation::EvaluatedRun;
use super::fit::FittedDelay;
use super::observe::ObservedTouches;
use super::plc_scan_test::{LatchDiagnosis, PlcScanTest, PlcScanTime, SIGNIFICANCE_LEVEL};
use estimation::coverage::chi_square_bounds;

/// Probability that the observed scatter of the slow touches lies within its two-sided bounds if the declared scatter
/// is true. Only scatter above the upper bound is reported.
const SCATTER_BOUNDS_PROBABILITY: f64 = 0.998;

/// Upper χ² bound of the experimental standard deviation of slow touches, mm, for the declared scatter and, if one is
/// detected, the longest PLC scan within its uncertainty. `None`: no scatter is declared.
pub fn max_explained_slow_touch_std_dev_mm(run: &EvaluatedRun) -> Option<f64> {
    let [slow, _] = run.fitted.scatter_by_feed;
    let declared_mm = run.declared_scatter_mm?;
    let explained = match run.plc_scan_test.latch_diagnosis {
        // With the upper bound of the scan duration.
        LatchDiagnosis::PlcScan(time) => {
            declared_mm.powi(2) + (run.observed.speeds_mm_s()[0] * time.upper_bound_s()).powi(2) / 12.0
        }
        _ => declared_mm.powi(2),
    };
    let (_, upper) = chi_square_bounds(slow.dof, SCATTER_BOUNDS_PROBABILITY)?;
    Some((upper * explained / slow.dof).sqrt())
}

/// Text on the location of the latch.
pub fn describe_latch(run: &EvaluatedRun) -> String {
    let EvaluatedRun { observed, fitted, plc_scan_test: scan, .. } = run;
    let [slow, fast] = observed.feeds_mm_min;
    let [s_slow, s_fast] = fitted.scatter_by_feed.map(|scatter| scatter.std_dev_mm * 1e3);
    let scatter = format!(
        "touches scatter by {s_slow:.2} µm at {slow} mm/min and by {s_fast:.2} µm at {fast} mm/min ({})",
        describe_plc_scan_test(scan)
    );
    match scan.latch_diagnosis {
        LatchDiagnosis::NoPlcScan { max_undetected_s } => format!(
            "the control latches contacts itself: {} touches show no scan longer than {:.2} ms; \
             {scatter}",
            observed.touches.len(),
            max_undetected_s * 1e3
        ),
        LatchDiagnosis::PlcScan(time) => format!(
            "a program scan of about {:.1} ms (U = {:.1} ms), e.g. of a PLC, latches the contact: \
             {scatter}; each touch at {slow} mm/min is late by 0 to {:.2} µm",
            time.duration_s * 1e3,
            time.expanded_uncertainty_s() * 1e3,
            observed.speeds_mm_s()[0] * time.duration_s * 1e3
        ),
        LatchDiagnosis::ExcessScatter(PlcScanTime { duration_s, .. }) => format!(
            "{scatter}, but the delay is too short for the scan of {:.1} ms that this scatter \
             needs: the machine or the part vibrates at that feed, or the probe is loose",
            duration_s * 1e3
        ),
    }
}

/// Text on a delay, late or early, that exceeds its expanded uncertainty U. `None` for a smaller delay.
pub fn describe_significant_delay(EvaluatedRun { observed, fitted, .. }: &EvaluatedRun) -> Option<String> {
    let [slow, _] = observed.feeds_mm_min;
    let (delay_ms, expanded_ms) = (fitted.delay_s * 1e3, fitted.delay_uncertainty.expanded() * 1e3);
    if delay_ms > expanded_ms {
        Some(format!(
            "a contact is latched {delay_ms:.2} ms late (U = {expanded_ms:.2} ms): {:.2} µm at \
             {slow} mm/min in every direction, the same effect as additional pre-travel of the \
             probe; compare only touches at one feed",
            observed.speeds_mm_s()[0] * delay_ms
        ))
    } else if delay_ms < -expanded_ms {
        Some(format!(
            "a contact is latched {:.2} ms early (U = {expanded_ms:.2} ms): the control corrects \
             for too long a probe delay, or the axes do not move at the commanded feed",
            -delay_ms
        ))
    } else {
        None
    }
}

/// Text on slow touches that scatter more than explained. `None`: the scatter is explained, or no scatter is declared.
pub fn describe_excess_scatter(run: &EvaluatedRun) -> Option<String> {
    let (declared_mm, scatter_mm) = (run.declared_scatter_mm?, run.fitted.scatter_by_feed[0].std_dev_mm);
    if scatter_mm <= max_explained_slow_touch_std_dev_mm(run)? {
        return None;
    }
    Some(format!(
        "touches scatter by {:.2} µm at {} mm/min; repeatability_um in [probe] and the display \
         resolution explain {:.2} µm: increase repeatability_um, or check for dirt, a loose stylus \
         or a loose part",
        scatter_mm * 1e3,
        run.observed.feeds_mm_min[0],
        declared_mm * 1e3
    ))
}

pub fn estimate_warnings(run: &EvaluatedRun) -> Vec<String> {
    let is_without_scan = matches!(run.plc_scan_test.latch_diagnosis, LatchDiagnosis::NoPlcScan { .. });
    let latch_warning = (!is_without_scan).then(|| describe_latch(run));
    let time_warning = || "the readings have no times (t_s): the drift is fitted over their order".to_owned();
    let time_warning = (!run.observed.has_times).then(time_warning);
    [latch_warning, describe_significant_delay(run), describe_excess_scatter(run), time_warning]
        .into_iter()
        .flatten()
        .collect()
}

/// Text such as `F = 840 against 4.7 at 1 %`.
fn describe_plc_scan_test(scan: &PlcScanTest) -> String {
    format!(
        "F = {:.1} against {:.1} at {} %",
        scan.fast_to_slow_variance_ratio,
        scan.variance_ratio_limit,
        SIGNIFICANCE_LEVEL * 100.0
    )
}

pub fn describe_conventions(observed: &ObservedTouches, fitted: &FittedDelay) -> Vec<String> {
    let [slow, fast] = observed.feeds_mm_min;
    vec![
        "positive: latched after contact, farther along the touch".to_owned(),
        format!(
            "s_{slow}, s_{fast}: experimental standard deviation of a touch at that feed in \
             mm/min; the uncertainties follow from it, not from the declared repeatability"
        ),
        format!(
            "a linear drift is fitted and removed ({:.2} µm/min along the touch); the order slow, \
             fast, fast, slow separates it from the delay",
            fitted.drift_mm_s * 60e3
        ),
        "the axes are assumed to move at the commanded feed: with a feed override other than 100 % \
         all times are wrong in proportion"
            .to_owned(),
        format!("all touches start at one position, about {:.2} mm before contact", observed.mean_contact_distance_mm),
    ]
}

pub fn describe_not_identifiable(run: &EvaluatedRun) -> Vec<String> {
    let mut lines = vec![
        "the cause of a constant delay: the filter or radio link of the probe, the control and, if \
         the control latches commanded positions, the following error of the axes have the same \
         effect"
            .to_owned(),
        "a scan that is synchronous with the touches, so that each contact has the same phase: its \
         effect is that of a constant delay"
            .to_owned(),
    ];
    if let LatchDiagnosis::NoPlcScan { max_undetected_s } = run.plc_scan_test.latch_diagnosis {
        lines.push(format!("a scan shorter than {:.2} ms: {}", max_undetected_s * 1e3, describe_latch(run)));
    }
    lines
}
