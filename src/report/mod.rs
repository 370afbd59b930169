//! Report pages with figures, and readings files. This module depends on the kinds of figures and on the names that
//! the methods give their results, but on no method.

mod budget;
mod captions;
mod clearance;
pub mod correction_sheet;
mod correlation;
pub mod difference;
mod figure;
pub mod number;
pub mod page;
mod plan_summary;
pub mod readings_csv;
pub mod residuals;
pub mod result_row;
pub mod results_csv;
mod rows;
pub mod step_text;
pub mod temperature;
#[cfg(test)]
mod tests;
pub mod time;
mod vectors;

pub use captions::{figure_values, has_location_errors};
pub use figure::{ErrorMap, IndividualsChart, TemperatureCurves};

/// Colours, type and spacing of the report and of the page of the daemon.
pub const BASE_CSS: &str = include_str!("base.css");
