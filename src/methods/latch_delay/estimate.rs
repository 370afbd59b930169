//! The estimate in the terms and units of the Estimate JSON.

use super::fit::{FittedDelay, Scatter};
use super::observe::ObservedTouches;
use super::scan_test::{LatchDiagnosis, ScanTest, ScanTime};
use super::texts;
use crate::identification::parameter_without_budget;
use estimation::coverage::coverage_factor;
use machine::record::estimate::{Estimate, EstimatedFunction, FigureKind, Parameter, Unit};
use machine::record::plan::Plan;

/// Symbol of the scan time between contact and latch.
const SCAN_TIME_SYMBOL: &str = "T_scan";

pub fn build_estimate(plan: &Plan, observed: &ObservedTouches, fitted: &FittedDelay, scan: &ScanTest) -> Estimate {
    let declared_mm = declared_scatter_mm(plan, observed);
    let mut estimate = fitted.identification.estimate(super::METHOD_NAME);
    estimate.parameters.push(scan_parameter(scan));
    let scatter = observed.feeds_mm_min.into_iter().zip(fitted.scatter);
    estimate.parameters.extend(scatter.map(|(feed, scatter)| scatter_parameter(feed, scatter)));
    estimate.functions.extend([0, 1].map(|feed| touch_positions(observed, fitted, feed)));
    let figures = &fitted.identification.figures;
    let chi2 = |mm: f64| observed.touches.len() as f64 * (figures.residual_rms_mm / mm).powi(2);
    Estimate {
        gauge: texts::describe_conventions(observed, fitted),
        not_identifiable: texts::not_identifiable(observed, fitted, scan),
        // χ² relative to the declared scatter, as the weights follow from the residuals.
        chi2_per_dof: declared_mm.map_or(1.0, |mm| chi2(mm) / figures.dof as f64),
        warnings: texts::estimate_warnings(observed, fitted, scan, declared_mm),
        ..estimate
    }
}

/// Declared scatter of a touch including the display resolution, mm.
pub fn declared_scatter_mm(plan: &Plan, observed: &ObservedTouches) -> Option<f64> {
    let declared = plan.probe.repeatability_um?;
    Some((declared * 1e-3).hypot(observed.resolution_mm / 12f64.sqrt()))
}

fn scatter_parameter(feed_mm_min: f64, Scatter { std_dev_mm, dof }: Scatter) -> Parameter {
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
    let mut parameter = parameter_without_budget(SCAN_TIME_SYMBOL, Unit::Ms, 0.0, u_s, None);
    parameter.identifiable = false;
    parameter
}

/// The touches at one feed in their order.
fn touch_positions(observed: &ObservedTouches, fitted: &FittedDelay, feed: usize) -> EstimatedFunction {
    let um = |mm: f64| Unit::Um.from_internal(mm);
    let touches = observed.touches.iter().zip(&fitted.overtravel_mm);
    let y: Vec<f64> = touches.filter(|(touch, _)| touch.feed_index == feed).map(|(_, mm)| um(*mm)).collect();
    EstimatedFunction {
        symbol: format!("E_F{}", observed.feeds_mm_min[feed]),
        argument: "touch".to_owned(),
        argument_unit: String::new(),
        x: (1..=y.len()).map(|number| number as f64).collect(),
        unit: Unit::Um,
        u: vec![um(fitted.scatter[feed].std_dev_mm); y.len()],
        y,
        figure: FigureKind::Curve,
        at_mm: None,
    }
}
