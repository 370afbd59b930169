//! Report pages with figures, and readings files. This module depends on the kinds of figures, but on no method.

mod captions;
mod clearance;
mod correlation;
mod figure;
mod number;
pub mod page;
mod plan_summary;
pub mod readings_csv;
mod rows;
pub mod temperature;
#[cfg(test)]
mod tests;
mod vectors;

pub use figure::{ErrorMap, IndividualsChart, TemperatureCurves};
