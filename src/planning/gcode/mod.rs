//! Renders neutral motions as text for a control, and reads the text back.
//!
//! A *dialect* is a folder in `gcode-templates/` ([`Dialect`]); a new dialect needs no Rust. A *language* is a
//! reader ([`rs274`]): the text that a dialect has rendered can be read back and compared with the intended motions
//! ([`Dialect::check_motions`]).

mod dialect;
mod environment;
mod error;
#[cfg(test)]
mod fuzz;
mod options;
#[cfg(test)]
mod options_tests;
mod read_back;
mod render;
pub mod rs274;
mod spec;
#[cfg(test)]
mod tests;
mod transmission;

pub use dialect::Dialect;
pub use error::{DialectError, ReadBackMismatch, RenderError};
pub use options::ProbeFault;
pub use render::ProgramHeader;
pub(crate) use transmission::TransmissionText;
pub use transmission::{Transmission, TransmissionUnit};
