//! Tests of the separation with an independent generator, METHODS gate G3, nullities, refusals.

mod coverage;
mod determinant;
mod faults;
mod gate_g3;
mod geometry;
mod nullities;
mod refusals;
mod simulated_motions;
