//! The estimate: parameters, figures and texts.

use super::axis_circle::add_axis_circle;
use super::axis_position::{add_axis_position, describe_axis_position};
use super::identify::SolvedRun;
use super::model::DRIFTING_QUANTITIES;
use super::outputs::axis_position_coefficients;
use super::paper_system::PaperSystem;
use super::radial_error_check::RadialErrorCheck;
use super::rotation_sense::RotationSenseCheck;
use super::settings::SpindleMode;
use crate::identification::probe_map::ProbeMap;
use crate::identification::{MisfitAdvice, dot_product, slope_of_unknown};
use machine::Axis;
use machine::record::estimate::{Estimate, Verdict};

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    possible_causes: "dirt, a loose part or stylus, drift within a revolution",
    declaring_settings: "repeatability_um",
};

pub fn build_estimate(parts: &SolvedRun<'_>) -> Estimate {
    let mut estimate = parts.identification.estimate(super::METHOD_NAME);
    add_axis_circle(parts, &mut estimate);
    add_axis_position(parts, &mut estimate);
    for parameter in &mut estimate.parameters {
        // With the wrong sense of the axis the values are not those of the stated parameters.
        parameter.identifiable = parts.rotation_sense_check != RotationSenseCheck::Contradicted;
    }
    estimate.location_at_mm = location_point_mm(parts);
    estimate.gauge = describe_gauge(parts, &estimate);
    estimate.not_identifiable = describe_not_identifiable(parts);
    let radial = RadialErrorCheck::new(parts);
    estimate.not_identifiable.extend(parts.identification.outlier_check.describe_detection_limits());
    if radial.higher_harmonics.as_ref().is_some_and(|higher| higher.is_excessive) {
        estimate.verdict = Verdict::UndecidedModel;
    }
    estimate.warnings = collect_warnings(parts, &radial);
    estimate
}

/// The stated axis at the mean height. `None`: another axis was not at zero.
fn location_point_mm(parts: &SolvedRun<'_>) -> Option<[f64; 3]> {
    let axis = &parts.setup.axis;
    let mean_mm =
        parts.setup.heights_in_machine_mm.iter().sum::<f64>() / parts.setup.heights_in_machine_mm.len() as f64;
    axis.describe_other_nonzero_axes().is_empty().then(|| axis.axis_point_at_height(mean_mm).into())
}

fn describe_gauge(parts: &SolvedRun<'_>, estimate: &Estimate) -> Vec<String> {
    let axis = parts.setup.axis.axis;
    let mut lines = parts.fit.layout.describe_gauge(axis);
    lines.push(describe_axis_position(parts, estimate));
    lines.extend(describe_known_motions(parts));
    let heights: Vec<String> = parts.setup.heights_in_machine_mm.iter().map(|z| format!("{z:.3}")).collect();
    lines.push(match heights.len() {
        1 => format!("EX0{axis} and EY0{axis} are valid at Z = {} mm only", heights[0]),
        _ => format!(
            "EX0{axis} and EY0{axis} are valid at the mean of Z = {} mm; EA0{axis} and EB0{axis} are \
            relative to the Z axis",
            heights.join(", ")
        ),
    });
    if parts.fit.layout.drift_order > 0 {
        lines.push(format!(
            "drift of X, Y and radius fitted (order {}) and removed; values are valid at the middle of the \
            cycle{}",
            parts.fit.layout.drift_order,
            if parts.setup.plan.interruption_times_s.is_empty() { "" } else { ", without the interruptions" }
        ));
    }
    lines
}

/// Texts on the known error motions, and on the parameters that depend on a convention because of them.
fn describe_known_motions(parts: &SolvedRun<'_>) -> Vec<String> {
    let (axis, known_motions) = (parts.setup.axis.axis, &parts.setup.known_motions);
    if known_motions.is_empty() {
        return Vec::new();
    }
    let mut lines = known_motions.describe();
    lines.push(format!(
        "EX0{axis}, EY0{axis}, EX{axis} and EY{axis} do not include the known error motions. The known \
        error motions have mean zero over a revolution (the mean is part of EX0{axis} and EY0{axis}); their \
        co-rotating first harmonic has no effect, because it is inseparable from the part's set-up"
    ));
    if !known_motions.has_component(Axis::A) || !known_motions.has_component(Axis::B) {
        lines.push(format!(
            "EA{axis} and EB{axis} are not known: the known error motions count as equal at all heights"
        ));
    }
    lines
}

fn describe_not_identifiable(parts: &SolvedRun<'_>) -> Vec<String> {
    let axis = parts.setup.axis.axis;
    let mut lines = vec![
        "common scale of X and Y: inseparable from the radius R".to_owned(),
        "machine origin: fixed by the gauge".to_owned(),
        "co-rotating first harmonic of the error motion: inseparable from the part's set-up".to_owned(),
    ];
    let n = parts.fit.layout.design.angle_count;
    lines.push(format!(
        "error motions of {axis} at orders {n}, {}, …{}: inseparable from EX0{axis} and EY0{axis} (multiples of \
         positions = {n})",
        2 * n,
        if parts.setup.known_motions.is_empty() { "" } else { ", as far as not known from the given estimates" }
    ));
    let map = ProbeMap::from_plan(parts.setup.plan).ok().flatten();
    let knows = |order: u32| map.as_ref().is_some_and(|map| map.subtracts_order(order));
    lines.push(
        match parts.setup.settings.spindle {
            SpindleMode::Fixed if !knows(2) => {
                "two lobes of the probe, backlash of X and Y: inseparable from EYY1-EXX1 and EC0Y"
            }
            _ => "backlash of X and Y: inseparable from EYY1-EXX1 and EC0Y",
        }
        .to_owned(),
    );
    if parts.setup.settings.spindle == SpindleMode::Fixed && !knows(1) {
        lines.push(format!(
            "stylus offset and odd lobes of the probe: inseparable from EX0{axis} and EY0{axis} with a \
            fixed spindle (included in the budget; spindle = \"follow\" removes the effect)"
        ));
    }
    if parts.fit.layout.height_count == 1 {
        lines.push(format!("EA0{axis} and EB0{axis}: two heights are required (heights_mm)"));
    }
    lines
}

fn collect_warnings(parts: &SolvedRun<'_>, radial: &RadialErrorCheck) -> Vec<String> {
    let axis = parts.setup.axis.axis;
    let mut lines = Vec::new();
    match parts.rotation_sense_check {
        RotationSenseCheck::Confirmed => {}
        RotationSenseCheck::NotConfirmed => lines.push(format!(
            "the readings do not confirm the sense of {axis}: use an eccentric or lobed part, and a number \
            of positions divisible by 4"
        )),
        RotationSenseCheck::Contradicted => {
            lines.push(format!("the readings contradict the stated sense of {axis}: check [axes.{axis}] positive"))
        }
    }
    lines.extend(parts.identification.misfit_warning(&MISFIT_ADVICE));
    lines.extend(parts.identification.outlier_check.warnings.iter().cloned());
    lines.extend(radial.warnings(axis));
    if !parts.has_times && parts.setup.settings.drift_order > 0 {
        lines.push(
            "the readings have no times: the drift was fitted over their order and the planned machine time".to_owned(),
        );
    }
    lines.extend(describe_interruption_steps(parts));
    lines.extend(parts.identification.trial_contradiction_warning());
    lines.extend(describe_paper_solution_difference(parts));
    lines
}

/// Texts on the steps that are fitted at the interruptions, with U.
fn describe_interruption_steps(parts: &SolvedRun<'_>) -> Vec<String> {
    let layout = &parts.fit.layout;
    let um = |gap: usize, quantity: usize| {
        let at = layout.interruption_step_index(quantity, gap);
        let slope = slope_of_unknown(at, layout.unknown_count());
        let expanded = parts.identification.propagation.output_uncertainty(&slope).expanded();
        format!("{} {:+.2} ± {:.2}", DRIFTING_QUANTITIES[quantity], parts.fit.x[at] * 1e3, expanded * 1e3)
    };
    let mut lines: Vec<String> = (0..layout.interruption_times.len())
        .map(|gap| {
            let steps: Vec<String> = (0..DRIFTING_QUANTITIES.len()).map(|quantity| um(gap, quantity)).collect();
            format!("interruption: a step was fitted and removed, {} µm", steps.join(", "))
        })
        .collect();
    if parts.short_segment_reading_count > 0 {
        lines.push(format!(
            "{} readings were not used: fewer than three directions were touched between their interruptions",
            parts.short_segment_reading_count
        ));
    }
    lines
}

/// Result of the paper's own identification for the first pass, if it differs from the estimate by more than four
/// times u.
fn describe_paper_solution_difference(parts: &SolvedRun<'_>) -> Option<String> {
    let mut design = parts.fit.layout.design.clone();
    design.probe_angle_indices.truncate(2);
    let paper = PaperSystem::new(&design).axis_position(&parts.fit.observations)?;
    let (x, y) = axis_position_coefficients(&parts.fit.layout, 0);
    let own = [dot_product(&x, &parts.fit.x), dot_product(&y, &parts.fit.x)];
    let u = |i: usize| parts.identification.parameter_uncertainty(i).map_or(f64::NAN, |own| own.u);
    let is_far = (0..2).any(|i| (paper[i] - own[i]).abs() > 4.0 * u(i));
    let axis = parts.setup.axis.axis;
    is_far.then(|| {
        format!(
            "the paper's own identification (differences, no drift, first order) gives EX0{axis} = {:.2} µm and \
             EY0{axis} = {:.2} µm",
            paper[0] * 1e3,
            paper[1] * 1e3
        )
    })
}
