//! Plot legend: a sample of each line with its name.

use plotters::prelude::*;

use super::{Area, Drawn, FIT, GRID, INK, LINE, text_style};

/// Height of the legend row.
pub(super) const ROW: u32 = 56;
const FONT: f64 = 30.0;
/// Length of a line sample, and gap between the sample and its name.
const PIECE: i32 = 70;
const GAP: i32 = 14;
/// Mean width of a letter, as a share of the font size.
const LETTER: f64 = 0.54;
const MARKER: i32 = 9;
/// Opacity of a shaded area.
pub(super) const SHADE: f64 = 0.6;
/// Length and gap of the dashes of a line.
pub(super) const DASH: (i32, i32) = (40, 24);

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Piece {
    /// Band between two lines.
    Band,
    Shaded,
    Dashed,
    ToolSweep,
    /// Marker of the thermometer with this number.
    Marker(usize),
}

/// Draws one row that begins at `left`.
pub(super) fn row(area: &Area<'_>, left: u32, told: &[(Piece, String)]) -> Drawn {
    let (mut x, middle) = (left as i32, ROW as i32 / 2);
    for (piece, words) in told {
        draw(area, *piece, (x, middle))?;
        x += PIECE + GAP;
        let top = middle - (0.6 * FONT) as i32;
        area.draw_text(words, &text_style(FONT), (x, top))?;
        x += (LETTER * FONT * words.chars().count() as f64) as i32 + 3 * GAP;
    }
    Ok(())
}

fn draw(area: &Area<'_>, piece: Piece, (x, y): (i32, i32)) -> Drawn {
    let across = |x: i32, length: i32, y: i32| vec![(x, y), (x + length, y)];
    match piece {
        Piece::Band => {
            area.draw(&Rectangle::new([(x, y - 14), (x + PIECE, y + 14)], GRID.mix(0.4).filled()))?;
            for edge in [y - 14, y + 14] {
                area.draw(&PathElement::new(across(x, PIECE, edge), FIT.stroke_width(3)))?;
            }
        }
        Piece::Shaded => {
            let corners = [(x, y - 14), (x + PIECE, y + 14)];
            area.draw(&Rectangle::new(corners, GRID.mix(SHADE).filled()))?;
        }
        Piece::Dashed => {
            let dash = PIECE * 2 / 5;
            for begin in [x, x + PIECE - dash] {
                area.draw(&PathElement::new(across(begin, dash, y), INK.stroke_width(4)))?;
            }
        }
        Piece::ToolSweep => {
            let line = vec![(x + PIECE / 2, y - 18), (x + PIECE / 2, y + 18)];
            area.draw(&PathElement::new(line, INK.stroke_width(3)))?;
        }
        Piece::Marker(number) => {
            area.draw(&PathElement::new(across(x, PIECE, y), LINE.stroke_width(2)))?;
            marker(area, number, (x + PIECE / 2, y))?;
        }
    }
    Ok(())
}

/// Draws the marker of the thermometer with this number; markers differ in shape.
pub(super) fn marker(area: &Area<'_>, number: usize, at: (i32, i32)) -> Drawn {
    match number % 4 {
        0 => area.draw(&TriangleMarker::new(at, MARKER + 3, LINE.filled()))?,
        1 => area.draw(&Cross::new(at, MARKER, LINE.stroke_width(3)))?,
        2 => area.draw(&Circle::new(at, MARKER, LINE.stroke_width(3)))?,
        _ => area.draw(&Circle::new(at, MARKER - 4, LINE.filled()))?,
    }
    Ok(())
}
