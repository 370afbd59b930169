//! Position error of the tool over the volume, from the errors that a run has estimated.

use crate::report::ErrorMap;
use machine::record::estimate::Estimate;
use machine::record::machine::Machine;
use machine::{Axis, Position};
use methods::prediction::{Predictor, Slice, WorkZero};

/// Sentences, and maps before and after a correction; `None` for an estimate without axis errors.
pub fn volume(machine: &Machine, estimate: &Estimate) -> Option<(Vec<String>, Vec<ErrorMap>)> {
    let predictor = Predictor::new(machine, estimate, WorkZero::OnTable).ok()?;
    let poses = predictor.volume().ok()?;
    let errors = predictor.volume_errors(&poses, &predictor.tips(&poses));
    let slices = predictor.slices(poses.get(errors[0].worst)?).ok()?;
    let mut lines = vec![format!(
        "{}; over the ranges of the axes that were measured, with tool-centre control, the work zero set with the tip \
         on the origin of the table and the rotary axes at 0",
        predictor.model_in_words()
    )];
    lines.extend(Predictor::in_words(errors, &poses));
    let symbols = predictor.symbols().to_vec();
    lines.push(predictor.left_in_words(&symbols, &poses).ok()?);
    Some((lines, slices.into_iter().map(map).collect()))
}

fn map(slice: Slice) -> ErrorMap {
    let unit = |axis: Axis| if axis.is_linear() { "mm" } else { "°" };
    let named =
        |(axis, positions): (Axis, Vec<f64>)| (format!("{axis}, {}", unit(axis)), positions);
    let in_um = |rows: Vec<Vec<f64>>, factor: f64| -> Vec<Vec<f64>> {
        rows.into_iter().map(|row| row.into_iter().map(|mm| factor * mm).collect()).collect()
    };
    ErrorMap {
        title: format!("{} and {}, at {}", slice.across.0, slice.up.0, others(&slice.others)),
        across: named(slice.across),
        up: named(slice.up),
        panels: [
            ("error of the tip, µm".to_owned(), in_um(slice.error_mm, 1e3)),
            (
                "remaining error after a correction, U (k = 2), µm".to_owned(),
                in_um(slice.u_mm, 2e3),
            ),
        ],
    }
}

fn others(at: &Position) -> String {
    let unit = |axis: Axis| if axis.is_linear() { " mm" } else { "°" };
    let words = at.iter().map(|(axis, value)| {
        format!("{axis} {:.0}{}", axis.to_edge(value).round() + 0.0, unit(axis))
    });
    words.collect::<Vec<_>>().join(", ")
}
