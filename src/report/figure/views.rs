//! Three views of positions in space in one square picture: front (XZ) and side (YZ) above, top (XY) below the front.
//! The fourth quarter contains the scales.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Area, DrawResult, FONT_SIZE, GRID_COLOUR, INK_COLOUR, text_style};

/// Side of a view, in picture units.
pub(super) const VIEW_SIDE: i32 = 500;
pub(super) const PICTURE_SIZE: (u32, u32) = (2 * VIEW_SIDE as u32, 2 * VIEW_SIDE as u32);
/// Left and top edge of the quarter with the scales.
pub(super) const SCALES_LEFT_AND_TOP: (i32, i32) = (VIEW_SIDE, VIEW_SIDE);
/// Distance between two rows of the scales.
pub(super) const SCALE_ROW_HEIGHT: i32 = 64;
const AXIS_NAMES: [char; 3] = ['X', 'Y', 'Z'];
/// Length of the arrows of the axes in the corner of a view.
const AXIS_ARROW_LENGTH: f64 = 54.0;
const ARROWHEAD_LENGTH: f64 = 18.0;
/// Mean width of a letter, as a share of the font size.
const LETTER_WIDTH_RATIO: f64 = 0.5;

/// View onto a plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    left: i32,
    top: i32,
    /// Index of the axis to the right, and of the axis upwards.
    axes: [usize; 2],
}

/// Front (XZ), side (YZ) and top (XY).
pub(super) const VIEWS: [View; 3] = [
    View { left: 0, top: 0, axes: [0, 2] },
    View { left: VIEW_SIDE, top: 0, axes: [1, 2] },
    View { left: 0, top: VIEW_SIDE, axes: [0, 1] },
];

impl View {
    /// The components of a vector in this view: to the right and upwards.
    pub(super) fn project(&self, vector: [f64; 3]) -> [f64; 2] {
        self.axes.map(|axis| vector[axis])
    }

    /// Position in the picture of a point at this offset from the middle of the view, in picture units, upwards
    /// positive.
    pub(super) fn picture_point(&self, [right, up]: [f64; 2]) -> (i32, i32) {
        let middle = VIEW_SIDE / 2;
        (self.left + middle + right.round() as i32, self.top + middle - up.round() as i32)
    }

    /// Draws the frame, and the names and directions of the axes.
    pub(super) fn draw_frame(&self, area: &Area<'_>) -> DrawResult {
        let (left, bottom) = (self.left, self.top + VIEW_SIDE);
        let frame = [(left + 4, self.top + 4), (left + VIEW_SIDE - 4, bottom - 4)];
        area.draw(&Rectangle::new(frame, GRID_COLOUR.stroke_width(2)))?;
        let [right, up] = self.axes.map(|axis| AXIS_NAMES[axis].to_string());
        let origin = (left + 22, bottom - 22);
        let reach = AXIS_ARROW_LENGTH as i32;
        draw_arrow(area, origin, [AXIS_ARROW_LENGTH, 0.0], INK_COLOUR.stroke_width(2))?;
        draw_arrow(area, origin, [0.0, AXIS_ARROW_LENGTH], INK_COLOUR.stroke_width(2))?;
        let style = |h, v| text_style(FONT_SIZE).pos(Pos::new(h, v));
        area.draw(&Text::new(right, (origin.0 + reach + 10, origin.1), style(HPos::Left, VPos::Center)))?;
        area.draw(&Text::new(up, (origin.0, origin.1 - reach - 6), style(HPos::Center, VPos::Bottom)))?;
        Ok(())
    }
}

/// Draws a line with an arrowhead; y is positive upwards. Arrows shorter than a picture unit are left out.
pub(super) fn draw_arrow(area: &Area<'_>, from: (i32, i32), [x, y]: [f64; 2], style: ShapeStyle) -> DrawResult {
    let length = x.hypot(y);
    if length < 1.0 {
        return Ok(());
    }
    let at = |along: f64, aside: f64| {
        let (u, v) = (x / length, y / length);
        let (dx, dy) = (along * u - aside * v, along * v + aside * u);
        (from.0 + dx.round() as i32, from.1 - dy.round() as i32)
    };
    let head = ARROWHEAD_LENGTH.min(0.6 * length);
    let shaft = vec![from, at(length - 0.5 * head, 0.0)];
    area.draw(&PathElement::new(shaft, style))?;
    let back = length - head;
    let tip = vec![at(length, 0.0), at(back, 0.5 * head), at(back, -0.5 * head)];
    area.draw(&Polygon::new(tip, style.filled()))?;
    Ok(())
}

/// Labels of a picture that do not overlap.
#[derive(Default)]
pub(super) struct Labels {
    /// Left, top, right and bottom of each label.
    boxes: Vec<[i32; 4]>,
}

impl Labels {
    /// Draws the label on the left or right side of a point, or on the other side if the label would leave the view.
    /// A label that would leave the view on both sides or cover another label is omitted.
    pub(super) fn draw_beside(&mut self, area: &Area<'_>, text: &str, at: (i32, i32), is_left: bool) -> DrawResult {
        let width = (LETTER_WIDTH_RATIO * FONT_SIZE * text.chars().count() as f64) as i32;
        let view_left = at.0.div_euclid(VIEW_SIDE) * VIEW_SIDE;
        let ends = |is_left: bool| if is_left { [at.0 - width, at.0] } else { [at.0, at.0 + width] };
        let is_in_view = |is_left: &bool| ends(*is_left)[0] >= view_left && ends(*is_left)[1] <= view_left + VIEW_SIDE;
        let Some(is_left) = [is_left, !is_left].into_iter().find(is_in_view) else { return Ok(()) };
        let ([left, right], half_height) = (ends(is_left), (0.5 * FONT_SIZE) as i32);
        let own = [left, at.1 - half_height, right, at.1 + half_height];
        let overlaps =
            |other: &[i32; 4]| own[0] < other[2] && other[0] < own[2] && own[1] < other[3] && other[1] < own[3];
        if self.boxes.iter().any(overlaps) {
            return Ok(());
        }
        self.boxes.push(own);
        let side = if is_left { HPos::Right } else { HPos::Left };
        area.draw(&Text::new(text.to_owned(), at, text_style(FONT_SIZE).pos(Pos::new(side, VPos::Center))))?;
        Ok(())
    }
}
