//! The data of a run: machine, plan, stage, step, motion, event, reading, estimate.

pub mod artefact;
pub mod axis_track;
pub mod estimate;
pub mod event;
pub mod machine;
pub mod measurement_check;
pub mod motion;
pub mod plan;
pub mod question;
pub mod reading;
pub mod report_data;
pub mod sensor;
mod sensor_names;
pub mod stage_proof;
pub mod tool_centre;
pub mod watched_sensors;

/// Whether a value equals its type's default; such a value is not written.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Default of a key in the machine file.
fn default_value<const VALUE: u16>() -> f64 {
    f64::from(VALUE)
}
