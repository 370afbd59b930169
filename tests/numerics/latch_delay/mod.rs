//! The method `latch-delay` against machines whose delay is part of their motion, not of any equation:
//! the simulated world lets the axes go on for as long as nobody notices the contact.

mod bench;
mod coverage;
mod readings;
mod refusals;
