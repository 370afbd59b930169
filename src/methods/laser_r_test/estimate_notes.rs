//! Warnings and notes of the estimate.

use super::centre_equations::BEAM_DISTANCE_PER_READING_INDEX;
use super::observe::ObservedScans;
use super::paper_estimator;
use super::result::IdentificationResult;
use super::scan_purpose::ScanPurpose;
use crate::identification::{LOCATION_ERRORS_TEXT, MisfitAdvice, describe_aliased_orders};
use machine::Axis;
use machine::kinematics::ErrorShape;
use machine::record::estimate::Unit;

/// Deviation of the gain from 1 above which it is reported, if it is also significant.
const MIN_REPORTED_GAIN_DEVIATION: f64 = 1e-3;
/// Deviation of the gain from 1, in standard uncertainties, above which it is significant.
const MIN_REPORTED_GAIN_SIGMAS: f64 = 4.0;

pub fn estimate_warnings(result: &IdentificationResult<'_>) -> Vec<String> {
    let is_not_search = |line: &&String| ScanPurpose::from_step_label(line) != Some(ScanPurpose::Search);
    let skipped = result.observed.skipped_scans.iter().filter(is_not_search);
    let mut lines: Vec<String> = skipped.map(|line| format!("not used: {line}")).collect();
    lines.extend(result.observed.describe_excluded_samples());
    // With too few samples of a motion, forward and backward have unequal weight.
    lines.extend(result.observed.sparse_motions.iter().filter(is_not_search).cloned());
    lines.extend(misfit_warning(result));
    lines.extend(result.identification.outlier_check.warnings.iter().cloned());
    lines.extend(gain_warning(result));
    lines.extend(form_warning(result));
    lines.extend(noise_warning(result));
    lines.extend(result.identification.trial_contradiction_warning());
    lines
}

fn misfit_warning(result: &IdentificationResult<'_>) -> Option<String> {
    let declaring_settings = match result.setup.uses_touch_probe() {
        true => "repeatability_um or error_motion_um",
        false => "noise_um or error_motion_um",
    };
    let causes = "error motions (harmonics = [2]), squareness of X, Y and Z, drift or a loose sphere";
    result.identification.misfit_warning(&MisfitAdvice { possible_causes: causes, declaring_settings })
}

fn gain_warning(result: &IdentificationResult<'_>) -> Option<String> {
    if result.setup.uses_touch_probe() {
        return None;
    }
    let index = result.unknown_names.len() + BEAM_DISTANCE_PER_READING_INDEX;
    let gain = result.identification.outputs.linear_parameters.get(index)?.value;
    let u = result.identification.parameter_uncertainty(index)?.u;
    (gain.abs() > MIN_REPORTED_GAIN_SIGMAS * u && gain.abs() > MIN_REPORTED_GAIN_DEVIATION).then(|| {
        format!(
            "the scale of the sensor deviates by {:+.0} um/m from that of X, Y and Z (u {:.0}): \
             check the scale, range_mm and the radius of the sphere",
            Unit::UmPerM.to_reported_value(gain),
            Unit::UmPerM.to_reported_value(u)
        )
    })
}

/// Warning about the group with the largest form error, if that error exceeds `form_limit_um`.
fn form_warning(result: &IdentificationResult<'_>) -> Option<String> {
    let forms = result.form_error_of_each_group_mm();
    let (form, group) = forms.iter().zip(&result.grouped.groups).max_by(|a, b| a.0.total_cmp(b.0))?;
    let (subject, remedy) = match result.setup.uses_touch_probe() {
        true => ("touches of the sphere", "clean the sphere and the stylus, and check that both are tight"),
        false => ("the sphere's scan", "clean the sphere, and check its radius and incidence_limit_deg"),
    };
    (*form > result.setup.settings.form_limit_um * 1e-3)
        .then(|| format!("{}: residuals of {subject} spread over {:.1} um; {remedy}", group.label, form * 1e3))
}

/// Warning if the samples scatter more than 1.5 times the declared noise of the sensor. `None` also for a touch probe.
fn noise_warning(result: &IdentificationResult<'_>) -> Option<String> {
    if result.setup.uses_touch_probe() {
        return None;
    }
    let (observed_mm, declared_mm) = (result.observed.sample_scatter_mm()?, result.setup.sensor.noise_um? * 1e-3);
    (observed_mm > 1.5 * declared_mm).then(|| {
        format!(
            "the scatter of the samples {} is {:.3} um, noise_um of the sensor is {:.3}",
            if result.observed.latency.is_some() { "about their sphere" } else { "at rest" },
            observed_mm * 1e3,
            declared_mm * 1e3
        )
    })
}

/// Location errors held at zero, because they are equivalent to the zero position, the sphere or reported errors.
pub fn held_location_errors(result: &IdentificationResult<'_>) -> Vec<String> {
    let held = result.selection.held_at_zero.iter().filter(|error| error.shape() == ErrorShape::Location);
    held.map(ToString::to_string).collect()
}

pub fn gauge_lines(result: &IdentificationResult<'_>) -> Vec<String> {
    let held = held_location_errors(result);
    let mut lines = vec![
        "X, Y and Z are assumed straight, square to each other and of equal scale; their errors \
         are part of the result"
            .to_owned(),
        format!(
            "{}: relative to the axis of rotation nearest to the bed; it includes the position \
             error of this axis",
            zero_point_name(result)
        ),
        "errors of an axis: relative to the axis that carries it; ISO 230-1's E_A0C is the sum of EA0B \
         and EA0C here"
            .to_owned(),
        "the result describes the machine at the middle of the measurement".to_owned(),
    ];
    if !held.is_empty() {
        lines.push(format!(
            "held at zero, because equivalent to {}, sphere or a reported error: {}",
            zero_point_name(result),
            held.join(", ")
        ));
    }
    lines.extend(result.selection.gauge_lines.iter().cloned());
    lines.extend(latency_note(result));
    lines.extend(paper_comparison(result));
    lines
}

/// Text on the corrections of the continuous scans: latency and lost motion.
fn latency_note(result: &IdentificationResult<'_>) -> Option<String> {
    let ObservedScans { latency, unreliable_sample_count: unused_count, .. } = &result.observed;
    let latency = latency.as_ref()?;
    let first = result.unknown_names.len() + result.grouped.centre_equations.beam_unknown_count();
    let expanded = |k: usize| result.identification.parameter_uncertainty(first + k).map_or(f64::NAN, |u| u.expanded());
    let lags = latency.moved_axes.iter().zip(latency.values_of_unknowns().into_iter().skip(1)).enumerate();
    let lags = lags.map(|(k, (axis, lag))| format!("{axis} by {:.2} um (U {:.2})", lag * 1e3, expanded(k + 1) * 1e3));
    Some(format!(
        "continuous scans: a sensor reading belongs to the axis positions {:.3} ms (U {:.3}) \
         earlier; lost motion of the axes at reversals: {}. All scans are corrected for both. \
         Estimated from {} samples at two feeds; {unused_count} samples at reversals or \
         gaps are not used",
        latency.latency_s * 1e3,
        expanded(0) * 1e3,
        lags.collect::<Vec<_>>().join(", "),
        latency.sample_count
    ))
}

/// Result of the paper's own estimator, for comparison.
fn paper_comparison(result: &IdentificationResult<'_>) -> Option<String> {
    let [a, b, c, x, a_cb] =
        paper_estimator::identify_by_paper_method(result.setup, &result.grouped, &result.centre_fit.x)?;
    let [a, b, c, a_cb] = [a, b, c, a_cb].map(|rad| Unit::Urad.to_reported_value(rad));
    Some(format!(
        "for comparison, by the estimator of paper 2 (the single measurement at B = C = 0 counts as true): \
         EA0B {a:.2}, EB0B {b:.2}, EC0B {c:.2} urad, EX0C {:.2} um, EA0C {a_cb:.2} urad",
        Unit::Um.to_reported_value(x)
    ))
}

/// Name of the point that the axes move to the sphere.
fn zero_point_name(result: &IdentificationResult<'_>) -> &'static str {
    match result.setup.uses_touch_probe() {
        true => "stylus centre",
        false => "zero position",
    }
}

pub fn describe_not_identifiable(result: &IdentificationResult<'_>) -> Vec<String> {
    let mut lines = vec![
        format!("position of the axis of rotation nearest to the bed: it only shifts the {}", zero_point_name(result)),
        match result.setup.uses_touch_probe() {
            true => {
                "separate values of sphere radius, stylus ball radius and mean pre-travel of the probe: only \
                     their combination is measured"
            }
            false => "separate values of sphere radius and zero error of the sensor",
        }
        .to_owned(),
    ];
    if result.setup.settings.harmonics.is_empty() {
        lines.push("error motions of the rotary axes: location errors are means over the angles measured".to_owned());
    }
    let groups = &result.grouped.groups;
    let angles = |axis: Axis| groups.iter().map(|group| group.rotary.get_or_zero(axis)).collect::<Vec<f64>>();
    let axes = result.setup.chain.topology().axes();
    let rotary = axes.filter(|axis| !axis.is_linear() && *axis != Axis::S);
    lines.extend(rotary.filter_map(|axis| describe_aliased_orders(axis, &angles(axis), LOCATION_ERRORS_TEXT)));
    lines.extend(result.identification.outlier_check.describe_detection_limits());
    lines
}
