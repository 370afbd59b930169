//! The estimate in the words and units of the contract.

use super::fit::{Fitted, Scatter};
use super::observe::Observed;
use super::scan::{Latch, Scan, Time};
use super::words;
use estimation::coverage::{self, coverage_factor};
use machine::record::estimate::{
    BudgetLine, Covariance, ESTIMATE_VERSION, Estimate, FigureKind, Function, Parameter, Unit,
    Verdict,
};
use machine::record::plan::Plan;

/// How late a contact is latched.
pub const DELAY: &str = "t_latch";
/// What that makes of a touch at the measuring feed: so much farther along the touch.
pub const OVERTRAVEL: &str = "E_latch";
/// The scan of whatever looks at the probe.
pub const SCAN: &str = "T_scan";

pub fn estimate(plan: &Plan, observed: &Observed, fitted: &Fitted, scan: &Scan) -> Estimate {
    let residuals = &fitted.solution.residuals;
    let squares: f64 = residuals.iter().map(|r| r * r).sum();
    let declared_mm = declared_mm(plan, observed);
    let dof = fitted.solution.dof;
    let chi2_per_dof = declared_mm.map_or(1.0, |mm| squares / (mm * mm) / dof as f64);
    Estimate {
        trued_estimate: ESTIMATE_VERSION,
        method: super::NAME.to_owned(),
        parameters: parameters(observed, fitted, scan),
        functions: functions(observed, fitted),
        circles: Vec::new(),
        arrows: Vec::new(),
        covariance: covariance(observed, fitted),
        rank: fitted.solution.rank,
        unknowns: fitted.solution.x.len(),
        condition: fitted.solution.condition,
        weakest: None,
        gauge: words::conventions(observed, fitted),
        not_identifiable: words::cannot_know(observed, fitted, scan),
        residual_rms_um: (squares / residuals.len().max(1) as f64).sqrt() * 1e3,
        degrees_of_freedom: dof,
        chi2_per_dof,
        verdict: Verdict::None,
        warnings: words::warnings(observed, fitted, scan, declared_mm),
        priors: Vec::new(),
    }
}

/// Declared scatter of a touch, the display's steps with it, mm.
pub fn declared_mm(plan: &Plan, observed: &Observed) -> Option<f64> {
    let declared = plan.probe.repeatability_um?;
    Some((declared * 1e-3).hypot(observed.resolution_mm / 12f64.sqrt()))
}

/// The symbol of the scatter at a feed.
fn scatter_symbol(feed_mm_min: f64) -> String {
    format!("s_{feed_mm_min}")
}

fn parameters(observed: &Observed, fitted: &Fitted, scan: &Scan) -> Vec<Parameter> {
    let [slow, _] = observed.speeds();
    let delay = (fitted.delay_s, fitted.u_s(), fitted.dof());
    let overtravel = (slow * delay.0, slow * delay.1, delay.2);
    let budget = |unit: Unit, scale: f64| -> Vec<BudgetLine> {
        let [low, high] = observed.feeds_mm_min;
        let names = [
            format!("scatter at {low} mm/min"),
            format!("scatter at {high} mm/min"),
            "resolution".to_owned(),
        ];
        let lines = names.into_iter().zip(fitted.sources);
        lines
            .map(|(source, (variance, _))| BudgetLine {
                source,
                u: unit.from_internal(scale * variance.sqrt()),
            })
            .collect()
    };
    let of_scatter = |(feed, scatter): (f64, Scatter)| {
        // GUM E.4.3.
        let u = scatter.s_mm / (2.0 * scatter.dof).sqrt();
        parameter(&scatter_symbol(feed), Unit::Um, (scatter.s_mm, u, scatter.dof))
    };
    let mut list = vec![
        Parameter { budget: budget(Unit::Ms, 1.0), ..parameter(DELAY, Unit::Ms, delay) },
        Parameter { budget: budget(Unit::Um, slow), ..parameter(OVERTRAVEL, Unit::Um, overtravel) },
        scan_parameter(scan),
    ];
    list.extend(observed.feeds_mm_min.into_iter().zip(fitted.scatter).map(of_scatter));
    list
}

/// Where none is seen: nothing, within the longest that could hide.
fn scan_parameter(scan: &Scan) -> Parameter {
    match scan.latch {
        Latch::Scan(Time { t_s, u_s, dof }) => parameter(SCAN, Unit::Ms, (t_s, u_s, dof)),
        Latch::Control { longest_s } => unseen(longest_s),
        Latch::Unsteady(Time { t_s, .. }) => unseen(t_s),
    }
}

fn unseen(longest_s: f64) -> Parameter {
    let k = coverage_factor(f64::INFINITY);
    let none = parameter(SCAN, Unit::Ms, (0.0, longest_s / k, f64::INFINITY));
    Parameter { identifiable: false, ..none }
}

/// Value, standard uncertainty (internal units) and degrees of freedom.
fn parameter(symbol: &str, unit: Unit, (value, u, dof): (f64, f64, f64)) -> Parameter {
    let k = coverage::coverage_factor(dof);
    Parameter {
        symbol: symbol.to_owned(),
        value: unit.from_internal(value),
        unit,
        u: unit.from_internal(u),
        expanded: unit.from_internal(k * u),
        k,
        dof: Some(dof).filter(|dof| dof.is_finite()),
        identifiable: true,
        u_monte_carlo: None,
        budget: Vec::new(),
    }
}

/// Both are one number in two units.
fn covariance(observed: &Observed, fitted: &Fitted) -> Covariance {
    let u = [
        Unit::Ms.from_internal(fitted.u_s()),
        Unit::Um.from_internal(observed.speeds()[0] * fitted.u_s()),
    ];
    Covariance {
        symbols: [DELAY, OVERTRAVEL].map(str::to_owned).to_vec(),
        rows: u.iter().map(|one| u.iter().map(|other| one * other).collect()).collect(),
    }
}

/// The line over the feed, and the touches at each feed in their order.
fn functions(observed: &Observed, fitted: &Fitted) -> Vec<Function> {
    let um = |mm: f64| Unit::Um.from_internal(mm);
    let [slow, fast] = observed.speeds();
    let line = [0.0, slow, fast];
    let over_feed = Function {
        symbol: OVERTRAVEL.to_owned(),
        argument: "F".to_owned(),
        argument_unit: "mm/min".to_owned(),
        x: line.map(|speed| speed * 60.0).to_vec(),
        unit: Unit::Um,
        y: line.map(|speed| um(speed * fitted.delay_s)).to_vec(),
        u: line.map(|speed| um(speed * fitted.u_s())).to_vec(),
        figure: FigureKind::Curve,
    };
    let of_feed = |feed: usize| {
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
        }
    };
    vec![over_feed, of_feed(0), of_feed(1)]
}
