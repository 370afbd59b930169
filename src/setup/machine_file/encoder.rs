//! `[encoder]`: the rotary encoder whose count the sensors' samples contain.

use serde::Deserialize;

use super::document::TomlDocument;
use super::error::MachineFileError;
use super::sensor::SensorEntry;
use machine::Axis;
use machine::record::machine::Machine;

/// Encoder on a rotary axis whose count is in the samples of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisEncoder {
    /// Axis that turns the encoder.
    pub axis: Axis,
    /// Counts per revolution of the axis; negative if the count decreases while the control's angle increases.
    pub counts_per_turn: i64,
}

/// The encoder of the machine file; `None` without `[encoder]`.
///
/// # Errors
/// An axis that does not turn, zero counts, `[encoder]` without a sensor that transmits a count, or a sensor that
/// transmits a count without `[encoder]`.
pub fn read_encoder(
    document: &TomlDocument,
    machine: &Machine,
    sensors: &[SensorEntry],
) -> Result<Option<AxisEncoder>, MachineFileError> {
    let counts = |entry: &SensorEntry| entry.connection.encoder_wrap_count().is_some();
    let counting = sensors.iter().position(counts);
    let encoder: Option<AxisEncoder> = document.read_section(&["encoder"], Deserialize::deserialize)?;
    let Some(AxisEncoder { axis, counts_per_turn }) = encoder else {
        return match counting {
            None => Ok(None),
            Some(index) => {
                let why = "has `encoder_count`: add the section [encoder] with `axis` and `counts_per_turn`";
                Err(document.entry_error("sensor", index, why))
            }
        };
    };
    let refused = |key: &str, why: &str| Err(document.value_error(&["encoder", key], why));
    if axis.is_linear() || axis == Axis::S || !machine.axes.contains_key(&axis) {
        return refused("axis", &format!("is {axis}; it must be a rotary axis of this machine"));
    }
    if counts_per_turn == 0 {
        let why = "is 0; write the counts per revolution, negative if the encoder counts down in the \
            positive direction of the axis";
        return refused("counts_per_turn", why);
    }
    if counting.is_none() {
        let why = "is present, but no sensor has `encoder_count`: add `encoder_count`, the position of the \
            count in the samples";
        return refused("axis", why);
    }
    Ok(encoder)
}
