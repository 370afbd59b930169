//! A function over a straight axis, with its uncertainty band: one curve, or several over the same range.

use plotters::prelude::*;

use super::scale::{Ticked, bounds, widened};
use super::{BAND, LINE, MAX_MARKS, Sample, picture};
use crate::report::number;
use machine::record::estimate::Function;

const SIZE: (u32, u32) = (1400, 640);

pub(super) fn curve(function: &Function, samples: &[Sample]) -> Option<String> {
    let (low, high) =
        bounds(samples.iter().flat_map(|sample| [sample.y - sample.half, sample.y + sample.half]))?;
    let (low, high) = widened((low, high));
    let x_axis = x_axis(function, samples)?;
    let (x_name, y_name) = names(function);
    picture(SIZE, |area| {
        let mut chart = super::chart(area, (x_axis, &x_name), (Ticked::round(low..high), &y_name))?;
        for samples in samples.chunk_by(|sample, next| sample.x <= next.x) {
            let upper = samples.iter().map(|sample| (sample.x, sample.y + sample.half));
            let lower = samples.iter().rev().map(|sample| (sample.x, sample.y - sample.half));
            let band: Vec<_> = upper.chain(lower).collect();
            chart.draw_series([Polygon::new(band, LINE.mix(BAND))])?;
            let line: Vec<_> = samples.iter().map(|sample| (sample.x, sample.y)).collect();
            chart.draw_series([PathElement::new(line.clone(), LINE.stroke_width(4))])?;
            if line.len() <= MAX_MARKS {
                chart
                    .draw_series(line.iter().map(|point| Circle::new(*point, 7, LINE.filled())))?;
            }
        }
        Ok(())
    })
}

/// Names of both axes with their units.
pub(super) fn names(function: &Function) -> (String, String) {
    let x_name = match function.argument_unit.as_str() {
        "" => function.argument.clone(),
        unit => format!("{} / {}", function.argument, number::argument_unit(unit)),
    };
    let unit = number::unit(function.unit);
    (x_name, format!("{} / {unit}", number::plain_symbol(&function.symbol)))
}

/// The x axis: a full turn in steps of 45° for angles, otherwise round steps over the data.
fn x_axis(function: &Function, samples: &[Sample]) -> Option<Ticked> {
    let (first, last) = bounds(samples.iter().map(|sample| sample.x))?;
    let (low, high) = if last > first { (first, last) } else { widened((first, last)) };
    let turn = function.argument_unit == "deg" && first >= 0.0 && last <= 360.0;
    Some(if turn { Ticked::every(45.0, 0.0..360.0) } else { Ticked::round(low..high) })
}
