//! The estimate: parameters, figures and texts.

use super::axis_circle::add_axis_circle;
use super::axis_position::{add_axis_position, stated_and_measured};
use super::model::DRIFTING;
use super::outputs::{axis_position, dot};
use super::paper::PaperForm;
use super::parts::Parts;
use super::radial_check::RadialCheck;
use super::sense::Sense;
use super::settings::Spindle;
use crate::identification::probe_map::ProbeMap;
use crate::identification::{MisfitAdvice, unit_slope};
use machine::Axis;
use machine::record::estimate::{Estimate, Verdict};

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    causes: "dirt, a loose part or stylus, drift within a turn",
    declared_by: "repeatability_um",
};

pub fn estimate(parts: &Parts<'_>) -> Estimate {
    let mut estimate = parts.identification.estimate(super::NAME);
    add_axis_circle(parts, &mut estimate);
    add_axis_position(parts, &mut estimate);
    for parameter in &mut estimate.parameters {
        // With the wrong sense of the axis the values are not those of the stated parameters.
        parameter.identifiable = parts.sense != Sense::Contradicted;
    }
    estimate.gauge = gauge(parts, &estimate);
    estimate.not_identifiable = not_identifiable(parts);
    let radial = RadialCheck::new(parts);
    estimate.not_identifiable.extend(parts.identification.checked.limits());
    if radial.higher.as_ref().is_some_and(|higher| higher.above) {
        estimate.verdict = Verdict::UndecidedModel;
    }
    estimate.warnings = warnings(parts, &radial);
    estimate
}

fn gauge(parts: &Parts<'_>, estimate: &Estimate) -> Vec<String> {
    let axis = parts.axis.axis;
    let mut lines = parts.fit.layout.gauge_in_words(axis);
    lines.push(stated_and_measured(parts, estimate));
    lines.extend(known_motions(parts));
    let heights: Vec<String> = parts.heights.iter().map(|z| format!("{z:.3}")).collect();
    lines.push(match heights.len() {
        1 => format!("EX0{axis} and EY0{axis} hold at Z = {} mm only", heights[0]),
        _ => format!(
            "EX0{axis} and EY0{axis} hold at the mean of Z = {} mm; EA0{axis} and EB0{axis} are relative to the \
             Z axis",
            heights.join(", ")
        ),
    });
    if parts.fit.layout.drift_order > 0 {
        lines.push(format!(
            "drift of X, Y and radius fitted (order {}) and removed; values hold at the middle of \
             the cycle{}",
            parts.fit.layout.drift_order,
            if parts.plan.gaps_s.is_empty() { "" } else { ", interruptions left out" }
        ));
    }
    lines
}

/// Texts on the known error motions, and on the parameters that are conventional as a result.
fn known_motions(parts: &Parts<'_>) -> Vec<String> {
    let (axis, known) = (parts.axis.axis, parts.known);
    if known.is_empty() {
        return Vec::new();
    }
    let mut lines = known.in_words();
    lines.push(format!(
        "EX0{axis}, EY0{axis}, EX{axis} and EY{axis} are those of a machine without the error motions taken as \
         known; these have mean zero over a revolution (the mean is part of EX0{axis} and EY0{axis}), and their \
         co-rotating first harmonic has no effect: it goes with the part's set-up"
    ));
    if !known.has(Axis::A) || !known.has(Axis::B) {
        lines.push(format!(
            "without EA{axis} and EB{axis} the error motions taken as known are the same at each height"
        ));
    }
    lines
}

fn not_identifiable(parts: &Parts<'_>) -> Vec<String> {
    let axis = parts.axis.axis;
    let mut lines = vec![
        "common scale of X and Y: inseparable from the radius R".to_owned(),
        "machine origin: fixed by the gauge".to_owned(),
        "co-rotating first harmonic of the error motion: inseparable from the part's set-up"
            .to_owned(),
    ];
    let n = parts.fit.layout.design.n;
    lines.push(format!(
        "error motions of {axis} at orders {n}, {}, …{}: inseparable from EX0{axis} and EY0{axis} (multiples of \
         positions = {n})",
        2 * n,
        if parts.known.is_empty() { "" } else { " that the estimates taken as known do not have" }
    ));
    let map = ProbeMap::of(parts.plan).ok().flatten();
    let knows = |order: u32| map.as_ref().is_some_and(|map| map.knows(order));
    lines.push(
        match parts.settings.spindle {
            Spindle::Fixed if !knows(2) => {
                "two lobes of the probe, backlash of X and Y: inseparable from EYY1-EXX1 and EC0Y"
            }
            _ => "backlash of X and Y: inseparable from EYY1-EXX1 and EC0Y",
        }
        .to_owned(),
    );
    if parts.settings.spindle == Spindle::Fixed && !knows(1) {
        lines.push(format!(
            "stylus offset and odd lobes of the probe: inseparable from EX0{axis} and EY0{axis} with a fixed \
             spindle (they stand in the budget; spindle = \"follow\" removes them)"
        ));
    }
    if parts.fit.layout.heights == 1 {
        lines.push(format!("EA0{axis} and EB0{axis}: need two heights (heights_mm)"));
    }
    lines
}

fn warnings(parts: &Parts<'_>, radial: &RadialCheck) -> Vec<String> {
    let axis = parts.axis.axis;
    let mut lines = Vec::new();
    match parts.sense {
        Sense::Confirmed => {}
        Sense::NotConfirmed => lines.push(format!(
            "sense of {axis} not confirmed by these readings: an eccentric or lobed part and a number of \
             positions divisible by 4 show it best"
        )),
        Sense::Contradicted => lines.push(format!(
            "the readings contradict the stated sense of {axis}: check [axes.{axis}] positive"
        )),
    }
    lines.extend(parts.identification.misfit_warning(&MISFIT_ADVICE));
    lines.extend(parts.identification.checked.warnings.iter().cloned());
    lines.extend(radial.warnings(axis));
    if !parts.timed && parts.settings.drift_order > 0 {
        lines.push(
            "the readings carry no times: their order and the planned machine time served for the \
             drift"
                .to_owned(),
        );
    }
    lines.extend(steps(parts));
    lines.extend(parts.identification.trials_warning());
    lines.extend(paper_comparison(parts));
    lines
}

/// Texts on the steps of the machine in the interruptions, with U.
fn steps(parts: &Parts<'_>) -> Vec<String> {
    let layout = &parts.fit.layout;
    let um = |gap: usize, what: usize| {
        let at = layout.step(what, gap);
        let slope = unit_slope(at, layout.unknowns());
        let expanded = parts.identification.propagation.uncertainty(&slope).expanded();
        format!("{} {:+.2} ± {:.2}", DRIFTING[what], parts.fit.x[at] * 1e3, expanded * 1e3)
    };
    let mut lines: Vec<String> = (0..layout.gaps.len())
        .map(|gap| {
            let steps: Vec<String> = (0..DRIFTING.len()).map(|what| um(gap, what)).collect();
            format!("interrupted: a step was fitted and removed, {} µm", steps.join(", "))
        })
        .collect();
    if parts.left_out > 0 {
        lines.push(format!(
            "{} readings stand between interruptions without references and are left out",
            parts.left_out
        ));
    }
    lines
}

/// Result of the paper's own identification for the first pass, if it differs from the estimate by more than four
/// times u.
fn paper_comparison(parts: &Parts<'_>) -> Option<String> {
    let mut design = parts.fit.layout.design.clone();
    design.probes.truncate(2);
    let paper = PaperForm::new(&design).axis_position(&parts.fit.observations)?;
    let (x, y) = axis_position(&parts.fit.layout, 0);
    let own = [dot(&x, &parts.fit.x), dot(&y, &parts.fit.x)];
    let u = |i: usize| parts.identification.uncertainty(i).map_or(f64::NAN, |own| own.u);
    let is_far = (0..2).any(|i| (paper[i] - own[i]).abs() > 4.0 * u(i));
    let axis = parts.axis.axis;
    is_far.then(|| {
        format!(
            "the paper's form (differences, no drift, first order) gives EX0{axis} {:.2}, EY0{axis} {:.2} um",
            paper[0] * 1e3,
            paper[1] * 1e3
        )
    })
}
