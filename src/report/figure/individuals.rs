//! Chart of individual values over time with their uncertainties: control limits from the values before, marked
//! steps, the tolerance, and the temperatures below.

use plotters::prelude::*;

use super::compact_svg::compact_svg;
use super::legend::{self, LegendEntry, LegendSymbol, TOLERANCE_DASH_AND_GAP_LENGTH};
use super::temperature_strip::{self, TemperatureCurves};
use super::ticked_axis::{TickedAxis, add_margin, value_bounds};
use super::{
    Area, DrawResult, FIT_COLOUR, GRID_COLOUR, INK_COLOUR, LINE_COLOUR, MIN_Y_LABEL_WIDTH, PICTURE_SIZE, PlotPoint,
    draw_picture,
};
use crate::report::number;
use machine::record::estimate::Unit;

/// Maximum ratio of the value range with a tolerance line to the range without the line. Above this ratio the
/// tolerance is stated only in the legend, because the values would be too small to see.
const MAX_RANGE_RATIO_WITH_TOLERANCE: f64 = 20.0;

/// Chart of one parameter; times are Unix times in seconds.
#[derive(Debug, Clone, Default)]
pub struct IndividualsChart {
    pub symbol: String,
    /// Time, value and expanded uncertainty, in order of time.
    pub times_values_and_expanded_u: Vec<[f64; 3]>,
    /// Lower limit, centre and upper limit, and the index of the first value for which they are valid.
    pub control_limits_and_first_index: Option<([f64; 3], usize)>,
    /// Maximum magnitude of the value; `None`: no limit is stated.
    pub tolerance: Option<f64>,
    /// Times at which the value changes in a step (level change).
    pub level_change_times_s: Vec<f64>,
    /// Times at which values were written to the control, or restored.
    pub compensation_times_s: Vec<f64>,
    /// Times as in the chart; without a finite temperature, the chart has no temperature strip.
    pub temperatures: TemperatureCurves,
}

/// Data of the chart with its scales.
struct ScaledChart {
    /// Finite values over Unix time, s; the half-width is U.
    samples: Vec<PlotPoint>,
    /// First and last time in the picture, s.
    time_range: (f64, f64),
    /// Lowest and highest value in the picture.
    value_range: (f64, f64),
    /// Values at which a tolerance line is drawn: plus and minus the tolerance, as far as they are in the picture.
    drawn_tolerance_lines: Vec<f64>,
}

impl IndividualsChart {
    /// Draws the chart; `None` without two finite values at different times.
    pub fn draw(&self, unit: Unit) -> Option<String> {
        self.draw_shapes(unit).map(|svg| compact_svg(&svg))
    }

    fn draw_shapes(&self, unit: Unit) -> Option<String> {
        let scaled = self.scale_data()?;
        let legend_entries = self.legend_entries(unit, &scaled.drawn_tolerance_lines);
        let thermometers = temperature_strip::thermometer_legend_entries(&self.temperatures);
        let y_name = format!("{} / {}", number::one_line_symbol(&self.symbol), unit.symbol());
        let mut y = TickedAxis::with_round_ticks(scaled.value_range.0..scaled.value_range.1).titled(&y_name);
        let temperature = temperature_strip::temperature_axis(&self.temperatures).map(|axis| axis.aligned_with(&y));
        y = temperature.iter().fold(y, TickedAxis::aligned_with);
        let height_of = |entries: &[LegendEntry]| legend::legend_height(entries, MIN_Y_LABEL_WIDTH, PICTURE_SIZE.0);
        let (rows, names) = (height_of(&legend_entries), height_of(&thermometers));
        let below = temperature.as_ref().map_or(0, |_| names + temperature_strip::TEMPERATURE_STRIP_HEIGHT);
        let time = TickedAxis::of_local_time(scaled.time_range.0..scaled.time_range.1);
        draw_picture((PICTURE_SIZE.0, PICTURE_SIZE.1 + rows + below), |area| {
            let (above, rest) = area.split_vertically(rows as i32);
            legend::draw_legend(&above, MIN_Y_LABEL_WIDTH, &legend_entries)?;
            let (upper, lower) = rest.split_vertically(PICTURE_SIZE.1 as i32);
            self.draw_values_and_limits(&upper, &scaled, time.clone(), y)?;
            let Some(temperature) = temperature else { return Ok(()) };
            let (above, lower) = lower.split_vertically(names as i32);
            legend::draw_legend(&above, MIN_Y_LABEL_WIDTH, &thermometers)?;
            temperature_strip::draw_strip(&lower, &self.temperatures, time, 1.0, temperature)
        })
    }

    fn scale_data(&self) -> Option<ScaledChart> {
        let finite = self.times_values_and_expanded_u.iter().filter(|value| value.iter().all(|part| part.is_finite()));
        let samples: Vec<PlotPoint> =
            finite.map(|[t_s, y, half]| PlotPoint { x: *t_s, y: *y, uncertainty_half_width: *half }).collect();
        let limits = self.control_limits_and_first_index.map(|(limits, _)| limits).into_iter().flatten();
        let ends = samples.iter().flat_map(PlotPoint::uncertainty_ends);
        let (mut low, mut high) = value_bounds(ends.chain(limits))?;
        let most = MAX_RANGE_RATIO_WITH_TOLERANCE * (high - low).max(f64::MIN_POSITIVE);
        let mut tolerance: Vec<f64> = self.tolerance.iter().flat_map(|limit| [-limit, *limit]).collect();
        // The nearer line first: there may be room for one only.
        let middle = (low + high) / 2.0;
        tolerance.sort_by(|one, other| (one - middle).abs().total_cmp(&(other - middle).abs()));
        tolerance.retain(|line| {
            let (with_low, with_high) = (low.min(*line), high.max(*line));
            let fits = with_high - with_low <= most || low == high;
            if fits {
                (low, high) = (with_low, with_high);
            }
            fits
        });
        let (begin, end) = value_bounds(samples.iter().map(|sample| sample.x)).filter(|(begin, end)| begin < end)?;
        Some(ScaledChart {
            samples,
            time_range: add_margin((begin, end)),
            value_range: add_margin((low, high)),
            drawn_tolerance_lines: tolerance,
        })
    }

    /// Entries of the legend.
    fn legend_entries(&self, unit: Unit, drawn: &[f64]) -> Vec<LegendEntry> {
        let beyond = match drawn.len() {
            2 => "",
            1 => " (one line beyond)",
            _ => " (beyond)",
        };
        let tolerance = self.tolerance.map(|limit| format!("tolerance ±{limit} {}{beyond}", unit.symbol()));
        let has_control_limits = self.control_limits_and_first_index.is_some();
        let name_if_drawn = |is_drawn: bool, name: &str| is_drawn.then(|| name.to_owned());
        let names_by_symbol = [
            (LegendSymbol::ControlLimitsBand, name_if_drawn(has_control_limits, "control limits")),
            (LegendSymbol::ToleranceLine, tolerance),
            (LegendSymbol::LevelChangeMark, name_if_drawn(!self.level_change_times_s.is_empty(), "step")),
            (LegendSymbol::CompensationMark, name_if_drawn(!self.compensation_times_s.is_empty(), "compensation")),
        ];
        names_by_symbol.into_iter().filter_map(|(symbol, name)| Some((symbol, name?))).collect()
    }

    fn draw_values_and_limits(
        &self,
        area: &Area<'_>,
        scaled: &ScaledChart,
        x: TickedAxis,
        y: TickedAxis,
    ) -> DrawResult {
        let ((first, last), (low, high)) = (scaled.time_range, scaled.value_range);
        let mut chart = super::draw_axes(area, x, y)?;
        if let Some(([lower, centre, upper], from)) = self.control_limits_and_first_index {
            let begin = self.times_values_and_expanded_u.get(from).map_or(first, |[t_s, ..]| *t_s);
            let band = [(begin, lower), (last, upper)];
            chart.draw_series([Rectangle::new(band, GRID_COLOUR.mix(0.4).filled())])?;
            for (y, width) in [(lower, 3), (centre, 2), (upper, 3)] {
                let line = vec![(begin, y), (last, y)];
                chart.draw_series([PathElement::new(line, FIT_COLOUR.stroke_width(width))])?;
            }
        }
        for y in &scaled.drawn_tolerance_lines {
            let (line, (dash, gap)) = ([(first, *y), (last, *y)], TOLERANCE_DASH_AND_GAP_LENGTH);
            chart.draw_series(DashedLineSeries::new(line, dash, gap, INK_COLOUR.stroke_width(4)))?;
        }
        for t_s in &self.level_change_times_s {
            let line = vec![(*t_s, low), (*t_s, high)];
            chart.draw_series([PathElement::new(line, INK_COLOUR.stroke_width(3))])?;
        }
        for t_s in self.compensation_times_s.iter().filter(|t_s| (first..=last).contains(*t_s)) {
            let (line, (dash, gap)) = ([(*t_s, low), (*t_s, high)], legend::COMPENSATION_DASH_AND_GAP_LENGTH);
            chart.draw_series(DashedLineSeries::new(line, dash, gap, FIT_COLOUR.stroke_width(4)))?;
        }
        let bars = scaled.samples.iter().map(|sample| {
            let ends = sample.uncertainty_ends().map(|y| (sample.x, y));
            PathElement::new(ends, LINE_COLOUR.mix(0.5).stroke_width(4))
        });
        chart.draw_series(bars)?;
        let joined: Vec<_> = scaled.samples.iter().map(PlotPoint::coordinates).collect();
        chart.draw_series([PathElement::new(joined.clone(), LINE_COLOUR.stroke_width(2))])?;
        chart.draw_series(joined.iter().map(|point| Circle::new(*point, 7, LINE_COLOUR.filled())))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{attribute_values, is_inside_picture, smallest_text_on_a_phone};
    use super::*;

    #[test]
    fn values_limits_and_steps_are_drawn_at_their_positions() {
        let value = |day: i32| [-86_400.0 * f64::from(10 - day), f64::from(day % 2), 0.5];
        let chart = IndividualsChart {
            symbol: "EX0C".to_owned(),
            times_values_and_expanded_u: (0..10).map(value).collect(),
            control_limits_and_first_index: Some(([-1.0, 0.5, 2.0], 4)),
            level_change_times_s: vec![-86_400.0 * 6.5],
            ..IndividualsChart::default()
        };
        let svg = chart.draw_shapes(Unit::Um).unwrap();
        assert!(is_inside_picture(&svg) && svg.contains("local time ("), "{svg}");
        assert!(smallest_text_on_a_phone(&svg) >= 9.0);
        let dots: Vec<f64> = svg
            .lines()
            .filter(|line| line.contains("<circle"))
            .map(|line| attribute_values(line, "cx")[0].parse().unwrap())
            .collect();
        assert_eq!(dots.len(), 10);
        assert!(dots.windows(2).all(|pair| pair[1] > pair[0]));
        let is_band = |line: &&str| line.contains("<rect") && line.contains("0.4");
        let band = svg.lines().rev().find(is_band).unwrap();
        // The limits begin at the fifth value.
        let begins: f64 = attribute_values(band, "x")[0].parse().unwrap();
        assert!((begins - dots[4]).abs() <= 1.0, "{begins} {dots:?}");
        let none = IndividualsChart { times_values_and_expanded_u: vec![[0.0, f64::NAN, 1.0]], ..chart.clone() };
        assert_eq!(none.draw_shapes(Unit::Um), None);
    }

    fn polyline_points(line: &str) -> Vec<[f64; 2]> {
        let pair = |pair: &str| -> Option<[f64; 2]> {
            let (x, y) = pair.split_once(',')?;
            Some([x.parse().ok()?, y.parse().ok()?])
        };
        attribute_values(line, "points")[0].split_whitespace().filter_map(pair).collect()
    }

    /// Horizontal lines of this colour and width below the legend, in a chart without temperatures: both ends and the
    /// height in the picture.
    fn horizontal_lines(svg: &str, colour: &str, width: u32) -> Vec<[f64; 3]> {
        let (colour, width) = (format!("stroke=\"{colour}\""), format!("stroke-width=\"{width}\""));
        let lines = svg.lines().filter(|line| line.contains("<polyline"));
        let lines = lines.filter(|line| line.contains(&colour) && line.contains(&width)).map(polyline_points);
        let level = |line: &Vec<[f64; 2]>| line.iter().all(|[_, y]| *y == line[0][1]);
        let height: f64 = attribute_values(svg, "viewBox")[0].split(' ').nth(3).unwrap().parse().unwrap();
        let legend_bottom = height - f64::from(PICTURE_SIZE.1);
        let lines = lines.filter(|line| level(line) && line[0][1] > legend_bottom);
        lines.map(|line| [line[0][0], line[line.len() - 1][0], line[0][1]]).collect()
    }

    fn daily_chart(tolerance: Option<f64>) -> IndividualsChart {
        let value = |day: i32| [-86_400.0 * f64::from(10 - day), f64::from(day % 2), 0.5];
        IndividualsChart {
            symbol: "EX0C".to_owned(),
            times_values_and_expanded_u: (0..10).map(value).collect(),
            control_limits_and_first_index: Some(([-1.0, 0.5, 2.0], 0)),
            tolerance,
            ..IndividualsChart::default()
        }
    }

    /// The control limits, at -1, 0.5 and 2 by construction, give the scale for the tolerance.
    #[test]
    fn tolerance_is_a_dashed_line_at_its_value() {
        let svg = daily_chart(Some(3.25)).draw_shapes(Unit::Um).unwrap();
        assert!(is_inside_picture(&svg) && svg.contains("tolerance ±3.25 µm") && svg.contains("control limits"));
        let limits: Vec<f64> = horizontal_lines(&svg, "#C2571A", 3).iter().map(|line| line[2]).collect();
        let [lower, upper] = limits[..] else { panic!("{limits:?}") };
        let per_um = (lower - upper) / 3.0;
        let dashes = horizontal_lines(&svg, "#22262B", 4);
        for limit in [-3.25, 3.25] {
            let y = lower - (limit + 1.0) * per_um;
            let of_line: Vec<_> = dashes.iter().filter(|dash| (dash[2] - y).abs() <= 2.0).collect();
            assert!(of_line.len() > 10, "{limit}: {y} {dashes:?}");
            // Dashes with gaps between them, not one line.
            assert!(of_line.windows(2).all(|pair| pair[1][0] - pair[0][1] > 10.0), "{of_line:?}");
        }
        assert!(dashes.iter().all(|dash| dash[1] - dash[0] <= 41.0), "{dashes:?}");
        let without = daily_chart(None).draw_shapes(Unit::Um).unwrap();
        assert!(horizontal_lines(&without, "#22262B", 4).is_empty() && !without.contains("tolerance"));
    }

    /// Both entries of the legend are wider than the picture together: the second one begins a new row.
    #[test]
    fn legend_has_as_many_rows_as_it_needs() {
        let text_y = |tolerance: f64, text: &str| -> f64 {
            let svg = daily_chart(Some(tolerance)).draw_shapes(Unit::Um).unwrap();
            let lines: Vec<&str> = svg.lines().collect();
            let at = lines.iter().position(|line| line.starts_with(text)).unwrap();
            attribute_values(lines[at - 1], "y")[0].parse().unwrap()
        };
        assert_eq!(text_y(3.25, "tolerance"), text_y(3.25, "control limits"));
        assert_eq!(
            text_y(1000.0, "tolerance") - text_y(1000.0, "control limits"),
            f64::from(legend::LEGEND_ROW_HEIGHT)
        );
    }

    #[test]
    fn compensation_is_marked_at_its_time() {
        let at = -86_400.0 * 3.5;
        let chart = IndividualsChart { compensation_times_s: vec![at, 1e6], ..daily_chart(None) };
        let svg = chart.draw_shapes(Unit::Um).unwrap();
        assert!(svg.contains("compensation"), "{svg}");
        let circles: Vec<f64> = svg
            .lines()
            .filter(|line| line.contains("<circle"))
            .map(|line| attribute_values(line, "cx")[0].parse().unwrap())
            .collect();
        let height: f64 = attribute_values(&svg, "viewBox")[0].split(' ').nth(3).unwrap().parse().unwrap();
        let is_below_legend = |[_, y]: &[f64; 2]| *y > height - f64::from(PICTURE_SIZE.1);
        let marks = svg.lines().filter(|line| line.contains("<polyline") && line.contains("#C2571A"));
        let marks = marks.map(|line| polyline_points(line)[0]).filter(is_below_legend).map(|[x, _]| x);
        let marks: Vec<f64> = marks.filter(|x| *x > circles[0]).collect();
        assert!(!marks.is_empty() && marks.iter().all(|x| *x > circles[6] && *x < circles[7]), "{marks:?} {circles:?}");
    }

    /// For values of one or two µm, a tolerance of a millimetre is named in the legend, and the values stay
    /// visible.
    #[test]
    fn tolerance_outside_the_range_is_stated_as_text() {
        let svg = daily_chart(Some(1000.0)).draw_shapes(Unit::Um).unwrap();
        assert!(svg.contains("tolerance ±1000 µm (beyond)"));
        assert!(horizontal_lines(&svg, "#22262B", 4).is_empty());
        let far = daily_chart(Some(50.0));
        let near_one = IndividualsChart {
            times_values_and_expanded_u: far
                .times_values_and_expanded_u
                .iter()
                .map(|[t, y, half]| [*t, y + 48.0, *half])
                .collect(),
            control_limits_and_first_index: None,
            ..far
        };
        let svg = near_one.draw_shapes(Unit::Um).unwrap();
        assert!(svg.contains("tolerance ±50 µm (one line beyond)"), "{svg}");
        assert!(!horizontal_lines(&svg, "#22262B", 4).is_empty());
    }

    /// The fourth and fifth run have no temperature of the spindle: its curve has two pieces without a mark
    /// between them.
    #[test]
    fn temperature_strip_has_the_same_time_axis_and_gaps() {
        let chart = daily_chart(None);
        let spindle =
            |(day, value): (usize, &[f64; 3])| (value[0], (day != 3 && day != 4).then_some(20.0 + day as f64));
        let bed = |value: &[f64; 3]| (value[0], Some(20.0));
        // Values with long numbers, which need more room than the temperatures.
        let far = |[t_s, value, half]: &[f64; 3]| [*t_s, -1e6 + 1e-3 * value, 1e-3 * half];
        let chart = IndividualsChart {
            times_values_and_expanded_u: chart.times_values_and_expanded_u.iter().map(far).collect(),
            control_limits_and_first_index: None,
            ..chart
        };
        let temperatures = vec![
            ("spindle".to_owned(), chart.times_values_and_expanded_u.iter().enumerate().map(spindle).collect()),
            ("bed".to_owned(), chart.times_values_and_expanded_u.iter().map(bed).collect()),
            ("nobody".to_owned(), chart.times_values_and_expanded_u.iter().map(|value| (value[0], None)).collect()),
        ];
        let plain = chart.draw_shapes(Unit::Um).unwrap();
        let svg = IndividualsChart { temperatures, ..chart.clone() }.draw_shapes(Unit::Um).unwrap();
        assert!(is_inside_picture(&svg) && svg.contains("temperature spindle") && svg.contains("°C"));
        assert!(!plain.contains("temperature"));
        let circles = svg.lines().filter(|line| line.contains("<circle") && line.contains("r=\"7\""));
        let dots: Vec<f64> = circles.map(|line| attribute_values(line, "cx")[0].parse().unwrap()).collect();
        let is_curve = |line: &&str| line.contains("<polyline") && line.contains("#1F6FB2");
        let lines = svg.lines().filter(is_curve).map(polyline_points);
        let below = 616.0;
        let curves: Vec<_> = lines.filter(|line| line.len() > 2 && line.iter().all(|[_, y]| *y > below)).collect();
        let lengths: Vec<_> = curves.iter().map(Vec::len).collect();
        assert_eq!(lengths, [3, 5, 10]);
        // Each mark is below the value of the same run, and the temperature axis is linear.
        for (curve, first) in curves.iter().zip([0, 5, 0]) {
            for ([x, _], dot) in curve.iter().zip(&dots[first..]) {
                assert!((x - dot).abs() <= 1.0, "{curve:?} {dots:?}");
            }
        }
        let kelvin = (curves[0][0][1] - curves[0][2][1]) / 2.0;
        assert!(kelvin > 10.0, "{curves:?}");
        let fifth = curves[0][0][1] - 5.0 * kelvin;
        assert!((curves[1][0][1] - fifth).abs() <= 3.0, "{curves:?}");
        assert!((curves[2][0][1] - curves[0][0][1]).abs() <= 1.0, "{curves:?}");
        let marks = svg.matches("<polygon").count();
        assert_eq!(marks, 8 + 1, "one triangle for each change, and one in the legend");
    }

    #[test]
    fn chart_without_finite_temperatures_has_no_strip() {
        let chart = daily_chart(None);
        let none = vec![("bed".to_owned(), chart.times_values_and_expanded_u.iter().map(|v| (v[0], None)).collect())];
        let nan = vec![("bed".to_owned(), vec![(-1.0, Some(f64::NAN))])];
        let plain = chart.draw_shapes(Unit::Um);
        for temperatures in [none, nan] {
            assert_eq!(IndividualsChart { temperatures, ..chart.clone() }.draw_shapes(Unit::Um), plain);
        }
    }
}
