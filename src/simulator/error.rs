//! Errors of building a world.

use machine::Axis;
use machine::kinematics::{InvalidErrorParameter, KinematicsError};

/// The reason why a world cannot be built, and what to change.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulatedWorldError {
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error("[simulated]: {0}")]
    InvalidSymbol(#[from] InvalidErrorParameter),
    /// `unit`: the unit that `key` must end with.
    #[error("[simulated] {key}: the unit after the symbol must be {unit}")]
    WrongUnit { key: String, unit: &'static str },
    #[error(
        "[artefact]: the axis must not be zero, and height and radius must be positive; check also radius_offset_mm, form and roughness_um in [simulated]"
    )]
    InvalidCylinder,
    #[error(
        "[artefact]: a datum cylinder needs an axis and at least one section, each section of positive radius; check also radius_offset_mm, form and section_form in [simulated] (sections are counted from 1)"
    )]
    InvalidDatumCylinder,
    #[error(
        "[artefact]: at least one ball is required, each ball of positive radius; check also radius_offset_mm, diameter_um and form_um in [simulated]"
    )]
    InvalidBalls,
    /// `kind`: the artefact to which the stated `key` applies.
    #[error("[simulated] {key} is valid only for an artefact of the kind \"{kind}\"; remove the key")]
    WrongArtefactKind { key: &'static str, kind: &'static str },
    #[error("[simulated] refers to ball `{id}`, but the artefact has no such ball; correct the id")]
    UnknownBall { id: String },
    #[error("[[simulated.sag]]: the machine has no rotary axis {axis}; correct axis")]
    NoRotarySagAxis { axis: Axis },
    #[error("[[simulated.sensor]] `{name}`: no [[sensor]] has this name; correct the name or remove the table")]
    UnknownSensor { name: String },
    #[error("[[sensor]] or [[simulated.sensor]]: `{name}` occurs twice; remove one")]
    DuplicateSensor { name: String },
    /// `key`: the key with the impossible value, or several keys in words.
    #[error(
        "[[sensor]] or [[simulated.sensor]] `{name}`: the value of {key} is not possible for a sensor; correct the value"
    )]
    InvalidSensor { name: String, key: &'static str },
    #[error(
        "[[simulated.thermometer]] `{name}`: no [[thermometer]] has this name, or `{name}` occurs twice; correct the name or remove the table"
    )]
    UnknownOrDuplicateThermometer { name: String },
    #[error(
        "[[simulated.thermometer]] `{name}`: begins_c, warms_k and noise_k must be finite, and noise_k must not be negative"
    )]
    InvalidThermometer { name: String },
    /// Rapid speed or acceleration of an axis is not positive.
    #[error("[axes.{axis}]: rapid_per_min and acceleration_per_s2 must be positive")]
    InvalidDynamics { axis: Axis },
    /// A number is not finite, a magnitude is negative, an error wavelength is not positive, or a
    /// `[[simulated.rotary_motion]]` has an axis that is not a rotary axis of the machine.
    #[error(
        "lengths, delays, noise, drift and backlash in [probe], [machine], [axes] and [simulated] must not be negative; error_wavelength_mm must be positive; every number must be finite"
    )]
    InvalidNumber,
}
