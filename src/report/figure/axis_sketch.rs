//! Sketch of the location errors of an axis (ISO 230-1, ISO 230-7): its nominal and its actual line in two views, and
//! the zero position of a rotary axis in a view along the axis. Not to scale.

use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::views::draw_arrow;
use super::{Area, DrawResult, FIT_COLOUR, FONT_SIZE, GRID_COLOUR, INK_COLOUR, draw_picture, text_style};
use crate::report::number;

const LINEAR_AXES: [char; 3] = ['X', 'Y', 'Z'];
const ANGLES: [char; 3] = ['A', 'B', 'C'];
/// Letters of the axes in the order of the sketches; the spindle S is parallel to Z.
const AXES: [char; 7] = ['X', 'Y', 'Z', 'A', 'B', 'C', 'S'];
const PANEL_SIZE: (i32, i32) = (500, 480);
const PANELS_PER_ROW: usize = 2;
/// Position of the nominal axis at the height where the offset is drawn, from the left and top edge of a view.
const NOMINAL_AXIS_BASE: (i32, i32) = (150, 380);
/// Distance by which the nominal axis moves to the right if no offset is drawn.
const NOMINAL_AXIS_SHIFT_WITHOUT_OFFSET: i32 = 70;
/// Position of the centre of the view along the axis.
const END_VIEW_CENTRE: (i32, i32) = (180, 220);
/// Drawn distance between nominal and actual line.
const DRAWN_OFFSET: f64 = 130.0;
/// Drawn angle of an error.
const DRAWN_ANGLE_DEG: f64 = 16.0;
/// Length of the nominal and the actual axis line above their base.
const AXIS_LINE_LENGTH: f64 = 290.0;
/// Radius of the arc of an angle.
const ARC_RADIUS: f64 = 200.0;
/// Length of the two coordinate arrows in the lower left corner of a view.
const CORNER_AXIS_LENGTH: f64 = 50.0;
const DASH_AND_GAP_LENGTH: (u32, u32) = (26, 10);

/// Sketch of one axis with the symbols that are drawn.
pub(in crate::report) struct AxisSketch {
    pub axis: char,
    panels: Vec<Panel>,
}

/// Symbols of one view; `None`: the error is not part of the result.
enum Panel {
    /// View in which the axis points up. `right`, `up`: letters of linear axes. `offset`: symbol of the offset along
    /// `right`. `tilts_to_the_right`: a positive tilt leans the axis to the right.
    Side { right: char, up: char, offset: Option<String>, tilt: Option<String>, tilts_to_the_right: bool },
    /// View against the axis direction, with the zero position of the axis.
    End { right: char, up: char, angle: String },
}

/// Letters of the axes with a location error among the symbols, linear axes first.
pub(in crate::report) fn axes_with_location_errors(symbols: &[&str]) -> Vec<char> {
    let has_error = |axis: &char| symbols.iter().any(|symbol| is_location_error(symbol, *axis));
    AXES.into_iter().filter(has_error).collect()
}

/// Whether the symbol is E, a letter of X to C, `0` and the axis, such as `EX0C`.
fn is_location_error(symbol: &str, axis: char) -> bool {
    let mut letters = symbol.chars();
    letters.next() == Some('E')
        && letters.next().is_some_and(|letter| LINEAR_AXES.contains(&letter) || ANGLES.contains(&letter))
        && letters.eq(['0', axis])
}

impl AxisSketch {
    /// Sketch of `axis` with its location errors among `symbols`; `None` if `symbols` contains none of them.
    pub(in crate::report) fn new(axis: char, symbols: &[&str]) -> Option<Self> {
        let along = match axis {
            'X' | 'A' => 0,
            'Y' | 'B' => 1,
            'Z' | 'C' | 'S' => 2,
            _ => return None,
        };
        let found = |letter: char| {
            let symbol = format!("E{letter}0{axis}");
            symbols.contains(&symbol.as_str()).then_some(symbol)
        };
        let others = [(along + 1) % 3, (along + 2) % 3];
        let side = |right: usize, about: usize| Panel::Side {
            right: LINEAR_AXES[right],
            up: LINEAR_AXES[along],
            offset: found(LINEAR_AXES[right]),
            tilt: found(ANGLES[about]),
            // A positive rotation about e_about moves the end of the axis along e_about × e_along.
            tilts_to_the_right: (about + 1) % 3 == along,
        };
        let mut panels = vec![side(others[0], others[1]), side(others[1], others[0])];
        panels.retain(|panel| matches!(panel, Panel::Side { offset, tilt, .. } if offset.is_some() || tilt.is_some()));
        let angle = found(ANGLES[along]);
        panels.extend(angle.map(|angle| Panel::End {
            right: LINEAR_AXES[others[0]],
            up: LINEAR_AXES[others[1]],
            angle,
        }));
        (!panels.is_empty()).then_some(Self { axis, panels })
    }

    /// Symbols in the order of the views.
    pub(in crate::report) fn symbols(&self) -> Vec<&str> {
        let mut symbols = Vec::new();
        for panel in &self.panels {
            match panel {
                Panel::Side { offset, tilt, .. } => symbols.extend(offset.iter().chain(tilt).map(String::as_str)),
                Panel::End { angle, .. } => symbols.push(angle.as_str()),
            }
        }
        symbols
    }

    pub(in crate::report) fn draw(&self) -> Option<String> {
        let rows = self.panels.len().div_ceil(PANELS_PER_ROW);
        let size = (PANELS_PER_ROW * PANEL_SIZE.0 as usize, rows * PANEL_SIZE.1 as usize);
        draw_picture((size.0 as u32, size.1 as u32), |area| {
            let areas = area.split_evenly((rows, PANELS_PER_ROW));
            areas.iter().zip(&self.panels).try_for_each(|(area, panel)| panel.draw(area))
        })
    }
}

impl Panel {
    fn draw(&self, area: &Area<'_>) -> DrawResult {
        let frame = [(4, 4), (PANEL_SIZE.0 - 4, PANEL_SIZE.1 - 4)];
        area.draw(&Rectangle::new(frame, GRID_COLOUR.stroke_width(2)))?;
        match self {
            Self::Side { right, up, offset, tilt, tilts_to_the_right } => {
                draw_coordinate_axes(area, [*right, *up])?;
                let turn_deg = if *tilts_to_the_right { -DRAWN_ANGLE_DEG } else { DRAWN_ANGLE_DEG };
                let aside = if offset.is_some() { 0 } else { NOMINAL_AXIS_SHIFT_WITHOUT_OFFSET };
                let nominal = (NOMINAL_AXIS_BASE.0 + aside, NOMINAL_AXIS_BASE.1);
                draw_side_view(area, nominal, offset.as_deref(), tilt.as_deref().map(|symbol| (symbol, turn_deg)))
            }
            Self::End { right, up, angle } => {
                draw_coordinate_axes(area, [*right, *up])?;
                draw_end_view(area, END_VIEW_CENTRE, angle)
            }
        }
    }
}

/// Draws the directions of the axes in the lower left corner.
fn draw_coordinate_axes(area: &Area<'_>, [right, up]: [char; 2]) -> DrawResult {
    let corner = (22, PANEL_SIZE.1 - 22);
    let (style, reach) = (INK_COLOUR.stroke_width(2), CORNER_AXIS_LENGTH as i32);
    draw_arrow(area, corner, [CORNER_AXIS_LENGTH, 0.0], style)?;
    draw_arrow(area, corner, [0.0, CORNER_AXIS_LENGTH], style)?;
    draw_label(area, &right.to_string(), (corner.0 + reach + 8, corner.1), HPos::Left)?;
    draw_label(area, &up.to_string(), (corner.0, corner.1 - reach - 20), HPos::Center)
}

/// Draws the nominal line upwards, and the actual line at its offset and turned by the angle of the tilt, degrees
/// counter-clockwise.
fn draw_side_view(area: &Area<'_>, nominal: (i32, i32), offset: Option<&str>, tilt: Option<(&str, f64)>) -> DrawResult {
    let base = (nominal.0 + offset.map_or(0, |_| DRAWN_OFFSET as i32), nominal.1);
    let turn_deg = tilt.map_or(0.0, |(_, turn_deg)| turn_deg);
    let upright = 90.0;
    draw_dashed(area, [point_at(nominal, upright, -40.0), point_at(nominal, upright, AXIS_LINE_LENGTH)])?;
    let actual = [point_at(base, upright + turn_deg, -40.0), point_at(base, upright + turn_deg, AXIS_LINE_LENGTH)];
    area.draw(&PathElement::new(actual, FIT_COLOUR.stroke_width(5)))?;
    let top = nominal.1 - AXIS_LINE_LENGTH as i32 + 10;
    let names = if actual[1].0 < nominal.0 { ["actual", "nominal"] } else { ["nominal", "actual"] };
    draw_label(area, names[0], (nominal.0.min(actual[1].0) - 14, top), HPos::Right)?;
    draw_label(area, names[1], (nominal.0.max(actual[1].0) + 14, top), HPos::Left)?;
    if let Some(symbol) = offset {
        draw_arrow(area, nominal, [DRAWN_OFFSET, 0.0], INK_COLOUR.stroke_width(3))?;
        draw_label(
            area,
            &number::one_line_symbol(symbol),
            (nominal.0 + DRAWN_OFFSET as i32 / 2, nominal.1 + 30),
            HPos::Center,
        )?;
    }
    let Some((symbol, turn_deg)) = tilt else { return Ok(()) };
    if offset.is_some() {
        draw_dashed(area, [base, point_at(base, upright, ARC_RADIUS + 30.0)])?;
    }
    draw_arc(area, base, ARC_RADIUS, [upright, upright + turn_deg])?;
    let rightmost = upright.min(upright + turn_deg);
    let (x, y) = point_at(base, rightmost, ARC_RADIUS);
    draw_label(area, &number::one_line_symbol(symbol), (x + 16, y + 6), HPos::Left)
}

/// Draws a circle about the axis, its nominal zero position to the right, and the actual zero position.
fn draw_end_view(area: &Area<'_>, centre: (i32, i32), symbol: &str) -> DrawResult {
    let radius = 0.75 * ARC_RADIUS;
    area.draw(&Circle::new(centre, radius as i32, INK_COLOUR.stroke_width(2)))?;
    area.draw(&Circle::new(centre, 7, INK_COLOUR.filled()))?;
    draw_dashed(area, [centre, point_at(centre, 0.0, radius + 60.0)])?;
    let turned = 1.5 * DRAWN_ANGLE_DEG;
    area.draw(&PathElement::new([centre, point_at(centre, turned, radius + 60.0)], FIT_COLOUR.stroke_width(5)))?;
    draw_arc(area, centre, radius + 30.0, [0.0, turned])?;
    let (x, y) = point_at(centre, 0.5 * turned, radius + 46.0);
    draw_label(area, &number::one_line_symbol(symbol), (x, y), HPos::Left)?;
    draw_label(area, "nominal", (centre.0 + radius as i32 + 12, centre.1 + 30), HPos::Left)?;
    let (x, y) = point_at(centre, turned, radius + 60.0);
    draw_label(area, "actual", (x + 12, y - 26), HPos::Center)
}

/// Point at a distance from `from` in a direction, degrees counter-clockwise from the right.
fn point_at(from: (i32, i32), degrees: f64, distance: f64) -> (i32, i32) {
    let (sin, cos) = degrees.to_radians().sin_cos();
    (from.0 + (distance * cos).round() as i32, from.1 - (distance * sin).round() as i32)
}

fn draw_dashed(area: &Area<'_>, ends: [(i32, i32); 2]) -> DrawResult {
    let (dash, gap) = DASH_AND_GAP_LENGTH;
    area.draw(&DashedPathElement::new(ends, dash, gap, INK_COLOUR.stroke_width(3)))?;
    Ok(())
}

/// Draws an arc with an arrowhead at its end.
fn draw_arc(area: &Area<'_>, centre: (i32, i32), radius: f64, [from_deg, to_deg]: [f64; 2]) -> DrawResult {
    let at = |share: f64| point_at(centre, from_deg + share * (to_deg - from_deg), radius);
    let arc: Vec<_> = (0..=8).map(|n| at(f64::from(n) / 12.0)).collect();
    area.draw(&PathElement::new(arc, INK_COLOUR.stroke_width(3)))?;
    let (from, to) = (at(0.6), at(1.0));
    draw_arrow(area, from, [f64::from(to.0 - from.0), f64::from(from.1 - to.1)], INK_COLOUR.stroke_width(3))
}

fn draw_label(area: &Area<'_>, text: &str, at: (i32, i32), side: HPos) -> DrawResult {
    let style = text_style(FONT_SIZE).pos(Pos::new(side, VPos::Center));
    area.draw(&Text::new(text.to_owned(), at, style))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};

    use super::super::tests::{attribute_values, is_inside_picture, smallest_text_on_a_phone};
    use super::*;

    const LOCATION_ERRORS: [&str; 8] = ["EX0C", "EY0C", "EA0C", "EB0C", "EC0C", "EA0B", "EC0B", "EXX1"];

    #[test]
    fn sketch_has_a_view_for_each_direction_with_an_error() {
        assert_eq!(axes_with_location_errors(&LOCATION_ERRORS), ['B', 'C']);
        assert_eq!(axes_with_location_errors(&["EXC", "EX0C_lsc", "tool_x", ""]), Vec::<char>::new());
        assert_eq!(axes_with_location_errors(&["EX0S", "EC0Y", "EB0Z"]), ['Y', 'Z', 'S']);
        let of_c = AxisSketch::new('C', &LOCATION_ERRORS).unwrap();
        assert_eq!(of_c.symbols(), ["EX0C", "EB0C", "EY0C", "EA0C", "EC0C"]);
        assert_eq!(of_c.panels.len(), 3);
        let of_b = AxisSketch::new('B', &LOCATION_ERRORS).unwrap();
        assert_eq!(of_b.symbols(), ["EA0B", "EC0B"]);
        assert!(AxisSketch::new('A', &LOCATION_ERRORS).is_none() && AxisSketch::new('Q', &["EX0Q"]).is_none());
        for sketch in [of_c, of_b] {
            let svg = sketch.draw().unwrap();
            for symbol in sketch.symbols() {
                assert_eq!(svg.matches(&number::one_line_symbol(symbol)).count(), 1, "{symbol}");
            }
            assert!(is_inside_picture(&svg) && smallest_text_on_a_phone(&svg) >= 9.0);
        }
    }

    /// The drawn line leans to the side to which a positive rotation about the axis of the symbol turns the direction
    /// of the axis.
    #[test]
    fn tilt_has_the_sign_of_the_right_hand_rule() {
        for (along, axis) in LINEAR_AXES.into_iter().chain(ANGLES).enumerate().map(|(n, axis)| (n % 3, axis)) {
            for about in (0..3).filter(|about| *about != along) {
                let symbol = format!("E{}0{axis}", ANGLES[about]);
                let sketch = AxisSketch::new(axis, &[&symbol]).unwrap();
                let [Panel::Side { right, .. }] = sketch.panels.as_slice() else { panic!("{symbol}") };
                let right = LINEAR_AXES.iter().position(|letter| letter == right).unwrap();
                let unit = |k: usize| Vector3::from_fn(|row, _| f64::from(u8::from(row == k)));
                let turned = Rotation3::new(0.1 * unit(about)) * unit(along);
                let svg = sketch.draw().unwrap();
                let actual = svg.lines().find(|line| line.contains("stroke-width=\"5\"")).unwrap();
                let x: Vec<f64> = attribute_values(actual, "points")[0]
                    .split_whitespace()
                    .map(|pair| pair.split_once(',').unwrap().0.parse().unwrap())
                    .collect();
                assert_eq!(x[1] > x[0], turned[right] > 0.0, "{symbol}");
                assert!(turned[right].abs() > 0.09, "{symbol}");
            }
        }
    }
}
