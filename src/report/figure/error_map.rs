//! Maps of values over two axes, cell by cell, all with one colour scale.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Area, DrawResult, FIT_COLOUR, GRID_COLOUR, draw_picture, text_style};
use crate::report::number;

/// Side of the square field of cells, and margins for the names of its rows and columns.
const CELL_FIELD_SIDE: i32 = 560;
const LEFT_MARGIN: i32 = 120;
const TOP_MARGIN: i32 = 56;
const BOTTOM_MARGIN: i32 = 92;
const RIGHT_MARGIN: i32 = 8;
const PICTURE_SIZE: (u32, u32) =
    ((LEFT_MARGIN + CELL_FIELD_SIDE + RIGHT_MARGIN) as u32, (TOP_MARGIN + CELL_FIELD_SIDE + BOTTOM_MARGIN) as u32);
const FONT_SIZE: f64 = 24.0;

/// Opacity of a cell with the largest value.
const MAX_CELL_OPACITY: f64 = 0.8;
/// Number of steps of the colour scale.
const COLOUR_STEP_COUNT: f64 = 20.0;

/// A cell in the picture.
struct Cell {
    /// Top left and bottom right.
    corners: [(i32, i32); 2],
    /// Error, µm.
    value: f64,
    /// 0 to [`COLOUR_STEP_COUNT`].
    colour_step: u8,
}

/// Predicted errors of the tool tip in one slice of the volume, µm.
#[derive(Debug, Clone)]
pub struct ErrorMap {
    pub title: String,
    /// Name of the axis with its unit, and its positions, from left to right.
    pub horizontal_axis: (String, Vec<f64>),
    /// Name of the axis with its unit, and its positions, upwards.
    pub vertical_axis: (String, Vec<f64>),
    /// Name and values of each panel, row by row upwards: the length of the error of the tip, then U (k = 2) of the
    /// error that remains after a correction.
    pub panels: [(String, Vec<Vec<f64>>); 2],
}

impl ErrorMap {
    /// Largest finite value of both panels; 0 without one.
    pub fn max_value(&self) -> f64 {
        let values = self.panels.iter().flat_map(|(_, rows)| rows.iter().flatten());
        values.copied().filter(|value| value.is_finite()).fold(0.0, f64::max)
    }

    /// Draws each panel; a cell with the value `largest` has the full colour. `None` without a cell, or if `largest` is
    /// not above 0.
    pub(in crate::report) fn draw(&self, largest: f64) -> [Option<String>; 2] {
        let is_empty = self.horizontal_axis.1.is_empty() || self.vertical_axis.1.is_empty() || largest <= 0.0;
        self.panels.each_ref().map(|(name, rows)| {
            let panel = |area: &Area<'_>| {
                self.draw_panel_and_axis_names(area, name)?;
                self.draw_cells(area, rows, largest)
            };
            (!is_empty).then(|| draw_picture(PICTURE_SIZE, panel)).flatten()
        })
    }

    /// Position of an edge of the columns or rows, from 0.
    fn cell_edge(edge_index: usize, cell_count: usize) -> i32 {
        (f64::from(CELL_FIELD_SIDE) * edge_index as f64 / cell_count as f64).round() as i32
    }

    fn draw_cells(&self, area: &Area<'_>, rows: &[Vec<f64>], largest: f64) -> DrawResult {
        let greatest = rows.iter().flatten().copied().fold(0.0, f64::max);
        let decimals = if greatest < 10.0 { 1 } else { 0 };
        let mut cells = self.cells(rows, largest);
        // Cells of one colour share one path of the report.
        cells.sort_by_key(|cell| cell.colour_step);
        for cell in cells.iter().filter(|cell| cell.colour_step > 0) {
            let opacity = MAX_CELL_OPACITY * f64::from(cell.colour_step) / COLOUR_STEP_COUNT;
            area.draw(&Rectangle::new(cell.corners, FIT_COLOUR.mix(opacity).filled()))?;
        }
        cells.iter().try_for_each(|cell| area.draw(&Rectangle::new(cell.corners, GRID_COLOUR.stroke_width(1))))?;
        let middle = text_style(FONT_SIZE).pos(Pos::new(HPos::Center, VPos::Center));
        for Cell { corners: [(left, top), (right, bottom)], value, .. } in cells {
            let place = ((left + right) / 2, (top + bottom) / 2);
            area.draw(&Text::new(number::format_fixed(value, decimals), place, middle.clone()))?;
        }
        Ok(())
    }

    /// Cells with a finite value.
    fn cells(&self, rows: &[Vec<f64>], largest: f64) -> Vec<Cell> {
        let (columns, count) = (self.horizontal_axis.1.len(), self.vertical_axis.1.len());
        let bottom = TOP_MARGIN + CELL_FIELD_SIDE;
        let row_cells = rows.iter().enumerate().take(count).map(|(j, row)| {
            let [low, high] = [j, j + 1].map(|edge| bottom - Self::cell_edge(edge, count));
            let finite = row.iter().enumerate().take(columns).filter(|(_, value)| value.is_finite());
            let cell = move |(i, value): (usize, &f64)| {
                let [from, to] = [i, i + 1].map(|edge| LEFT_MARGIN + Self::cell_edge(edge, columns));
                let colour_step = (COLOUR_STEP_COUNT * (value / largest).clamp(0.0, 1.0)).round() as u8;
                Cell { corners: [(from, high), (to, low)], value: *value, colour_step }
            };
            finite.map(cell)
        });
        row_cells.flatten().collect()
    }

    /// Draws the names: of the panel above it, of rows on the left and of columns below.
    fn draw_panel_and_axis_names(&self, area: &Area<'_>, name: &str) -> DrawResult {
        let style = |h, v| text_style(FONT_SIZE).pos(Pos::new(h, v));
        let above = (LEFT_MARGIN, TOP_MARGIN - 14);
        area.draw(&Text::new(name.to_owned(), above, style(HPos::Left, VPos::Bottom)))?;
        let (horizontal, columns) = (&self.horizontal_axis.0, &self.horizontal_axis.1);
        let (vertical, rows) = (&self.vertical_axis.0, &self.vertical_axis.1);
        let middle = |n: usize, of: usize| (Self::cell_edge(n, of) + Self::cell_edge(n + 1, of)) / 2;
        for (n, value) in columns.iter().enumerate() {
            let place = (LEFT_MARGIN + middle(n, columns.len()), TOP_MARGIN + CELL_FIELD_SIDE + 12);
            let text = number::format_fixed(*value, 0);
            area.draw(&Text::new(text, place, style(HPos::Center, VPos::Top)))?;
        }
        for (n, value) in rows.iter().enumerate() {
            let place = (LEFT_MARGIN - 12, TOP_MARGIN + CELL_FIELD_SIDE - middle(n, rows.len()));
            let text = number::format_fixed(*value, 0);
            area.draw(&Text::new(text, place, style(HPos::Right, VPos::Center)))?;
        }
        let below = (LEFT_MARGIN + CELL_FIELD_SIDE / 2, TOP_MARGIN + CELL_FIELD_SIDE + 48);
        area.draw(&Text::new(horizontal.clone(), below, style(HPos::Center, VPos::Top)))?;
        area.draw(&Text::new(vertical.clone(), (LEFT_MARGIN - 12, TOP_MARGIN - 14), style(HPos::Right, VPos::Bottom)))?;
        Ok(())
    }
}
