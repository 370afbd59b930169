//! Single values over a number, each with its uncertainty, without a line between them.

use plotters::prelude::*;

use super::scale::{Ticked, bounds, widened};
use super::{INK, LINE, Sample, curve, picture};
use machine::record::estimate::Function;

const SIZE: (u32, u32) = (1400, 640);

pub(super) fn points(function: &Function, samples: &[Sample]) -> Option<String> {
    let ends = samples.iter().flat_map(|sample| [sample.y - sample.half, sample.y + sample.half]);
    let (low, high) = widened(bounds(ends.chain([0.0]))?);
    let (first, last) = widened(bounds(samples.iter().map(|sample| sample.x))?);
    let (x_name, y_name) = curve::names(function);
    let axes = (Ticked::round(first..last), Ticked::round(low..high));
    picture(SIZE, |area| {
        let mut chart = super::chart(area, (axes.0, &x_name), (axes.1, &y_name))?;
        let zero = vec![(first, 0.0), (last, 0.0)];
        chart.draw_series([PathElement::new(zero, INK.stroke_width(2))])?;
        let bars = samples.iter().filter(|sample| sample.half > 0.0).map(|sample| {
            let ends = [sample.y - sample.half, sample.y + sample.half];
            PathElement::new(ends.map(|y| (sample.x, y)), LINE.mix(0.5).stroke_width(4))
        });
        chart.draw_series(bars)?;
        let marks = samples.iter().map(|sample| (sample.x, sample.y));
        chart.draw_series(marks.map(|point| Circle::new(point, 7, LINE.filled())))?;
        Ok(())
    })
}
