//! The results of the identification.

use super::fit::Fit;
use super::sense::SenseCheck;
use super::settings::SelfCalibrationSettings;
use super::table_axis::TableAxis;
use crate::identification::{Identification, KnownMotions};
use machine::record::plan::Plan;

/// The data from which the estimate is written.
pub struct SolvedCycle<'a> {
    pub plan: &'a Plan,
    pub settings: &'a SelfCalibrationSettings,
    pub axis: &'a TableAxis,
    /// Heights of the touches, machine frame, mm.
    pub heights: Vec<f64>,
    pub known_motions: &'a KnownMotions<'a>,
    pub fit: Fit,
    pub identification: Identification,
    pub sense: SenseCheck,
    pub has_times: bool,
    /// Number of readings that no step connects with the rest.
    pub skipped_readings: usize,
}
