//! Labels of the steps.

pub const PROMPT: &str = "mount nest";
pub const CALIBRATION: &str = "calibration";
pub const REFERENCE: &str = "reference";
pub const FORWARD: &str = "turn/forward";
pub const BACKWARD: &str = "turn/backward";
