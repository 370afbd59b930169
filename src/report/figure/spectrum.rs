//! Amplitudes over the harmonic order as bars, each with its uncertainty. Orders that are not identifiable are
//! shaded.

use plotters::prelude::*;

use super::legend::{self, LegendSymbol, SHADE_OPACITY};
use super::ticked_axis::{TickedAxis, round_up_to_1_2_or_5, value_bounds};
use super::{GRID_COLOUR, INK_COLOUR, LINE_COLOUR, MIN_Y_LABEL_WIDTH, PICTURE_SIZE, PlotPoint, curve, draw_picture};
use machine::record::estimate::EstimatedFunction;

/// Maximum number of ticks of the orders.
const MAX_ORDER_TICKS: f64 = 16.0;
/// Maximum of half the width of a bar, in orders.
const MAX_BAR_HALF_WIDTH: f64 = 0.3;
/// Half the width of a bar, as a share of the distance to the nearest order.
const BAR_HALF_WIDTH_SHARE_OF_DISTANCE: f64 = 0.4;

pub(super) fn draw_spectrum(function: &EstimatedFunction, samples: &[PlotPoint]) -> Option<String> {
    let (_, top) = value_bounds(samples.iter().map(|sample| sample.y + sample.uncertainty_half_width))?;
    let top = if top > 0.0 { 1.08 * top } else { 1.0 };
    let mut orders: Vec<f64> = samples.iter().map(|sample| sample.x).collect();
    orders.sort_by(f64::total_cmp);
    let lost = ranges_of_missing_orders(&orders);
    let (least, highest) = value_bounds(orders.iter().copied())?;
    let from = if least < 1.0 { 0.0 } else { 0.5 };
    let x_axis =
        TickedAxis::with_tick_step(round_up_to_1_2_or_5(highest / MAX_ORDER_TICKS).max(1.0), from..highest + 0.5);
    let row = if lost.is_empty() { 0 } else { legend::LEGEND_ROW_HEIGHT };
    let (x_name, y_name) = curve::axis_names_with_units(function);
    draw_picture((PICTURE_SIZE.0, PICTURE_SIZE.1 + row), |area| {
        let (above, below) = area.split_vertically(row as i32);
        if !lost.is_empty() {
            legend::draw_legend(
                &above,
                MIN_Y_LABEL_WIDTH,
                &[(LegendSymbol::NotIdentifiableArea, "not identifiable".to_owned())],
            )?;
        }
        let y_axis = TickedAxis::with_round_ticks(0.0..top);
        let mut chart = super::draw_axes(&below, x_axis.titled(&x_name), y_axis.titled(&y_name))?;
        let shade =
            |[from, to]: &[f64; 2]| Rectangle::new([(*from, 0.0), (*to, top)], GRID_COLOUR.mix(SHADE_OPACITY).filled());
        chart.draw_series(lost.iter().map(shade))?;
        chart.draw_series(samples.iter().map(|PlotPoint { x, y, .. }| {
            let half_bar = bar_half_width(&orders, *x);
            let corners = [(x - half_bar, 0.0), (x + half_bar, y.max(0.0))];
            Rectangle::new(corners, LINE_COLOUR.mix(0.6).filled())
        }))?;
        let stated = samples.iter().filter(|sample| sample.uncertainty_half_width > 0.0);
        chart.draw_series(stated.map(|PlotPoint { x, y, uncertainty_half_width: half }| {
            let ends = [(*x, (y - half).max(0.0)), (*x, (y + half).max(0.0))];
            PathElement::new(ends, INK_COLOUR.stroke_width(3))
        }))?;
        Ok(())
    })
}

/// Ranges of the missing whole orders from 1 up to the largest of `orders`, extended by half an order on either
/// side.
fn ranges_of_missing_orders(orders: &[f64]) -> Vec<[f64; 2]> {
    let whole = orders.iter().copied().filter(|order| *order >= 1.0 && order.fract() == 0.0);
    let with_zero: Vec<f64> = std::iter::once(0.0).chain(whole).collect();
    let gaps = with_zero.windows(2).filter(|pair| pair[1] - pair[0] > 1.0);
    gaps.map(|pair| [pair[0] + 0.5, pair[1] - 0.5]).collect()
}

/// Half the width of the bar at `order`, such that bars do not touch.
fn bar_half_width(orders: &[f64], order: f64) -> f64 {
    let distances = orders.iter().map(|other| (other - order).abs());
    let nearest = distances.filter(|distance| *distance > 0.0).fold(f64::INFINITY, f64::min);
    MAX_BAR_HALF_WIDTH.min(BAR_HALF_WIDTH_SHARE_OF_DISTANCE * nearest)
}

#[cfg(test)]
mod tests {
    use super::super::draw_function;
    use super::super::tests::{attribute_values, is_inside_picture, sine_function, svg_coordinates};
    use machine::record::estimate::{EstimatedFunction, FunctionFigureKind};

    fn spectrum_function(orders: &[f64]) -> EstimatedFunction {
        EstimatedFunction {
            symbol: "EXC_spectrum".to_owned(),
            argument: "order".to_owned(),
            argument_unit: String::new(),
            x: orders.to_vec(),
            y: vec![2.0; orders.len()],
            u: vec![0.5; orders.len()],
            ..sine_function(FunctionFigureKind::Spectrum, 1)
        }
    }

    /// Attributes of the rectangles of this colour: x, y, width, height.
    fn svg_rectangles(svg: &str, fill: &str) -> Vec<[f64; 4]> {
        let lines = svg.lines().filter(|line| line.contains("<rect") && line.contains(fill));
        let number = |line: &str, name| attribute_values(line, name)[0].parse::<f64>().unwrap();
        lines.map(|line| ["x", "y", "width", "height"].map(|name| number(line, name))).collect()
    }

    /// With 2 ± 1 µm at each order, a whisker is as long as its bar is high.
    #[test]
    fn orders_without_an_amplitude_are_shaded() {
        let svg = draw_function(&spectrum_function(&[0.5, 1.0, 2.0, 6.0, 8.0]), 2.0).unwrap();
        let bars = svg_rectangles(&svg, "#1F6FB2");
        assert_eq!(bars.len(), 5);
        let whiskers = svg.lines().filter(|line| line.contains("stroke-width=\"3\""));
        for (whisker, bar) in whiskers.map(svg_coordinates).zip(&bars) {
            assert!(((whisker[1] - whisker[3]).abs() - bar[3]).abs() <= 2.0, "{whisker:?} {bar:?}");
            assert!((whisker[0] - bar[0] - bar[2] / 2.0).abs() <= 2.0, "{whisker:?} {bar:?}");
        }
        // Half an order apart: the bars do not touch.
        assert!(bars[0][0] + bars[0][2] < bars[1][0]);
        let shaded = svg_rectangles(&svg, "#D5D9DE");
        let per_order = bars[4][0] - bars[3][0];
        // The legend, then orders 2.5 to 5.5, then 6.5 to 7.5.
        let [_, three, one] = shaded.as_slice() else { panic!("{shaded:?}") };
        assert!((three[2] - 1.5 * per_order).abs() <= 2.0 && (one[2] - per_order / 2.0).abs() <= 2.0);
        assert!(svg.contains("not identifiable") && svg.contains("order") && is_inside_picture(&svg));
        let all = draw_function(&spectrum_function(&[1.0, 2.0, 3.0]), 2.0).unwrap();
        assert!(!all.contains("not identifiable") && svg_rectangles(&all, "#D5D9DE").is_empty());
        assert!(is_inside_picture(&all));
    }
}
