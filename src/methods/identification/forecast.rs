//! Expected uncertainty of a plan, from the estimate of nominal readings.

use super::declared_sources::repeatability_mm;
use machine::record::estimate::{Estimate, Parameter};
use machine::record::machine::Probe;
use machine::record::plan::Plan;

/// The plan with a declared repeatability, because the residuals of nominal readings show no scatter.
pub fn plan_with_assumed_repeatability(plan: &Plan) -> Plan {
    let repeatability_um = Some(repeatability_mm(plan) * 1e3);
    Plan { probe: Probe { repeatability_um, ..plan.probe.clone() }, ..plan.clone() }
}

/// A sentence that the repeatability is assumed, if `plan` does not declare it.
pub fn describe_assumed_repeatability(plan: &Plan) -> Option<String> {
    let assumed_um = repeatability_mm(plan) * 1e3;
    plan.probe.repeatability_um.is_none().then(|| {
        format!(
            "assumed for the expected U: repeatability of a touch {assumed_um} µm; set repeatability_um in \
            [probe]"
        )
    })
}

/// Expanded uncertainty U of the parameters that are `of_interest`, as text.
pub fn describe_expected_uncertainty(estimate: &Estimate, of_interest: impl Fn(&Parameter) -> bool) -> Option<String> {
    let list = estimate.parameters.iter().filter(|parameter| of_interest(parameter));
    let list = list.map(|p| format!("{} {:.1} {}", p.symbol, p.expanded, p.unit.symbol()));
    let list: Vec<String> = list.collect();
    (!list.is_empty()).then(|| format!("expected U: {}", list.join(", ")))
}
