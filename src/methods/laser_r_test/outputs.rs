//! Outputs of the method: reported quantities and figures.

use std::iter::{once, repeat};

use nalgebra::Vector3;

use super::centres::{BEAM, GAIN, sensor_gain};
use super::group::Group;
use super::label::in_words;
use super::latency::Latency;
use super::model::{Problem, placed};
use super::parts::Parts;
use super::words;
use crate::identification::{Output, Outputs, reported_unit};
use machine::record::estimate::{
    Arrow, ArrowFigure, Arrows, Estimate, FigureKind, Function, Unit, VectorKind,
};
use machine::{Axis, Position};

/// Outputs of the beam: tilt from its nominal direction along two perpendicular directions (X and Y for a beam that
/// points down), and deviation of the sensor's scale from 1.
const BEAM_NAMES: [&str; BEAM] = ["beam_x", "beam_y", "gain"];
const BEAM_UNITS: [Unit; BEAM] = [Unit::Urad, Unit::Urad, Unit::UmPerM];

pub fn estimate(parts: &Parts<'_>) -> Estimate {
    let misses = misses(&parts.problem, &parts.grouped.groups, &parts.minimum.x);
    Estimate {
        functions: functions(parts),
        arrows: vec![deviations(parts, &misses), residuals(parts, &misses)],
        gauge: words::gauge(parts),
        not_identifiable: words::not_identifiable(parts),
        warnings: words::warnings(parts),
        ..parts.identified.estimate(super::NAME)
    }
}

/// Outputs for the unknowns `x`: machine, zero point and sphere (with `names`), then the beam, then the latency.
pub fn outputs(
    problem: &Problem,
    names: &[String],
    latency: Option<&Latency>,
    x: &[f64],
) -> Outputs {
    let latency = latency.map_or_else(Vec::new, Latency::names);
    let beam = x.len() - names.len() - latency.len();
    let errors = problem.model.parameters.iter().map(reported_unit);
    let own = names.iter().cloned().zip(errors.chain(repeat(Unit::Mm)));
    let of_beam = BEAM_NAMES.map(str::to_owned).into_iter().zip(BEAM_UNITS).take(beam);
    let latency = latency.into_iter().zip(once(Unit::Ms).chain(repeat(Unit::Um)));
    let all = own.chain(of_beam).chain(latency).enumerate();
    let parameters = all.map(|(i, (name, unit))| Output::unknown(&name, unit, i, x));
    let mut parameters: Vec<Output> = parameters.collect();
    if beam > GAIN {
        let gain = &mut parameters[names.len() + GAIN];
        gain.value = sensor_gain(gain.value);
        gain.slope.iter_mut().flatten().for_each(|slope| *slope = -*slope);
    }
    Outputs { parameters, ..Outputs::default() }
}

/// Position of the sphere by the machine with the errors in `x`, less its estimated position: machine frame, mm.
pub fn misses(problem: &Problem, groups: &[Group], x: &[f64]) -> Vec<Vector3<f64>> {
    let sights = problem.sights.iter().zip(groups);
    sights.map(|(sight, group)| group.table * problem.model.misclosure(&sight.at, x)).collect()
}

/// Measured less commanded position of the sphere at each pose, machine frame (paper 2, Fig. 9). The commanded
/// position follows from the positions of sphere and zero point on a machine without errors.
fn deviations(parts: &Parts<'_>, misses: &[Vector3<f64>]) -> ArrowFigure {
    let mut without = parts.minimum.x.clone();
    let errors = parts.problem.model.parameters.len();
    without.iter_mut().take(errors).for_each(|error| *error = 0.0);
    let all = self::misses(&parts.problem, &parts.grouped.groups, &without);
    let modelled: Vec<Vector3<f64>> =
        all.iter().zip(misses).map(|(all, miss)| all - miss).collect();
    let figure = figure(parts, "measured less commanded sphere", &all, Some(&modelled));
    ArrowFigure { figure: VectorKind::Paths, ..figure }
}

fn residuals(parts: &Parts<'_>, misses: &[Vector3<f64>]) -> ArrowFigure {
    figure(parts, "residuals", misses, None)
}

/// Figure with one group of arrows for each position of the tilting axis, ordered by the angle of the turning axis.
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

/// Indices of the poses, ordered by the angle of the axis that turns the table.
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

/// Form error of each scan in the order of the poses, and deviations of the points of all scans from their spheres.
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
        at_mm: None,
    };
    let points = parts.grouped.centres.off(&parts.fitted.x);
    vec![
        of("form", "pose", parts.forms(), FigureKind::Points),
        of("deviation", "point", points, FigureKind::Histogram),
    ]
}
