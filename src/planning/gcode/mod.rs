//! Renders neutral motions as text for a control, and reads the text back.
//!
//! A *dialect* is a folder in `gcode-templates/` ([`Dialect`]); a new dialect needs no Rust code. For each *language*
//! there is a G-code reader ([`rs274`]), which reads rendered text back; the motions read are compared with the
//! intended motions ([`Dialect::check_read_motions`]).

mod dialect;
mod dialect_file;
mod dialect_options;
#[cfg(test)]
mod dialect_options_tests;
mod error;
#[cfg(test)]
mod fuzz;
mod read_back;
mod render;
pub mod rs274;
mod template_environment;
#[cfg(test)]
mod tests;
mod transmission;

pub use dialect::Dialect;
pub use dialect_options::ProbeFault;
pub use error::{DialectError, ReadBackMismatch, RenderError};
pub use render::HeadAndFootValues;
pub(crate) use transmission::TransmissionText;
pub use transmission::{TransmissionForm, TransmissionUnit};
