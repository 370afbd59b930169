//! The estimate in the words and units of the contract.

use nalgebra::Vector3;

use super::centres::sensor_gain;
use super::label::in_words;
use super::model::placed;
use super::parts::Parts;
use super::words;
use estimation::coverage;
use machine::kinematics::{ErrorParameter, Shape};
use machine::record::estimate::{
    Arrow, ArrowFigure, Arrows, BudgetLine, Covariance, ESTIMATE_VERSION, Estimate, FigureKind,
    Function, Parameter, Unit, VectorKind, Verdict,
};
use machine::{Axis, Position};

/// Index of the gain among the beam's unknowns.
const GAIN: usize = 2;

pub fn estimate(parts: &Parts<'_>) -> Estimate {
    let misses = misses(parts, &parts.minimum.x);
    let square: f64 = misses.iter().map(|miss| miss.norm_squared()).sum();
    let own = parts.minimum.x.len();
    let count = own + parts.grouped.centres.common() + parts.clocks().0.len();
    let dof = parts.minimum.residuals.len().saturating_sub(own);
    Estimate {
        trued_estimate: ESTIMATE_VERSION,
        method: super::NAME.to_owned(),
        parameters: (0..count).map(|i| parameter(parts, i)).collect(),
        functions: functions(parts),
        circles: Vec::new(),
        arrows: vec![deviations(parts, &misses), residuals(parts, &misses)],
        covariance: covariance(parts, count),
        rank: parts.survey.rank,
        unknowns: own,
        condition: parts.survey.condition,
        weakest: None,
        gauge: words::gauge(parts),
        not_identifiable: words::not_identifiable(parts),
        residual_rms_um: (square / (3 * misses.len()).max(1) as f64).sqrt() * 1e3,
        degrees_of_freedom: dof,
        chi2_per_dof: if dof > 0 { parts.misfit.chi2 / parts.misfit.expected } else { 0.0 },
        verdict: Verdict::None,
        warnings: words::warnings(parts),
        priors: Vec::new(),
    }
}

fn unit(parts: &Parts<'_>, i: usize) -> Unit {
    let own = parts.names.len();
    let of_machine = |p: &ErrorParameter| match (p.shape(), p.component().is_linear()) {
        (Shape::Gain, _) => Unit::UmPerM,
        (_, true) => Unit::Um,
        (_, false) => Unit::Urad,
    };
    match parts.clock(i) {
        Some(0) => return Unit::Ms,
        Some(_) => return Unit::Um,
        None => {}
    }
    match i.checked_sub(own) {
        Some(GAIN) => Unit::UmPerM,
        Some(_) => Unit::Urad,
        None => parts.problem.model.parameters.get(i).map_or(Unit::Mm, of_machine),
    }
}

fn value(parts: &Parts<'_>, i: usize) -> f64 {
    if let Some(k) = parts.clock(i) {
        return parts.clocks().1.get(k).copied().unwrap_or_default();
    }
    let of_beam = |k: Option<usize>| k.and_then(|k| parts.fitted.x.get(k)).copied();
    let own = i.checked_sub(parts.names.len());
    let beam = of_beam(own).unwrap_or_default();
    let beam = if own == Some(GAIN) { sensor_gain(beam) } else { beam };
    parts.minimum.x.get(i).copied().unwrap_or(beam)
}

fn parameter(parts: &Parts<'_>, i: usize) -> Parameter {
    let unit = unit(parts, i);
    let dof = parts.propagated.dof(i, &parts.misfit);
    let (k, u) = (coverage::coverage_factor(dof.unwrap_or(f64::INFINITY)), parts.propagated.u(i));
    let budget = parts.propagated.budget.iter().map(|(source, u)| BudgetLine {
        source: (*source).to_owned(),
        u: unit.from_internal(u[i]),
    });
    let by_trials = parts.monte_carlo.standard_deviation.get(i);
    Parameter {
        symbol: parts.symbol(i),
        value: unit.from_internal(value(parts, i)),
        unit,
        u: unit.from_internal(u),
        expanded: unit.from_internal(k * u),
        k,
        dof,
        identifiable: true,
        u_monte_carlo: by_trials.map(|u| unit.from_internal(*u)),
        budget: budget.collect(),
    }
}

fn covariance(parts: &Parts<'_>, count: usize) -> Covariance {
    let sign = |i: usize| if i == parts.names.len() + GAIN { -1.0 } else { 1.0 };
    let factor: Vec<f64> =
        (0..count).map(|i| sign(i) * unit(parts, i).from_internal(1.0)).collect();
    let full = &parts.propagated.covariance;
    let row = |i: usize| (0..count).map(|j| full[(i, j)] * factor[i] * factor[j]).collect();
    Covariance {
        symbols: (0..count).map(|i| parts.symbol(i)).collect(),
        rows: (0..count).map(row).collect(),
    }
}

/// Where the machine with the errors in `x` sees the sphere, less where it is; machine frame, mm.
fn misses(parts: &Parts<'_>, x: &[f64]) -> Vec<Vector3<f64>> {
    let sights = parts.problem.sights.iter().zip(&parts.into_table);
    sights
        .map(|(sight, into)| into.inverse() * parts.problem.model.misclosure(&sight.at, x))
        .collect()
}

/// Measured less commanded place of the sphere at each pose, in the machine frame (paper 2, Fig. 9): the
/// commanded one follows from where the sphere and the zero point are, by a machine without errors.
fn deviations(parts: &Parts<'_>, misses: &[Vector3<f64>]) -> ArrowFigure {
    let mut without = parts.minimum.x.clone();
    let errors = parts.problem.model.parameters.len();
    without.iter_mut().take(errors).for_each(|error| *error = 0.0);
    let all = self::misses(parts, &without);
    let modelled: Vec<Vector3<f64>> =
        all.iter().zip(misses).map(|(all, miss)| all - miss).collect();
    let figure = figure(parts, "measured less commanded sphere", &all, Some(&modelled));
    ArrowFigure { figure: VectorKind::Paths, ..figure }
}

fn residuals(parts: &Parts<'_>, misses: &[Vector3<f64>]) -> ArrowFigure {
    figure(parts, "residuals", misses, None)
}

/// One group for each position of the tilting axis, in it one arrow after the other as the table turns.
fn figure(
    parts: &Parts<'_>,
    symbol: &str,
    vectors: &[Vector3<f64>],
    modelled: Option<&[Vector3<f64>]>,
) -> ArrowFigure {
    let chain = &parts.bench.chain;
    let tilting = |axis: Axis| super::parameters::tilts(chain, axis) && axis != Axis::S;
    let ball = parts.problem.model.ball(&parts.minimum.x);
    let mut groups: Vec<(Position, Arrows)> = Vec::new();
    for i in in_turn(parts, tilting) {
        let (Some(group), Some(vector)) = (parts.grouped.groups.get(i), vectors.get(i)) else {
            continue;
        };
        let tilted = group.rotary.only(tilting);
        let table = chain.machine_from_table(&placed(&group.rotary, Vector3::zeros()), &[]);
        let arrow = Arrow {
            label: in_words(&group.rotary.only(|axis| !tilting(axis))),
            at_mm: table.transform_point(&ball.into()).coords.into(),
            vector: (*vector * 1e3).into(),
            modelled: modelled.and_then(|all| all.get(i)).map(|one| (*one * 1e3).into()),
            flagged: false,
        };
        match groups.iter_mut().find(|(at, _)| *at == tilted) {
            Some((_, arrows)) => arrows.arrows.push(arrow),
            None => {
                let arrows = Arrows { name: in_words(&tilted), arrows: vec![arrow] };
                groups.push((tilted, arrows));
            }
        }
    }
    groups.sort_by(|(one, _), (other, _)| {
        let at = |p: &Position| p.iter().next().map_or(0.0, |(_, value)| value);
        at(one).total_cmp(&at(other))
    });
    let groups = groups.into_iter().map(|(_, arrows)| arrows).collect();
    ArrowFigure { symbol: symbol.to_owned(), unit: Unit::Um, groups, figure: VectorKind::Arrows }
}

/// The poses in the order of what turns the table.
fn in_turn(parts: &Parts<'_>, tilting: impl Fn(Axis) -> bool) -> Vec<usize> {
    let turned = |i: &usize| {
        let group = parts.grouped.groups.get(*i);
        let turning = group.and_then(|group| group.rotary.iter().find(|(axis, _)| !tilting(*axis)));
        turning.map_or(0.0, |(_, angle)| angle)
    };
    let mut order: Vec<usize> = (0..parts.grouped.groups.len()).collect();
    order.sort_by(|one, other| turned(one).total_cmp(&turned(other)));
    order
}

/// The form of each scan, in the order of the poses, and how the points of all scans scatter about
/// their spheres.
fn functions(parts: &Parts<'_>) -> Vec<Function> {
    let of = |symbol: &str, argument: &str, mm: Vec<f64>, figure| Function {
        symbol: symbol.to_owned(),
        argument: argument.to_owned(),
        argument_unit: String::new(),
        x: (1..=mm.len()).map(|number| number as f64).collect(),
        unit: Unit::Um,
        u: vec![0.0; mm.len()],
        y: mm.into_iter().map(|mm| Unit::Um.from_internal(mm)).collect(),
        figure,
    };
    let points = parts.grouped.centres.off(&parts.fitted.x);
    vec![
        of("form", "pose", parts.forms(), FigureKind::Points),
        of("deviation", "point", points, FigureKind::Histogram),
    ]
}
