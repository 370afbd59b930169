//! Floor 0: axes and positions, frames, clocks, seeded random streams. Imports no crate code.

pub mod axis;
pub mod clock;
pub mod frame;
#[cfg(test)]
pub mod fuzz;
pub mod random;

pub use axis::{Axis, Position};
pub use clock::Clock;
pub use frame::{Machine, Point, Spindle, Table};
