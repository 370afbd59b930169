//! A measured scan: means of its samples, by dwell point or by cell.

use nalgebra::{Rotation3, Vector3};

use super::scan_purpose::ScanPurpose;
use machine::Position;

/// Mean of the samples at one dwell point, or in one cell of a continuous scan.
#[derive(Debug, Clone, Copy, Default)]
pub struct SampleMean {
    /// Axis positions X, Y, Z, mm.
    pub linear_axis_positions_mm: Vector3<f64>,
    /// Displacement of the spindle relative to the table, machine frame.
    pub spindle_displacement_from_table_mm: Vector3<f64>,
    /// Reading, mm; 0 for a touch.
    pub reading_mm: f64,
    /// Number of the samples that the mean contains.
    pub sample_count: usize,
    /// Mean time of the samples on the clock of the run, s.
    pub time_in_run_s: f64,
    /// Mean velocity of X, Y, Z, mm/s; zero for a dwell point or a touch.
    pub velocity: Vector3<f64>,
    /// Mean sign of the last motion of each of X, Y, Z; 0 where unknown, and for a dwell point or a touch.
    pub last_motion_sign: Vector3<f64>,
}

/// Means of the samples of one measurement, with the rotary axes at rest.
#[derive(Debug, Clone)]
pub struct MeasuredScan {
    pub purpose: ScanPurpose,
    pub label: String,
    /// Positions of all rotary axes.
    pub rotary_positions: Position,
    /// Rotation from the spindle frame to the machine frame.
    pub machine_from_spindle: Rotation3<f64>,
    /// One entry for each dwell point, cell or touch.
    pub sample_means: Vec<SampleMean>,
}
