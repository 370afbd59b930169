//! Plot legend: a sample of each line with its name.

use plotters::prelude::*;

use super::{Area, DrawResult, FIT_COLOUR, GRID_COLOUR, INK_COLOUR, LINE_COLOUR, text_style};

/// Height of the legend row.
pub(super) const LEGEND_ROW_HEIGHT: u32 = 56;
const FONT_SIZE: f64 = 30.0;
/// Length of a line sample.
const LINE_SAMPLE_LENGTH: i32 = 70;
/// Gap between a line sample and its name.
const SAMPLE_TO_TEXT_GAP: i32 = 14;
/// Mean width of a letter, as a share of the font size.
const LETTER_WIDTH_RATIO: f64 = 0.54;
const MARKER_RADIUS: i32 = 9;
/// Opacity of a shaded area.
pub(super) const SHADE_OPACITY: f64 = 0.6;
/// Length and gap of the dashes of a line.
pub(super) const DASH_AND_GAP_LENGTH: (i32, i32) = (40, 24);

/// Sample in a legend: what it shows in the chart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum LegendSymbol {
    /// Band between two lines.
    Band,
    /// Shaded area.
    ShadedArea,
    /// Dashed line.
    DashedLine,
    /// Vertical line at the time of a step.
    StepMark,
    /// Marker of the thermometer with this number.
    ThermometerMarker(usize),
}

/// Draws one row that begins at `left`.
pub(super) fn draw_legend(area: &Area<'_>, left: u32, entries: &[(LegendSymbol, String)]) -> DrawResult {
    let (mut x, middle) = (left as i32, LEGEND_ROW_HEIGHT as i32 / 2);
    for (piece, text) in entries {
        draw_legend_symbol(area, *piece, (x, middle))?;
        x += LINE_SAMPLE_LENGTH + SAMPLE_TO_TEXT_GAP;
        let top = middle - (0.6 * FONT_SIZE) as i32;
        area.draw_text(text, &text_style(FONT_SIZE), (x, top))?;
        x += (LETTER_WIDTH_RATIO * FONT_SIZE * text.chars().count() as f64) as i32 + 3 * SAMPLE_TO_TEXT_GAP;
    }
    Ok(())
}

fn draw_legend_symbol(area: &Area<'_>, piece: LegendSymbol, (x, y): (i32, i32)) -> DrawResult {
    let across = |x: i32, length: i32, y: i32| vec![(x, y), (x + length, y)];
    match piece {
        LegendSymbol::Band => {
            area.draw(&Rectangle::new([(x, y - 14), (x + LINE_SAMPLE_LENGTH, y + 14)], GRID_COLOUR.mix(0.4).filled()))?;
            for edge in [y - 14, y + 14] {
                area.draw(&PathElement::new(across(x, LINE_SAMPLE_LENGTH, edge), FIT_COLOUR.stroke_width(3)))?;
            }
        }
        LegendSymbol::ShadedArea => {
            let corners = [(x, y - 14), (x + LINE_SAMPLE_LENGTH, y + 14)];
            area.draw(&Rectangle::new(corners, GRID_COLOUR.mix(SHADE_OPACITY).filled()))?;
        }
        LegendSymbol::DashedLine => {
            let dash = LINE_SAMPLE_LENGTH * 2 / 5;
            for begin in [x, x + LINE_SAMPLE_LENGTH - dash] {
                area.draw(&PathElement::new(across(begin, dash, y), INK_COLOUR.stroke_width(4)))?;
            }
        }
        LegendSymbol::StepMark => {
            let line = vec![(x + LINE_SAMPLE_LENGTH / 2, y - 18), (x + LINE_SAMPLE_LENGTH / 2, y + 18)];
            area.draw(&PathElement::new(line, INK_COLOUR.stroke_width(3)))?;
        }
        LegendSymbol::ThermometerMarker(number) => {
            area.draw(&PathElement::new(across(x, LINE_SAMPLE_LENGTH, y), LINE_COLOUR.stroke_width(2)))?;
            draw_thermometer_marker(area, number, (x + LINE_SAMPLE_LENGTH / 2, y))?;
        }
    }
    Ok(())
}

/// Draws the marker of the thermometer with this number; markers differ in shape.
pub(super) fn draw_thermometer_marker(area: &Area<'_>, number: usize, at: (i32, i32)) -> DrawResult {
    match number % 4 {
        0 => area.draw(&TriangleMarker::new(at, MARKER_RADIUS + 3, LINE_COLOUR.filled()))?,
        1 => area.draw(&Cross::new(at, MARKER_RADIUS, LINE_COLOUR.stroke_width(3)))?,
        2 => area.draw(&Circle::new(at, MARKER_RADIUS, LINE_COLOUR.stroke_width(3)))?,
        _ => area.draw(&Circle::new(at, MARKER_RADIUS - 4, LINE_COLOUR.filled()))?,
    }
    Ok(())
}
