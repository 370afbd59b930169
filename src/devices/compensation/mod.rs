//! Values of controls that compensate errors of the axes: one module for each kind of control.

use std::path::Path;

use crate::controllers::ControllerError;
use crate::controllers::linuxcnc::IniFile;

mod hal_pins;
pub mod linuxcnc_joints;
pub mod linuxcnc_trunnion;
pub mod program_search;

/// Largest deviation, mm, at which a value counts as equal: half of the last digit of a value below 1000 mm, as
/// `halcmd` prints seven digits.
const MAX_READ_BACK_DEVIATION_MM: f64 = 0.5e-4;

/// Whether two values of a control, mm, are equal within its steps; NaN equals nothing.
pub fn are_values_equal(one_mm: f64, other_mm: f64) -> bool {
    (one_mm - other_mm).abs() < MAX_READ_BACK_DEVIATION_MM
}

/// A value to write to a control, mm, with the name that the value has there.
#[derive(Debug, Clone, Copy)]
pub struct ValueToWrite<'a> {
    pub name: &'a str,
    pub text: &'a str,
}

/// # Errors
/// `LINEAR_UNITS` of the control is not mm, or is missing.
fn check_unit_is_mm(file: &IniFile, path: &Path) -> Result<(), ControllerError> {
    let units = file.value("TRAJ", "LINEAR_UNITS").map(str::to_ascii_lowercase);
    match units.as_deref() {
        Some("mm" | "metric") => Ok(()),
        _ => Err(ControllerError::not_ready(
            format!("LINEAR_UNITS of {} is not mm", path.display()),
            "values in inches are not supported: enter them by hand",
        )),
    }
}
