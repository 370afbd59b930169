//! Changes of the observations X, Y, Z of each measurement (machine frame, mm) as effects of sources.

use nalgebra::Vector3;

use super::observe::BallCentre;
use crate::identification::{Effect, ObservationSpan};

/// A column of a [`Effect::Joint`]: the `shift` of each measurement, machine frame, mm.
pub fn shift_column(centres: &[BallCentre], shift: impl FnMut(&BallCentre) -> Vector3<f64>) -> Vec<f64> {
    let shifts: Vec<[f64; 3]> = centres.iter().map(shift).map(Into::into).collect();
    shifts.into_flattened()
}

/// An effect of joint draws, without columns that are zero.
pub fn nonzero_columns(columns: impl IntoIterator<Item = Vec<f64>>) -> Effect {
    Effect::Joint(columns.into_iter().filter(|column| !is_zero(column)).collect())
}

/// An effect with one draw per run, without runs that are zero.
pub fn nonzero_spans(runs: impl Iterator<Item = ObservationSpan>) -> Effect {
    Effect::Spans(runs.filter(|run| !is_zero(&run.changes_mm)).collect())
}

fn is_zero(changes: &[f64]) -> bool {
    changes.iter().all(|change| *change == 0.0)
}
