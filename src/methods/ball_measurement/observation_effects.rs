//! Changes of the observations X, Y, Z of each measurement (machine frame, mm) as effects of sources.

use nalgebra::Vector3;

use crate::identification::{ObservationEffect, ObservationSpanChange};

/// A column of a [`ObservationEffect::Joint`]: the shift of each measurement, machine frame, mm.
pub fn shift_column(shifts: impl Iterator<Item = Vector3<f64>>) -> Vec<f64> {
    shifts.flat_map(<[f64; 3]>::from).collect()
}

/// An effect with one random quantity per column, without columns that are zero; empty if all are zero.
pub fn effect_of_nonzero_columns(columns: impl IntoIterator<Item = Vec<f64>>) -> ObservationEffect {
    ObservationEffect::Joint(columns.into_iter().filter(|column| !is_zero(column)).collect())
}

/// An effect with one random quantity per span, without spans that are zero; empty if all are zero.
pub fn effect_of_nonzero_spans(spans: impl Iterator<Item = ObservationSpanChange>) -> ObservationEffect {
    ObservationEffect::Spans(spans.filter(|span| !is_zero(&span.changes_mm)).collect())
}

fn is_zero(changes: &[f64]) -> bool {
    changes.iter().all(|change| *change == 0.0)
}
