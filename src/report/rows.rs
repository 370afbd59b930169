//! The rows of a table.

/// Names and texts.
pub type Rows = Vec<(String, String)>;
