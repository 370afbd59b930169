//! Why a world cannot be built.

use super::truth::Truth;
use machine::Axis;
use machine::kinematics::{KinematicsError, ParameterError};
use machine::record::machine::{Machine, Probe};

/// A world that cannot be built, and what to change.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WorldError {
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error("[simulated]: {0}")]
    Symbol(#[from] ParameterError),
    #[error("[simulated] {key}: the unit behind the symbol must be {unit}")]
    Unit { key: String, unit: &'static str },
    #[error(
        "[artefact]: the axis must not be zero, height and radius must be positive; check also radius_offset_mm, form and roughness_um in [simulated]"
    )]
    Artefact,
    #[error(
        "[artefact]: there must be balls, each of positive radius; check also radius_offset_mm, diameter_um and form_um in [simulated]"
    )]
    Balls,
    #[error("[simulated] {key} is for an artefact of the kind \"{belongs}\": remove it")]
    OtherKind { key: &'static str, belongs: &'static str },
    #[error("[simulated] names the ball `{id}`, which the artefact does not have")]
    NoBall { id: String },
    #[error("[[simulated.sag]]: there is no tilt axis {axis} in the topology")]
    NoTilt { axis: Axis },
    #[error(
        "[[simulated.sensor]] names `{name}`, and there is no [[sensor]] of that name: give it one, or take it out"
    )]
    NoSensor { name: String },
    #[error("[[sensor]] or [[simulated.sensor]]: `{name}` stands there twice; keep one")]
    TwoSensors { name: String },
    #[error(
        "[[sensor]] and [[simulated.sensor]] `{name}`: no sensor has such a {key}; check its numbers"
    )]
    Sensor { name: String, key: &'static str },
    #[error(
        "[[simulated.thermometer]] `{name}` needs one [[thermometer]] of that name, and stands there once: give it one, or take it out"
    )]
    NoThermometer { name: String },
    #[error(
        "[[simulated.thermometer]] `{name}`: begins_c, warms_k and noise_k must be finite, noise_k not negative"
    )]
    Thermometer { name: String },
    #[error("[axes.{axis}]: rapid_per_min and acceleration_per_s2 must be positive")]
    Dynamics { axis: Axis },
    #[error(
        "lengths, delays, noise, drift and backlash in [probe], [machine], [axes] and [simulated] must not be negative, error_wavelength_mm must be positive, and every number finite"
    )]
    Magnitude,
}

/// Magnitudes and speeds that no machine has.
pub(super) fn check(machine: &Machine, probe: &Probe, truth: &Truth) -> Result<(), WorldError> {
    let sound = |value: f64| value.is_finite() && value >= 0.0;
    let mut magnitudes = vec![
        probe.ball_radius_mm,
        probe.repeatability_um.unwrap_or_default(),
        probe.lobing_um,
        probe.stylus_offset_um,
        probe.overtravel_mm,
        machine.drift_um_per_h,
        machine.squareness_urad,
        truth.roughness_um,
        truth.ball_offset_mm,
        truth.ball_diameter_um,
        truth.ball_form_um,
        truth.latch.delay_ms,
        truth.latch.scan_ms,
    ];
    magnitudes.extend(truth.backlash_um.values());
    for (axis, spec) in &machine.axes {
        magnitudes.extend([spec.resolution_um, spec.error_motion_um]);
        if !(spec.rapid_per_min > 0.0 && spec.acceleration_per_s2 > 0.0) {
            return Err(WorldError::Dynamics { axis: *axis });
        }
        if spec.error_wavelength_mm <= 0.0 {
            return Err(WorldError::Magnitude);
        }
    }
    for term in &truth.sag {
        if term.axis.is_linear() || !machine.axes.contains_key(&term.axis) {
            return Err(WorldError::NoTilt { axis: term.axis });
        }
    }
    let form = truth.form.iter().flat_map(|h| [h.cos_um, h.sin_um]);
    let offsets = truth.centre_offset_mm.into_iter().chain(truth.tool_offset_um);
    let offsets = offsets.chain([truth.radius_offset_mm]);
    let balls = truth.ball.iter().flat_map(|ball| {
        ball.offset_mm.into_iter().chain([ball.diameter_um, ball.form_um.unwrap_or_default()])
    });
    let moves =
        truth.ball_moves.iter().flat_map(|moved| moved.by_mm.into_iter().chain([moved.at_s]));
    let sag = truth.sag.iter().flat_map(|term| term.um.into_iter().chain(term.urad));
    let mut stated = truth.errors.values().copied().chain(form).chain(offsets);
    let mut of_balls = balls.chain(moves).chain(sag).chain([truth.length_error_um_per_m]);
    if !(stated.all(f64::is_finite) && of_balls.all(f64::is_finite)) {
        return Err(WorldError::Magnitude);
    }
    if magnitudes.into_iter().all(sound) { Ok(()) } else { Err(WorldError::Magnitude) }
}
