//! Files and pages for people and programs; knows kinds of figure, never methods.

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
