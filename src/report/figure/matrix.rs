//! Correlation matrix: the correlation coefficient of each pair as a number and as a colour.

use plotters::prelude::*;
use plotters::style::FontTransform;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Area, DrawResult, FIT_COLOUR, GRID_COLOUR, LINE_COLOUR, draw_picture, text_style};
use crate::report::number;
use machine::record::estimate::ParameterCovariance;

/// Coefficients below this magnitude are not written, and their cells have no colour.
pub(in crate::report) const MIN_SHOWN_COEFFICIENT: f64 = 0.05;
const PICTURE_WIDTH: i32 = 1000;
/// Largest side of a cell.
const MAX_CELL_SIDE: f64 = 110.0;
/// Size of names and numbers; the smallest that is 9 px high on a phone.
const FONT_SIZE: f64 = 34.0;
/// Minimum side of a cell for a coefficient with two decimals.
const MIN_CELL_SIDE_OF_TWO_DECIMALS: f64 = 76.0;
/// Mean width of a letter, as a share of the font size.
const LETTER_WIDTH_RATIO: f64 = 0.5;
/// Opacity of a cell with the coefficient ±1. The number in the cell stays legible.
const MAX_CELL_OPACITY: f64 = 0.6;

/// Correlation coefficient of `i` and `j`, −1 to 1; `None` if one of them has no variance.
pub(in crate::report) fn correlation_coefficient(covariance: &ParameterCovariance, i: usize, j: usize) -> Option<f64> {
    let at = |i: usize, j: usize| covariance.rows.get(i)?.get(j).copied();
    let coefficient = at(i, j)? / (at(i, i)? * at(j, j)?).sqrt();
    coefficient.is_finite().then(|| coefficient.clamp(-1.0, 1.0))
}

/// Draws the lower triangle of the matrix of the parameters with these indices; `None` for less than two.
pub(in crate::report) fn draw_matrix(covariance: &ParameterCovariance, indices: &[usize]) -> Option<String> {
    let symbols = indices.iter().filter_map(|n| covariance.symbols.get(*n));
    let names: Vec<String> = symbols.map(|symbol| number::one_line_symbol(symbol)).collect();
    (names.len() == indices.len() && names.len() > 1).then_some(())?;
    let layout = MatrixLayout::for_names(&names);
    draw_picture(layout.picture_size(names.len()), |area| {
        let cells = || (0..indices.len()).flat_map(|row| (0..row).map(move |column| [row, column]));
        let coefficient = |cell: [usize; 2]| {
            let [i, j] = cell.map(|n| indices[n]);
            correlation_coefficient(covariance, i, j)
        };
        cells().try_for_each(|cell| layout.draw_cell(area, cell, coefficient(cell)))?;
        cells().try_for_each(|cell| layout.draw_coefficient(area, cell, coefficient(cell)))?;
        names.iter().enumerate().skip(1).try_for_each(|(row, name)| layout.draw_row_name(area, row, name))?;
        let last = names.len() - 1;
        let mut columns = names.iter().take(last).enumerate();
        columns.try_for_each(|(column, name)| layout.draw_column_name(area, column, last, name))
    })
}

/// Layout of the lower triangle; indices of rows and columns count the drawn parameters, from 0.
struct MatrixLayout {
    /// Left edge of the cells.
    cells_left: i32,
    cell_side: f64,
    /// Room for the longest name: width of the names of the rows, height of the names of the columns.
    name_length: i32,
}

impl MatrixLayout {
    /// Rows begin with the second parameter, columns end before the last.
    fn for_names(names: &[String]) -> Self {
        let longest = names.iter().map(|name| name.chars().count()).max().unwrap_or(1);
        let name_length = (LETTER_WIDTH_RATIO * FONT_SIZE * longest as f64) as i32 + 16;
        let cell_side = f64::from(PICTURE_WIDTH - name_length) / (names.len() - 1) as f64;
        Self { cells_left: name_length, cell_side: cell_side.min(MAX_CELL_SIDE), name_length }
    }

    fn picture_size(&self, name_count: usize) -> (u32, u32) {
        let height = self.row_top(name_count) + self.name_length;
        (PICTURE_WIDTH as u32, height as u32)
    }

    /// Top of the row with this index; the row of parameter 0 is not drawn.
    fn row_top(&self, row: usize) -> i32 {
        ((row as f64 - 1.0) * self.cell_side).round() as i32
    }

    fn column_left(&self, column: usize) -> i32 {
        self.cells_left + (column as f64 * self.cell_side).round() as i32
    }

    fn middle(&self, [row, column]: [usize; 2]) -> (i32, i32) {
        let x = (self.column_left(column) + self.column_left(column + 1)) / 2;
        (x, (self.row_top(row) + self.row_top(row + 1)) / 2)
    }

    fn draw_row_name(&self, area: &Area<'_>, row: usize, name: &str) -> DrawResult {
        let style = text_style(FONT_SIZE).pos(Pos::new(HPos::Right, VPos::Center));
        area.draw(&Text::new(name.to_owned(), (self.cells_left - 10, self.middle([row, 0]).1), style))?;
        Ok(())
    }

    /// Draws the name of a column below its last row.
    fn draw_column_name(&self, area: &Area<'_>, column: usize, last_row: usize, name: &str) -> DrawResult {
        let turned = text_style(FONT_SIZE).transform(FontTransform::Rotate270);
        let style = turned.pos(Pos::new(HPos::Right, VPos::Center));
        let place = (self.middle([last_row, column]).0, self.row_top(last_row + 1) + 10);
        area.draw(&Text::new(name.to_owned(), place, style))?;
        Ok(())
    }

    /// Draws the cell: one colour for each sign, more opaque for a larger magnitude.
    fn draw_cell(&self, area: &Area<'_>, [row, column]: [usize; 2], value: Option<f64>) -> DrawResult {
        let corners = [
            (self.column_left(column), self.row_top(row)),
            (self.column_left(column + 1) - 1, self.row_top(row + 1) - 1),
        ];
        let value = value.filter(|value| self.coefficient_text(*value).is_some()).unwrap_or(0.0);
        let colour = if value < 0.0 { LINE_COLOUR } else { FIT_COLOUR };
        // Ten steps of opacity: neighbours of equal opacity share one path of the report.
        let opacity = MAX_CELL_OPACITY * (10.0 * value.abs()).round() / 10.0;
        if opacity > 0.0 {
            area.draw(&Rectangle::new(corners, colour.mix(opacity).filled()))?;
        }
        area.draw(&Rectangle::new(corners, GRID_COLOUR.stroke_width(1)))?;
        Ok(())
    }

    fn draw_coefficient(&self, area: &Area<'_>, cell: [usize; 2], value: Option<f64>) -> DrawResult {
        if let Some(text) = value.and_then(|value| self.coefficient_text(value)) {
            let style = text_style(FONT_SIZE).pos(Pos::new(HPos::Center, VPos::Center));
            area.draw(&Text::new(text, self.middle(cell), style))?;
        }
        Ok(())
    }

    /// The coefficient with as many decimals as the cell has room for; `None` below [`MIN_SHOWN_COEFFICIENT`].
    fn coefficient_text(&self, value: f64) -> Option<String> {
        let decimals = if self.cell_side >= MIN_CELL_SIDE_OF_TWO_DECIMALS { 2 } else { 1 };
        // A correlation that is not exactly ±1 is not shown as ±1.
        let limit = 1.0 - 10f64.powi(-(decimals as i32));
        let shown = if value.abs() < 1.0 { value.clamp(-limit, limit) } else { value };
        (value.abs() >= MIN_SHOWN_COEFFICIENT).then(|| number::format_fixed(shown, decimals))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{attribute_values, is_inside_picture, smallest_text_on_a_phone};
    use super::*;

    fn covariance_with_entries(count: usize, entry: impl Fn(usize, usize) -> f64) -> ParameterCovariance {
        ParameterCovariance {
            symbols: (0..count).map(|n| format!("ball_{n}_x")).collect(),
            rows: (0..count).map(|i| (0..count).map(|j| entry(i, j)).collect()).collect(),
        }
    }

    fn texts(svg: &str) -> Vec<&str> {
        svg.split("<text").skip(1).filter_map(|text| text.split('\n').nth(1)).collect()
    }

    /// Variances 4 and 9 with covariance −3 give the correlation −0.5. Colour and opacity show sign and magnitude.
    #[test]
    fn cell_shows_sign_and_magnitude() {
        let known = [[4.0, -3.0, 0.0], [-3.0, 9.0, 2.25], [0.0, 2.25, 1.0]];
        let three = covariance_with_entries(3, |i, j| known[i][j]);
        assert_eq!(correlation_coefficient(&three, 0, 1), Some(-0.5));
        assert_eq!(correlation_coefficient(&three, 2, 1), Some(0.75));
        let svg = draw_matrix(&three, &[0, 1, 2]).unwrap();
        let tiles: Vec<&str> =
            svg.lines().filter(|line| line.contains("<rect") && line.contains("stroke=\"none\"")).collect();
        let [negative, positive] = tiles.as_slice() else { panic!("{tiles:?}") };
        assert!(negative.contains("#1F6FB2") && positive.contains("#C2571A"));
        let opacity = |tile: &str| attribute_values(tile, "opacity")[0].parse::<f64>().unwrap();
        assert!((opacity(negative) / opacity(positive) - 5.0 / 8.0).abs() < 1e-9);
        // Below the diagonal: two coefficients; names of the last two rows and the first two columns.
        assert_eq!(texts(&svg), ["−0.50", "0.75", "ball_1,x", "ball_2,x", "ball_0,x", "ball_1,x"]);
        assert!(is_inside_picture(&svg));
    }

    #[test]
    fn matrix_is_drawn_for_the_given_parameters() {
        let unit = |i: usize, j: usize| if i == j { 1.0 } else { 0.9999 };
        let all = covariance_with_entries(20, unit);
        for count in [2, 8, 15] {
            let indices: Vec<usize> = (0..count).collect();
            let svg = draw_matrix(&all, &indices).unwrap();
            assert!(smallest_text_on_a_phone(&svg) >= 9.0, "{count}: {}", smallest_text_on_a_phone(&svg));
            // 1.0 would claim that one parameter follows from the other.
            assert!(texts(&svg).iter().all(|text| *text != "1.0" && *text != "1.00"));
        }
        let svg = draw_matrix(&all, &[3, 17]).unwrap();
        assert_eq!(texts(&svg), ["0.99", "ball_17,x", "ball_3,x"]);
        assert_eq!(draw_matrix(&all, &[1]), None);
        assert_eq!(draw_matrix(&all, &[1, 99]), None);
        let mut holes = covariance_with_entries(4, |i, j| if i == j { 0.0 } else { f64::NAN });
        holes.rows.truncate(3);
        assert_eq!(correlation_coefficient(&holes, 0, 0), None);
        assert!(is_inside_picture(&draw_matrix(&holes, &[0, 1, 2, 3]).unwrap()));
    }
}
