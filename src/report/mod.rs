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
#[cfg(test)]
mod tests;
mod vectors;
pub mod warmth;

pub use figure::{ErrorMap, Individuals, Temperatures};
