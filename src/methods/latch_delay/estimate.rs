//! The estimate in the terms and units of the Estimate JSON.

use super::evaluation::EvaluatedRun;
use super::fit::FeedScatter;
use super::plc_scan_test::{LatchDiagnosis, PlcScanTest, PlcScanTime};
use super::result_texts;
use crate::identification::{function_of_numbered_values, parameter_without_budget};
use estimation::coverage::coverage_factor;
use machine::record::estimate::{Estimate, EstimatedFunction, FunctionFigureKind, Parameter, Unit};

/// Symbol of the duration of the PLC scan between contact and latch.
const PLC_SCAN_TIME_SYMBOL: &str = "T_scan";

pub fn build_estimate(run: &EvaluatedRun) -> Estimate {
    let EvaluatedRun { observed, fitted, plc_scan_test: scan, declared_scatter_mm } = run;
    let mut estimate = fitted.identification.estimate(super::METHOD_NAME);
    estimate.parameters.push(plc_scan_parameter(scan));
    let scatter = observed.feeds_mm_min.into_iter().zip(fitted.scatter_by_feed);
    estimate.parameters.extend(scatter.map(|(feed, scatter)| scatter_parameter(feed, scatter)));
    estimate.functions.extend([0, 1].map(|feed| overtravel_by_touch(run, feed)));
    let figures = &fitted.identification.fit_quality;
    let chi2 = |mm: f64| observed.touches.len() as f64 * (figures.residual_rms_mm / mm).powi(2);
    Estimate {
        gauge: result_texts::describe_conventions(observed, fitted),
        not_identifiable: result_texts::describe_not_identifiable(run),
        // χ² relative to the declared scatter, as the weights follow from the residuals.
        chi2_per_dof: declared_scatter_mm.map_or(1.0, |mm| chi2(mm) / figures.dof as f64),
        warnings: result_texts::estimate_warnings(run),
        ..estimate
    }
}

/// Standard deviation of a touch at one feed, with the standard uncertainty of the standard deviation.
fn scatter_parameter(feed_mm_min: f64, FeedScatter { std_dev_mm, dof }: FeedScatter) -> Parameter {
    // Standard uncertainty of a standard deviation: GUM E.4.3.
    let u_mm = std_dev_mm / (2.0 * dof).sqrt();
    parameter_without_budget(&format!("s_{feed_mm_min}"), Unit::Um, std_dev_mm, u_mm, Some(dof))
}

/// Parameter of the duration of a PLC scan. If no scan is detected, its value is 0, not identifiable, and its U is
/// the longest undetected scan, or, for excess scatter, the scan that would cause this scatter.
fn plc_scan_parameter(scan: &PlcScanTest) -> Parameter {
    let max_duration_s = match scan.latch_diagnosis {
        LatchDiagnosis::PlcScan(PlcScanTime { duration_s, u_s, dof }) => {
            let dof = Some(dof).filter(|dof| dof.is_finite());
            return parameter_without_budget(PLC_SCAN_TIME_SYMBOL, Unit::Ms, duration_s, u_s, dof);
        }
        LatchDiagnosis::NoPlcScan { max_undetected_s } => max_undetected_s,
        LatchDiagnosis::ExcessScatter(PlcScanTime { duration_s, .. }) => duration_s,
    };
    let u_s = max_duration_s / coverage_factor(f64::INFINITY);
    Parameter { identifiable: false, ..parameter_without_budget(PLC_SCAN_TIME_SYMBOL, Unit::Ms, 0.0, u_s, None) }
}

/// Overtravel of each touch at one feed, in the order of the steps.
fn overtravel_by_touch(run: &EvaluatedRun, feed_index: usize) -> EstimatedFunction {
    let EvaluatedRun { observed, fitted, .. } = run;
    let touches = observed.touches.iter().zip(&fitted.overtravel_of_touches_mm);
    let at_feed = touches.filter(|(touch, _)| touch.feed_index == feed_index).map(|(_, mm)| *mm);
    let function = function_of_numbered_values(&format!("E_F{}", observed.feeds_mm_min[feed_index]), "touch", at_feed);
    let u_um = Unit::Um.to_reported_value(fitted.scatter_by_feed[feed_index].std_dev_mm);
    EstimatedFunction { u: vec![u_um; function.y.len()], figure: FunctionFigureKind::Curve, ..function }
}
