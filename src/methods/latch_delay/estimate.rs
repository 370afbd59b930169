//! The estimate in the terms and units of the Estimate JSON.

use super::fit::{Fitted, Scatter};
use super::observe::Observed;
use super::scan::{Latch, Scan, Time};
use super::words;
use crate::identification::reported_parameter;
use estimation::coverage::coverage_factor;
use machine::record::estimate::{Estimate, FigureKind, Function, Parameter, Unit};
use machine::record::plan::Plan;

/// Symbol of the scan time between contact and latch.
const SCAN: &str = "T_scan";

pub fn estimate(plan: &Plan, observed: &Observed, fitted: &Fitted, scan: &Scan) -> Estimate {
    let declared_mm = declared_mm(plan, observed);
    let mut estimate = fitted.identified.estimate(super::NAME);
    estimate.parameters.push(scan_parameter(scan));
    let scatter = observed.feeds_mm_min.into_iter().zip(fitted.scatter);
    estimate.parameters.extend(scatter.map(|(feed, scatter)| scatter_parameter(feed, scatter)));
    estimate.functions.extend([0, 1].map(|feed| touches(observed, fitted, feed)));
    let figures = &fitted.identified.figures;
    let chi2 = |mm: f64| observed.touches.len() as f64 * (figures.residual_rms_mm / mm).powi(2);
    Estimate {
        gauge: words::conventions(observed, fitted),
        not_identifiable: words::cannot_know(observed, fitted, scan),
        // χ² relative to the declared scatter, as the weights follow from the residuals.
        chi2_per_dof: declared_mm.map_or(1.0, |mm| chi2(mm) / figures.dof as f64),
        warnings: words::warnings(observed, fitted, scan, declared_mm),
        ..estimate
    }
}

/// Declared scatter of a touch including the display resolution, mm.
pub fn declared_mm(plan: &Plan, observed: &Observed) -> Option<f64> {
    let declared = plan.probe.repeatability_um?;
    Some((declared * 1e-3).hypot(observed.resolution_mm / 12f64.sqrt()))
}

fn scatter_parameter(feed_mm_min: f64, Scatter { s_mm, dof }: Scatter) -> Parameter {
    // Standard uncertainty of a standard deviation: GUM E.4.3.
    let u_mm = s_mm / (2.0 * dof).sqrt();
    reported_parameter(&format!("s_{feed_mm_min}"), Unit::Um, s_mm, u_mm, Some(dof))
}

/// Parameter of the scan time. If no scan is detected, its value is 0 with the longest undetectable scan as its
/// bound.
fn scan_parameter(scan: &Scan) -> Parameter {
    let longest_s = match scan.latch {
        Latch::Scan(Time { t_s, u_s, dof }) => {
            let dof = Some(dof).filter(|dof| dof.is_finite());
            return reported_parameter(SCAN, Unit::Ms, t_s, u_s, dof);
        }
        Latch::Control { longest_s } => longest_s,
        Latch::Unsteady(Time { t_s, .. }) => t_s,
    };
    let u_s = longest_s / coverage_factor(f64::INFINITY);
    let mut unseen = reported_parameter(SCAN, Unit::Ms, 0.0, u_s, None);
    unseen.identifiable = false;
    unseen
}

/// The touches at one feed in their order.
fn touches(observed: &Observed, fitted: &Fitted, feed: usize) -> Function {
    let um = |mm: f64| Unit::Um.from_internal(mm);
    let touches = observed.touches.iter().zip(&fitted.late_mm);
    let y: Vec<f64> =
        touches.filter(|(touch, _)| touch.feed == feed).map(|(_, mm)| um(*mm)).collect();
    Function {
        symbol: format!("E_F{}", observed.feeds_mm_min[feed]),
        argument: "touch".to_owned(),
        argument_unit: String::new(),
        x: (1..=y.len()).map(|number| number as f64).collect(),
        unit: Unit::Um,
        u: vec![um(fitted.scatter[feed].s_mm); y.len()],
        y,
        figure: FigureKind::Curve,
        at_mm: None,
    }
}
