//! Tests of the separation with an independent generator, METHODS gate G3, nullities, refusals.

mod coverage;
mod determinant;
mod faults;
mod g3;
mod generator;
mod geometry;
mod nullities;
mod refusals;
