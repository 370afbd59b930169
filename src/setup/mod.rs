//! Floor 6: from a machine file to the parts of a run.

pub mod machine_file;
