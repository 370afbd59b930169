//! The results of the identification.

use super::fit::{Fit, Solved};
use super::outputs::{Output, OutputFunction};
use super::sense::Sense;
use super::settings::Settings;
use super::uncertainty::{Propagated, TouchScale};
use estimation::monte_carlo::Summary;
use machine::record::plan::Plan;

/// Everything that the estimate is written from.
pub struct Parts<'a> {
    pub plan: &'a Plan,
    pub settings: &'a Settings,
    /// In the machine frame, mm.
    pub heights: &'a [f64],
    pub fit: Fit,
    pub solved: Solved,
    pub chi2: f64,
    pub scale: TouchScale,
    pub parameters: Vec<Output>,
    pub functions: Vec<OutputFunction>,
    pub propagated: Propagated,
    pub monte_carlo: Summary,
    pub sense: Sense,
    pub timed: bool,
    /// Readings that no step connects with the rest.
    pub left_out: usize,
}
