//! Files for programs and pages for users. This module knows kinds of figures, but no methods.

mod captions;
mod figure;
mod number;
pub mod page;
mod planned;
mod proven;
pub mod readings_csv;
mod related;
mod rows;
pub mod temperature;
#[cfg(test)]
mod tests;
mod vectors;

pub use figure::{ErrorMap, Individuals, Temperatures};
