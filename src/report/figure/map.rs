//! Maps of values over two axes, cell by cell, all with one colour scale.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Area, Drawn, FIT, GRID, picture, text_style};
use crate::report::number;

/// Side of the square field of cells, and margins for the names of its rows and columns.
const FIELD: i32 = 560;
const LEFT: i32 = 120;
const TOP: i32 = 56;
const FOOT: i32 = 92;
const RIGHT: i32 = 8;
const SIZE: (u32, u32) = ((LEFT + FIELD + RIGHT) as u32, (TOP + FIELD + FOOT) as u32);
const FONT: f64 = 24.0;

/// Values of a slice, in µm.
#[derive(Debug, Clone)]
pub struct ErrorMap {
    pub title: String,
    /// Name of the axis with its unit, and its positions, from left to right and upwards.
    pub across: (String, Vec<f64>),
    pub up: (String, Vec<f64>),
    /// Name and values of each panel, row by row upwards.
    pub panels: [(String, Vec<Vec<f64>>); 2],
}

impl ErrorMap {
    pub fn largest(&self) -> f64 {
        let values = self.panels.iter().flat_map(|(_, rows)| rows.iter().flatten());
        values.copied().filter(|value| value.is_finite()).fold(0.0, f64::max)
    }

    /// Draws each panel; the value `largest` has the full colour. `None` without a cell.
    pub(in crate::report) fn draw(&self, largest: f64) -> [Option<String>; 2] {
        let is_empty = self.across.1.is_empty() || self.up.1.is_empty() || largest <= 0.0;
        self.panels.each_ref().map(|(name, rows)| {
            let panel = |area: &Area<'_>| {
                self.names(area, name)?;
                self.cells(area, rows, largest)
            };
            (!is_empty).then(|| picture(SIZE, panel)).flatten()
        })
    }

    /// Position of the n-th edge of columns or rows.
    fn edge(n: usize, of: usize) -> i32 {
        (f64::from(FIELD) * n as f64 / of as f64).round() as i32
    }

    fn cells(&self, area: &Area<'_>, rows: &[Vec<f64>], largest: f64) -> Drawn {
        let (columns, count) = (self.across.1.len(), self.up.1.len());
        let greatest = rows.iter().flatten().copied().fold(0.0, f64::max);
        let decimals = if greatest < 10.0 { 1 } else { 0 };
        let middle = text_style(FONT).pos(Pos::new(HPos::Center, VPos::Center));
        for (j, row) in rows.iter().enumerate().take(count) {
            let (low, high) =
                (TOP + FIELD - Self::edge(j, count), TOP + FIELD - Self::edge(j + 1, count));
            for (i, value) in row.iter().enumerate().take(columns).filter(|(_, v)| v.is_finite()) {
                let (from, to) = (LEFT + Self::edge(i, columns), LEFT + Self::edge(i + 1, columns));
                let share = (value / largest).clamp(0.0, 1.0);
                let corners = [(from, high), (to, low)];
                area.draw(&Rectangle::new(corners, FIT.mix(0.8 * share).filled()))?;
                area.draw(&Rectangle::new(corners, GRID.stroke_width(1)))?;
                let text = number::fixed(*value, decimals);
                let place = ((from + to) / 2, (low + high) / 2);
                area.draw(&Text::new(text, place, middle.clone()))?;
            }
        }
        Ok(())
    }

    /// Draws the names: of the panel above it, of rows on the left and of columns below.
    fn names(&self, area: &Area<'_>, name: &str) -> Drawn {
        let style = |h, v| text_style(FONT).pos(Pos::new(h, v));
        let above = (LEFT, TOP - 14);
        area.draw(&Text::new(name.to_owned(), above, style(HPos::Left, VPos::Bottom)))?;
        let (across, columns) = (&self.across.0, &self.across.1);
        let (up, rows) = (&self.up.0, &self.up.1);
        let middle = |n: usize, of: usize| (Self::edge(n, of) + Self::edge(n + 1, of)) / 2;
        for (n, value) in columns.iter().enumerate() {
            let place = (LEFT + middle(n, columns.len()), TOP + FIELD + 12);
            let text = number::fixed(*value, 0);
            area.draw(&Text::new(text, place, style(HPos::Center, VPos::Top)))?;
        }
        for (n, value) in rows.iter().enumerate() {
            let place = (LEFT - 12, TOP + FIELD - middle(n, rows.len()));
            let text = number::fixed(*value, 0);
            area.draw(&Text::new(text, place, style(HPos::Right, VPos::Center)))?;
        }
        let below = (LEFT + FIELD / 2, TOP + FIELD + 48);
        area.draw(&Text::new(across.clone(), below, style(HPos::Center, VPos::Top)))?;
        area.draw(&Text::new(up.clone(), (LEFT - 12, TOP - 14), style(HPos::Right, VPos::Bottom)))?;
        Ok(())
    }
}
