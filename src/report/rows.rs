//! Rows of a table.

/// Name and text of each row.
pub type Rows = Vec<(String, String)>;
