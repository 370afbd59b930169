//! Position error of the tool over the volume, from the errors that a run has estimated.

use crate::report::ErrorMap;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::{Axis, Position};
use methods::prediction::{ErrorPredictor, ErrorSlice};

/// Sentences about the position error, and maps of the error of the tip and of the U (k = 2) that remains after a
/// correction. `None` if the error cannot be predicted, such as for an estimate without axis errors.
pub fn volumetric_error_maps(plan: &Plan, estimate: &Estimate) -> Option<(Vec<String>, Vec<ErrorMap>)> {
    let predictor = ErrorPredictor::of_plan(plan, estimate).ok()?;
    let poses = predictor.volume_grid_poses().ok()?;
    let errors = predictor.volume_errors(&poses, &predictor.tip_errors(&poses));
    let slices = predictor.xy_and_rotary_error_slices(poses.get(errors[0].worst_pose_index)?).ok()?;
    let mut lines = vec![format!(
        "{}; over the measured ranges of the axes, with tool-centre control (TCP), and with the work zero \
        set with the tip at the origin of the table and the rotary axes at 0",
        predictor.describe_model()
    )];
    lines.extend(ErrorPredictor::describe_volume_errors(errors, &poses));
    let symbols = predictor.predicted_error_symbols().to_vec();
    lines.push(predictor.describe_error_after_correction(&symbols, &poses).ok()?);
    Some((lines, slices.into_iter().map(error_map).collect()))
}

/// Map of a slice, in µm: length of the error of the tip, and its standard uncertainty times 2.
fn error_map(slice: ErrorSlice) -> ErrorMap {
    let unit = |axis: Axis| if axis.is_linear() { "mm" } else { "°" };
    let named = |(axis, positions): (Axis, Vec<f64>)| (format!("{axis}, {}", unit(axis)), positions);
    let in_um = |rows: Vec<Vec<f64>>, factor: f64| -> Vec<Vec<f64>> {
        rows.into_iter().map(|row| row.into_iter().map(|mm| factor * mm).collect()).collect()
    };
    ErrorMap {
        title: format!(
            "{} and {}, at {}",
            slice.horizontal_axis.0,
            slice.vertical_axis.0,
            describe_position(&slice.other_positions)
        ),
        horizontal_axis: named(slice.horizontal_axis),
        vertical_axis: named(slice.vertical_axis),
        panels: [
            ("error of the tip, µm".to_owned(), in_um(slice.error_mm, 1e3)),
            ("remaining error after a correction, U (k = 2), µm".to_owned(), in_um(slice.u_mm, 2e3)),
        ],
    }
}

/// Positions in whole mm and degrees.
fn describe_position(at: &Position) -> String {
    let unit = |axis: Axis| if axis.is_linear() { " mm" } else { "°" };
    let words =
        at.iter().map(|(axis, value)| format!("{axis} {:.0}{}", axis.to_mm_or_deg(value).round() + 0.0, unit(axis)));
    words.collect::<Vec<_>>().join(", ")
}
