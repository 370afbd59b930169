//! The estimate in the terms and units of the Estimate JSON.

use super::evaluation::EvaluatedRun;
use super::fit::FeedScatter;
use super::scan_test::{LatchDiagnosis, ScanTest, ScanTime};
use super::texts;
use crate::identification::{function_over_numbers, parameter_without_budget};
use estimation::coverage::coverage_factor;
use machine::record::estimate::{Estimate, EstimatedFunction, FigureKind, Parameter, Unit};

/// Symbol of the scan time between contact and latch.
const SCAN_TIME_SYMBOL: &str = "T_scan";

pub fn build_estimate(run: &EvaluatedRun) -> Estimate {
    let EvaluatedRun { observed, fitted, scan, declared_scatter_mm } = run;
    let mut estimate = fitted.identification.estimate(super::METHOD_NAME);
    estimate.parameters.push(scan_parameter(scan));
    let scatter = observed.feeds_mm_min.into_iter().zip(fitted.scatter);
    estimate.parameters.extend(scatter.map(|(feed, scatter)| scatter_parameter(feed, scatter)));
    estimate.functions.extend([0, 1].map(|feed| touch_positions(run, feed)));
    let figures = &fitted.identification.fit_quality;
    let chi2 = |mm: f64| observed.touches.len() as f64 * (figures.residual_rms_mm / mm).powi(2);
    Estimate {
        gauge: texts::describe_conventions(observed, fitted),
        not_identifiable: texts::not_identifiable(run),
        // χ² relative to the declared scatter, as the weights follow from the residuals.
        chi2_per_dof: declared_scatter_mm.map_or(1.0, |mm| chi2(mm) / figures.dof as f64),
        warnings: texts::estimate_warnings(run),
        ..estimate
    }
}

fn scatter_parameter(feed_mm_min: f64, FeedScatter { std_dev_mm, dof }: FeedScatter) -> Parameter {
    // Standard uncertainty of a standard deviation: GUM E.4.3.
    let u_mm = std_dev_mm / (2.0 * dof).sqrt();
    parameter_without_budget(&format!("s_{feed_mm_min}"), Unit::Um, std_dev_mm, u_mm, Some(dof))
}

/// Parameter of the scan time. If no scan is detected, its value is 0 with the longest undetectable scan as its
/// bound.
fn scan_parameter(scan: &ScanTest) -> Parameter {
    let max_duration_s = match scan.latch {
        LatchDiagnosis::Scan(ScanTime { duration_s, u_s, dof }) => {
            let dof = Some(dof).filter(|dof| dof.is_finite());
            return parameter_without_budget(SCAN_TIME_SYMBOL, Unit::Ms, duration_s, u_s, dof);
        }
        LatchDiagnosis::NoScan { max_undetected_s } => max_undetected_s,
        LatchDiagnosis::ExcessScatter(ScanTime { duration_s, .. }) => duration_s,
    };
    let u_s = max_duration_s / coverage_factor(f64::INFINITY);
    Parameter { identifiable: false, ..parameter_without_budget(SCAN_TIME_SYMBOL, Unit::Ms, 0.0, u_s, None) }
}

/// The touches at one feed in their order.
fn touch_positions(run: &EvaluatedRun, feed: usize) -> EstimatedFunction {
    let EvaluatedRun { observed, fitted, .. } = run;
    let touches = observed.touches.iter().zip(&fitted.overtravel_mm);
    let at_feed = touches.filter(|(touch, _)| touch.feed_index == feed).map(|(_, mm)| *mm);
    let function = function_over_numbers(&format!("E_F{}", observed.feeds_mm_min[feed]), "touch", at_feed);
    let u_um = Unit::Um.to_display_value(fitted.scatter[feed].std_dev_mm);
    EstimatedFunction { u: vec![u_um; function.y.len()], figure: FigureKind::Curve, ..function }
}
