//! What the journal holds, for people: how a run went, its report, a machine's history.
//! Nothing is measured and nothing is written here.

pub mod compare;
pub mod history;
pub mod report;
pub mod story;
mod volume;

#[cfg(test)]
mod tests;
#[cfg(test)]
pub use self::tests::plan as plan_for_tests;
