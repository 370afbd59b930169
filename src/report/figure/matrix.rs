//! Correlation matrix: the correlation of two results as a colour.

use plotters::prelude::*;
use plotters::style::FontTransform;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Area, DrawResult, FIT_COLOUR, GRID_COLOUR, LINE_COLOUR, draw_picture, text_style};
use crate::report::number;
use machine::record::estimate::ParameterCovariance;

/// Numbers of results with a picture: fewer need none, more cannot be read.
const RESULT_COUNTS_WITH_MATRIX: std::ops::RangeInclusive<usize> = 3..=60;
const PICTURE_SIDE: i32 = 1500;
/// Mean width of a letter, as a share of the font size.
const LETTER_WIDTH_RATIO: f64 = 0.56;
/// Minimum magnitude of a coefficient whose cell is drawn.
const MIN_DRAWN_CORRELATION: f64 = 0.02;
const COLOUR_SCALE_HEIGHT: i32 = 110;

/// Correlation coefficient of `i` and `j`, −1 to 1; `None` if one of them has no variance.
pub(in crate::report) fn correlation_coefficient(covariance: &ParameterCovariance, i: usize, j: usize) -> Option<f64> {
    let at = |i: usize, j: usize| covariance.rows.get(i)?.get(j).copied();
    let coefficient = at(i, j)? / (at(i, i)? * at(j, j)?).sqrt();
    coefficient.is_finite().then(|| coefficient.clamp(-1.0, 1.0))
}

/// Draws the matrix; `None` unless there are 3 to 60 names.
pub(in crate::report) fn draw_matrix(covariance: &ParameterCovariance) -> Option<String> {
    let names: Vec<String> = covariance.symbols.iter().map(|s| number::one_line_symbol(s)).collect();
    RESULT_COUNTS_WITH_MATRIX.contains(&names.len()).then_some(())?;
    let layout = MatrixLayout::for_names(&names);
    draw_picture((PICTURE_SIDE as u32, PICTURE_SIDE as u32), |area| {
        for (i, name) in names.iter().enumerate() {
            layout.draw_name(area, i, name)?;
            for j in 0..names.len() {
                layout.draw_cell(area, [i, j], correlation_coefficient(covariance, i, j))?;
            }
        }
        layout.draw_colour_scale(area)
    })
}

struct MatrixLayout {
    /// Left and top position of the cells.
    cells_left_and_top: i32,
    cell_side: f64,
    font_size: f64,
}

impl MatrixLayout {
    fn for_names(names: &[String]) -> Self {
        let longest = names.iter().map(|name| name.chars().count()).max().unwrap_or(1).min(24);
        let count = names.len() as f64;
        // Cell and font depend on each other: font = 0.8·cell, begin = letters·font.
        let letters = LETTER_WIDTH_RATIO * longest as f64 + 0.7;
        let cell = (f64::from(PICTURE_SIDE - COLOUR_SCALE_HEIGHT) / (count + 0.8 * letters)).min(70.0);
        let font = (0.8 * cell).min(34.0);
        Self { cells_left_and_top: (letters * font) as i32, cell_side: cell, font_size: font }
    }

    fn cell_start(&self, n: usize) -> i32 {
        self.cells_left_and_top + (n as f64 * self.cell_side).round() as i32
    }

    /// Draws a name to the left of its row and above its column.
    fn draw_name(&self, area: &Area<'_>, n: usize, name: &str) -> DrawResult {
        let middle = (self.cell_start(n) + self.cell_start(n + 1)) / 2;
        let before = self.cells_left_and_top - (0.35 * self.font_size) as i32;
        let style = text_style(self.font_size);
        let row = style.clone().pos(Pos::new(HPos::Right, VPos::Center));
        area.draw(&Text::new(name.to_owned(), (before, middle), row))?;
        let turned = style.transform(FontTransform::Rotate270);
        let column = turned.pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(name.to_owned(), (middle, before), column))?;
        Ok(())
    }

    fn draw_cell(&self, area: &Area<'_>, [i, j]: [usize; 2], value: Option<f64>) -> DrawResult {
        let corners =
            [(self.cell_start(j), self.cell_start(i)), (self.cell_start(j + 1) - 1, self.cell_start(i + 1) - 1)];
        match value {
            _ if i == j => area.draw(&Rectangle::new(corners, GRID_COLOUR.filled()))?,
            Some(value) => draw_tile(area, corners, value)?,
            None => area.draw(&Rectangle::new(corners, GRID_COLOUR.stroke_width(1)))?,
        }
        Ok(())
    }

    /// Draws the colour scale with its labels below the matrix.
    fn draw_colour_scale(&self, area: &Area<'_>) -> DrawResult {
        let (top, wide) = (PICTURE_SIDE - 66, 64);
        let style = text_style(30.0).pos(Pos::new(HPos::Center, VPos::Center));
        for n in -5..=5 {
            let left = self.cells_left_and_top.max(60) + (n + 5) * wide;
            draw_tile(area, [(left, top), (left + wide - 2, top + 24)], f64::from(n) / 5.0)?;
            if n % 5 == 0 {
                let label = number::format_fixed(f64::from(n) / 5.0, 0);
                let place = (left + wide / 2, top + 46);
                area.draw(&Text::new(label, place, style.clone()))?;
            }
        }
        Ok(())
    }
}

/// Draws a tile: one colour per sign, more opaque for a larger magnitude.
fn draw_tile(area: &Area<'_>, corners: [(i32, i32); 2], value: f64) -> DrawResult {
    if value.abs() >= MIN_DRAWN_CORRELATION {
        let colour = if value < 0.0 { LINE_COLOUR } else { FIT_COLOUR };
        area.draw(&Rectangle::new(corners, colour.mix(value.abs()).filled()))?;
    }
    Ok(())
}
