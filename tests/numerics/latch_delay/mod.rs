//! The method `latch-delay` on machines whose delay is part of their motion, not of an equation: in the simulated
//! world the axes continue to move until the contact is latched.

mod coverage;
mod latch_delay_world;
mod refusals;
mod unusual_readings;
