//! Rows of a table.

/// Name and text of each row.
pub type NameTextRows = Vec<(String, String)>;
