//! Labels of the steps.

pub const MOUNT_PROMPT_LABEL: &str = "mount nest";
pub const CALIBRATION_LABEL: &str = "calibration";
pub const REFERENCE_LABEL: &str = "reference";
pub const FORWARD_LABEL: &str = "turn/forward";
pub const BACKWARD_LABEL: &str = "turn/backward";
