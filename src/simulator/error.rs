//! Errors of building a world.

use machine::Axis;
use machine::kinematics::{KinematicsError, ParameterError};

/// The reason why a world cannot be built, and what to change.
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
        "[artefact]: a datum cylinder needs an axis and sections of positive radius; check also radius_offset_mm, form and section_form in [simulated] (sections are counted from 1)"
    )]
    DatumCylinder,
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
