//! Warnings and notes of the estimate.

use super::centres::GAIN;
use super::label::Pass;
use super::observe::Observed;
use super::paper;
use super::parts::Parts;
use crate::identification::{LOCATION, MisfitAdvice, aliased};
use machine::Axis;
use machine::kinematics::Shape;
use machine::record::estimate::Unit;

/// A gain is reported if it deviates from 1 by more than [`MIN_GAIN`] and by more than [`MIN_GAIN_RATIO`] standard
/// uncertainties.
const MIN_GAIN: f64 = 1e-3;
const MIN_GAIN_RATIO: f64 = 4.0;

pub fn warnings(parts: &Parts<'_>) -> Vec<String> {
    let mut lines: Vec<String> = missing(parts);
    lines.extend(parts.observed.excluded_in_words());
    lines.extend(thin(parts));
    lines.extend(misfit(parts));
    lines.extend(parts.identified.checked.warnings.iter().cloned());
    lines.extend(gain(parts));
    lines.extend(form(parts));
    lines.extend(noise(parts));
    lines.extend(parts.identified.trials_warning());
    lines
}

fn missing(parts: &Parts<'_>) -> Vec<String> {
    let of_interest = |line: &&String| Pass::of(line) != Some(Pass::Find);
    let lines = parts.observed.left_out.iter().filter(of_interest);
    lines.map(|line| format!("not used: {line}")).collect()
}

/// Warnings for motions with too few samples, where forward and backward have unequal weight.
fn thin(parts: &Parts<'_>) -> impl Iterator<Item = String> {
    let of_interest = |line: &&String| Pass::of(line) != Some(Pass::Find);
    parts.observed.thin.iter().filter(of_interest).cloned()
}

fn misfit(parts: &Parts<'_>) -> Option<String> {
    let declared_by = match parts.bench.touches() {
        true => "repeatability_um or error_motion_um",
        false => "noise_um or error_motion_um",
    };
    let causes =
        "error motions (harmonics = [2]), squareness of X, Y and Z, drift or a loose sphere";
    parts.identified.misfit_warning(&MisfitAdvice { causes, declared_by })
}

fn gain(parts: &Parts<'_>) -> Option<String> {
    if parts.bench.touches() {
        return None;
    }
    let index = parts.names.len() + GAIN;
    let gain = parts.identified.outputs.parameters.get(index)?.value;
    let u = parts.identified.uncertainty(index)?.u;
    (gain.abs() > MIN_GAIN_RATIO * u && gain.abs() > MIN_GAIN).then(|| {
        format!(
            "the sensor says {:+.0} um/m more than X, Y and Z move (u {:.0}): check its scale, and that \
             range_mm and the sphere's radius are right",
            Unit::UmPerM.from_internal(gain),
            Unit::UmPerM.from_internal(u)
        )
    })
}

fn form(parts: &Parts<'_>) -> Option<String> {
    let forms = parts.forms();
    let worst = forms.iter().zip(&parts.grouped.groups).max_by(|a, b| a.0.total_cmp(b.0));
    let (form, group) = worst?;
    let (of, remedy) = match parts.bench.touches() {
        true => (
            "touches of the sphere",
            "clean the sphere and the stylus, and see that both are tight",
        ),
        false => (
            "the sphere's scan",
            "clean the sphere, and look at its radius and at incidence_limit_deg",
        ),
    };
    (*form > parts.bench.settings.form_limit_um * 1e-3).then(|| {
        format!("{}: residuals of {of} spread over {:.1} um; {remedy}", group.label, form * 1e3)
    })
}

fn noise(parts: &Parts<'_>) -> Option<String> {
    if parts.bench.touches() {
        return None;
    }
    let (seen, declared) = (parts.observed.scatter_mm()?, parts.bench.sensor.noise_um? * 1e-3);
    (seen > 1.5 * declared).then(|| {
        format!(
            "samples {} scatter by {:.3} um, noise_um of the sensor says {:.3}",
            if parts.observed.latency.is_some() { "about their sphere" } else { "at rest" },
            seen * 1e3,
            declared * 1e3
        )
    })
}

pub fn gauge(parts: &Parts<'_>) -> Vec<String> {
    let held = parts.chosen.held.iter().filter(|error| error.shape() == Shape::Location);
    let held: Vec<String> = held.map(ToString::to_string).collect();
    let mut lines = vec![
        "X, Y and Z: straight, square to each other, of equal scale; what they are not stands in the \
         result"
            .to_owned(),
        format!(
            "{}: from the axis of rotation nearest to the bed, whose own place stands in it",
            zero(parts)
        ),
        "errors of an axis: relative to the axis that carries it; ISO 230-1's E_A0C is the sum of EA0B \
         and EA0C here"
            .to_owned(),
        "the machine as it stood in the middle of the measurement".to_owned(),
    ];
    if !held.is_empty() {
        lines.push(format!(
            "held at zero, being other names for {}, sphere or an error given: {}",
            zero(parts),
            held.join(", ")
        ));
    }
    lines.extend(parts.chosen.gauge.iter().cloned());
    lines.extend(latency(parts));
    lines.extend(comparison(parts));
    lines
}

/// Corrections of the continuous scans: latency and lost motion.
fn latency(parts: &Parts<'_>) -> Option<String> {
    let Observed { latency, turning, .. } = &parts.observed;
    let latency = latency.as_ref()?;
    let first = parts.names.len() + parts.grouped.centres.common();
    let expanded =
        |k: usize| parts.identified.uncertainty(first + k).map_or(f64::NAN, |u| u.expanded());
    let lags = latency.axes.iter().zip(latency.values().into_iter().skip(1)).enumerate();
    let lags = lags.map(|(k, (axis, lag))| {
        format!("{axis} by {:.2} um (U {:.2})", lag * 1e3, expanded(k + 1) * 1e3)
    });
    Some(format!(
        "continuous scans: what the sensor says belongs to where the axes stood {:.3} ms (U {:.3}) before; \
         where they turn round they lag behind the position shown: {}. All scans are corrected by that. \
         From {} samples at two feeds; {turning} samples beside turning points or gaps are not used",
        latency.tau_s * 1e3,
        expanded(0) * 1e3,
        lags.collect::<Vec<_>>().join(", "),
        latency.samples
    ))
}

/// Result of the paper's own estimator, for comparison.
fn comparison(parts: &Parts<'_>) -> Option<String> {
    let [a, b, c, x, a_cb] = paper::identify(parts.bench, &parts.grouped, &parts.fitted.x)?;
    let urad = |value: f64| Unit::Urad.from_internal(value);
    Some(format!(
        "for comparison, as paper 2 identifies (the one measurement at B = C = 0 as truth): EA0B {:.2}, \
         EB0B {:.2}, EC0B {:.2} urad, EX0C {:.2} um, EA0C {:.2} urad",
        urad(a),
        urad(b),
        urad(c),
        Unit::Um.from_internal(x),
        urad(a_cb)
    ))
}

/// Name of the point that the axes move to the sphere.
fn zero(parts: &Parts<'_>) -> &'static str {
    match parts.bench.touches() {
        true => "stylus centre",
        false => "zero position",
    }
}

pub fn not_identifiable(parts: &Parts<'_>) -> Vec<String> {
    let mut lines = vec![
        format!(
            "where the axis of rotation nearest to the bed lies: it only shifts the {}",
            zero(parts)
        ),
        match parts.bench.touches() {
            true => "radius of the sphere, radius of the stylus ball and the probe's mean pre-travel, apart",
            false => "radius of the sphere and what the sensor's reading is off at its zero, apart",
        }
        .to_owned(),
    ];
    let orders = &parts.bench.settings.harmonics;
    if orders.is_empty() {
        lines.push(
            "error motions of the rotary axes: location errors are means over the angles measured"
                .to_owned(),
        );
    }
    let angles = |axis: Axis| -> Vec<f64> {
        parts.grouped.groups.iter().map(|group| group.rotary.at(axis)).collect()
    };
    let axes = parts.bench.chain.topology().axes();
    let rotary = axes.filter(|axis| !axis.is_linear() && *axis != Axis::S);
    lines.extend(rotary.filter_map(|axis| aliased(axis, &angles(axis), LOCATION)));
    lines.extend(parts.identified.checked.limits());
    lines
}
