//! Plot legend: a sample of each line with its name.

use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::{Area, DrawResult, FIT_COLOUR, GRID_COLOUR, INK_COLOUR, LINE_COLOUR, text_style};

/// Height of a row of the legend.
pub(super) const LEGEND_ROW_HEIGHT: u32 = 56;
const FONT_SIZE: f64 = 34.0;
/// Length of a line sample.
const LINE_SAMPLE_LENGTH: i32 = 70;
/// Gap between a line sample and its name.
const SAMPLE_TO_TEXT_GAP: i32 = 14;
/// Mean width of a letter, as a share of the font size.
const LETTER_WIDTH_RATIO: f64 = 0.48;
const MARKER_RADIUS: i32 = 9;
/// Opacity of a shaded area.
pub(super) const SHADE_OPACITY: f64 = 0.6;
/// Lengths of a dash and of the gap after it in a tolerance line.
pub(super) const TOLERANCE_DASH_AND_GAP_LENGTH: (i32, i32) = (40, 24);

/// Lengths of a dash and of the gap after it in the mark of a compensation.
pub(super) const COMPENSATION_DASH_AND_GAP_LENGTH: (i32, i32) = (10, 7);

/// Sample and name of a line or area.
pub(super) type LegendEntry = (LegendSymbol, String);

/// Kind of a sample in a legend.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum LegendSymbol {
    /// Band between two lines.
    ControlLimitsBand,
    /// Shaded area.
    NotIdentifiableArea,
    /// Dashed line.
    ToleranceLine,
    /// Vertical line at the time of a step.
    LevelChangeMark,
    /// Dashed vertical line at the time of a compensation.
    CompensationMark,
    /// Marker of the thermometer with this number.
    ThermometerMarker(usize),
}

/// Height of the legend in a picture of this width; 0 without entries.
pub(super) fn legend_height(entries: &[LegendEntry], left: u32, picture_width: u32) -> u32 {
    let rows = entries_with_places(entries, left, picture_width).last().map_or(0, |(_, place)| place.row + 1);
    rows * LEGEND_ROW_HEIGHT
}

/// Draws the legend; each row begins at `left`.
pub(super) fn draw_legend(area: &Area<'_>, left: u32, entries: &[LegendEntry]) -> DrawResult {
    for ((symbol, text), place) in entries_with_places(entries, left, area.dim_in_pixel().0) {
        let middle = (LEGEND_ROW_HEIGHT * place.row + LEGEND_ROW_HEIGHT / 2) as i32;
        draw_legend_symbol(area, *symbol, (place.left_x, middle))?;
        let top = middle - (0.6 * FONT_SIZE) as i32;
        area.draw_text(text, &text_style(FONT_SIZE), (place.left_x + LINE_SAMPLE_LENGTH + SAMPLE_TO_TEXT_GAP, top))?;
    }
    Ok(())
}

/// Position of an entry: its row, and the left edge of its sample.
struct LegendEntryPlace {
    row: u32,
    left_x: i32,
}

/// Entries from left to right; an entry that does not fit begins a new row.
fn entries_with_places(
    entries: &[LegendEntry],
    left: u32,
    picture_width: u32,
) -> Vec<(&LegendEntry, LegendEntryPlace)> {
    let (mut row, mut x) = (0, left as i32);
    let place = |entry| {
        let (_, text): &LegendEntry = entry;
        let text_width = (LETTER_WIDTH_RATIO * FONT_SIZE * text.chars().count() as f64) as i32;
        let width = LINE_SAMPLE_LENGTH + SAMPLE_TO_TEXT_GAP + text_width;
        if x > left as i32 && x + width > picture_width as i32 {
            (row, x) = (row + 1, left as i32);
        }
        let place = LegendEntryPlace { row, left_x: x };
        x += width + 3 * SAMPLE_TO_TEXT_GAP;
        (entry, place)
    };
    entries.iter().map(place).collect()
}

fn draw_legend_symbol(area: &Area<'_>, piece: LegendSymbol, (x, y): (i32, i32)) -> DrawResult {
    let across = |x: i32, length: i32, y: i32| vec![(x, y), (x + length, y)];
    let corners = [(x, y - 14), (x + LINE_SAMPLE_LENGTH, y + 14)];
    let middle_x = x + LINE_SAMPLE_LENGTH / 2;
    let upright = [(middle_x, y - 18), (middle_x, y + 18)];
    match piece {
        LegendSymbol::ControlLimitsBand => {
            area.draw(&Rectangle::new(corners, GRID_COLOUR.mix(0.4).filled()))?;
            for edge in [y - 14, y + 14] {
                area.draw(&PathElement::new(across(x, LINE_SAMPLE_LENGTH, edge), FIT_COLOUR.stroke_width(3)))?;
            }
        }
        LegendSymbol::NotIdentifiableArea => {
            area.draw(&Rectangle::new(corners, GRID_COLOUR.mix(SHADE_OPACITY).filled()))?;
        }
        LegendSymbol::ToleranceLine => {
            let dash = LINE_SAMPLE_LENGTH * 2 / 5;
            for begin in [x, x + LINE_SAMPLE_LENGTH - dash] {
                area.draw(&PathElement::new(across(begin, dash, y), INK_COLOUR.stroke_width(4)))?;
            }
        }
        LegendSymbol::LevelChangeMark => {
            area.draw(&PathElement::new(upright, INK_COLOUR.stroke_width(3)))?;
        }
        LegendSymbol::CompensationMark => {
            let (dash, gap) = COMPENSATION_DASH_AND_GAP_LENGTH;
            area.draw(&DashedPathElement::new(upright, dash as u32, gap as u32, FIT_COLOUR.stroke_width(4)))?;
        }
        LegendSymbol::ThermometerMarker(number) => {
            area.draw(&PathElement::new(across(x, LINE_SAMPLE_LENGTH, y), LINE_COLOUR.stroke_width(2)))?;
            draw_thermometer_marker(area, number, (middle_x, y))?;
        }
    }
    Ok(())
}

/// Draws the marker of the thermometer with this number, from 0: one of four shapes, which repeat from number 4 on.
pub(super) fn draw_thermometer_marker(area: &Area<'_>, number: usize, at: (i32, i32)) -> DrawResult {
    match number % 4 {
        0 => area.draw(&TriangleMarker::new(at, MARKER_RADIUS + 3, LINE_COLOUR.filled()))?,
        1 => area.draw(&Cross::new(at, MARKER_RADIUS, LINE_COLOUR.stroke_width(3)))?,
        2 => area.draw(&Circle::new(at, MARKER_RADIUS, LINE_COLOUR.stroke_width(3)))?,
        _ => area.draw(&Circle::new(at, MARKER_RADIUS - 4, LINE_COLOUR.filled()))?,
    }
    Ok(())
}
