//! Temperatures below a chart, over the same time with a scale of their own. The curve has a gap where a
//! temperature is unknown.

use plotters::prelude::*;

use super::legend::{Piece, marker};
use super::scale::{Ticked, bounds, widened};
use super::{Area, Drawn, LINE};

/// Name of each thermometer, and its temperatures at the times of the values, °C.
pub type Temperatures = Vec<(String, Vec<(f64, Option<f64>)>)>;

pub(super) const HEIGHT: u32 = 330;
/// Minimum range of the temperature scale, K: a smaller range would magnify noise.
const LEAST_K: f64 = 1.0;

/// Range of the temperature scale; `None` without a value.
pub(super) fn range(all: &Temperatures) -> Option<(f64, f64)> {
    let known = all.iter().flat_map(|(_, values)| values).filter_map(|(_, celsius)| *celsius);
    let (low, high) = bounds(known.filter(|celsius| celsius.is_finite()))?;
    let more = ((LEAST_K - (high - low)) / 2.0).max(0.0);
    Some(widened((low - more, high + more)))
}

/// Names of the thermometers, for the legend.
pub(super) fn names(all: &Temperatures) -> Vec<(Piece, String)> {
    let name = |(number, (name, _)): (usize, &(String, _))| {
        (Piece::Marker(number), format!("temperature {name}"))
    };
    all.iter().enumerate().map(name).collect()
}

/// Draws the strip; one unit of the time axis is `scale` seconds.
pub(super) fn draw(
    area: &Area<'_>,
    all: &Temperatures,
    (x, x_name, scale): (Ticked, &str, f64),
    (low, high): (f64, f64),
) -> Drawn {
    let mut chart = super::chart(area, (x, x_name), (Ticked::coarse(low..high), "°C"))?;
    for (number, (_, values)) in all.iter().enumerate() {
        let point = |(t_s, celsius): &(f64, Option<f64>)| Some((t_s / scale, (*celsius)?));
        let unknown = |(_, celsius): &(f64, Option<f64>)| !celsius.is_some_and(f64::is_finite);
        for piece in values.split(unknown) {
            let points: Vec<(f64, f64)> = piece.iter().filter_map(point).collect();
            if points.len() > 1 {
                let line = PathElement::new(points.clone(), LINE.stroke_width(2));
                chart.draw_series([line])?;
            }
            for point in points {
                let ((x, y), (left, top)) = (chart.backend_coord(&point), area.get_base_pixel());
                marker(area, number, (x - left, y - top))?;
            }
        }
    }
    Ok(())
}
