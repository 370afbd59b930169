//! The separation against an independent generator, METHODS gate G3, nullities, refusals.

mod g3;
mod generator;
mod nullities;
