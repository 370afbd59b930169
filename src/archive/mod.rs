//! Data of the journal, prepared for display: events of a run, its report, a machine's history. This module
//! neither measures nor writes.

pub mod compare;
pub mod history;
pub mod report;
pub mod run_files;
pub mod run_story;
mod volumetric_error;

#[cfg(test)]
mod tests;
#[cfg(test)]
pub use self::tests::plan as plan_for_tests;
