//! Files for programs and pages for users. This module knows kinds of figures, but no methods.

mod captions;
mod clearance;
mod correlation;
mod figure;
mod number;
pub mod page;
mod planned;
pub mod readings_csv;
mod rows;
pub mod temperature;
#[cfg(test)]
mod tests;
mod vectors;

pub use figure::{ErrorMap, IndividualsChart, Temperatures};
