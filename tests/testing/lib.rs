//! Test support for every package: fuzzing, and the sizes of statistical populations.

pub mod fuzz;
pub mod population;
