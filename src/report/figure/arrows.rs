//! Vectors at positions in space: three views of each group, all groups of a figure at one scale.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::ticked_axis::{round_up_to_1_2_or_5, tick_label, value_bounds};
use super::{Area, DrawResult, FIT_COLOUR, FONT_SIZE, GRID_COLOUR, INK_COLOUR, LINE_COLOUR, draw_picture, text_style};
use crate::report::number;
use machine::record::estimate::{ArrowFigure, ArrowGroup, FigureArrow, Unit};

/// Side of the square panels, in picture units.
pub(super) const PANEL_SIZE: i32 = 500;
/// Height of the strip with the scale arrow below the panels, in picture units.
pub(super) const SCALE_ARROW_STRIP_HEIGHT: i32 = 70;
pub(super) const PICTURE_SIZE: (u32, u32) = (3 * PANEL_SIZE as u32, (PANEL_SIZE + SCALE_ARROW_STRIP_HEIGHT) as u32);
/// Index of each panel, and its axes to the right and upwards: from above, and from two sides.
pub(super) const PANEL_INDICES_AND_AXES: [(i32, [usize; 2]); 3] = [(0, [0, 1]), (1, [0, 2]), (2, [1, 2])];
/// Distance from the middle of a panel to the farthest position, in picture units.
const FARTHEST_POSITION_OFFSET: f64 = 140.0;
/// Length of the longest arrow without a flag, in picture units.
const MAX_UNFLAGGED_ARROW_LENGTH: f64 = 80.0;
/// Maximum length of an arrow, in picture units: flagged ones may be longer than the others by orders of
/// magnitude.
const MAX_ARROW_LENGTH: f64 = 100.0;
const ARROWHEAD_LENGTH: f64 = 18.0;

/// Scales that all groups of a figure share.
pub(in crate::report) struct ArrowScales {
    /// Centre of all positions, mm.
    pub(super) centre_mm: [f64; 3],
    /// Picture units per mm between positions.
    pub(super) units_per_mm: f64,
    /// Picture units per unit of the vectors.
    pub(super) vector: f64,
    /// Value and label of the scale arrow.
    scale_arrow: (f64, String),
}

impl ArrowScales {
    /// The scales of a figure; `None` without a finite arrow.
    pub(in crate::report) fn new(figure: &ArrowFigure) -> Option<Self> {
        let all = || figure.groups.iter().flat_map(finite_arrows);
        let side = |k: usize| value_bounds(all().map(|arrow| arrow.at_mm[k]));
        let sides = [side(0)?, side(1)?, side(2)?];
        let middle = sides.map(|(low, high)| 0.5 * (low + high));
        let reach = sides.iter().map(|(low, high)| 0.5 * (high - low)).fold(0.0, f64::max);
        let longest = |flagged: bool| {
            let chosen = all().filter(|arrow| flagged || !arrow.flagged);
            chosen.map(|arrow| vector_length(arrow.vector)).fold(0.0, f64::max)
        };
        let length = [longest(false), longest(true)].into_iter().find(|length| *length > 0.0);
        let length = length.unwrap_or(1.0);
        let value = round_up_to_1_2_or_5(0.4 * length);
        let text = format!("{} {}", tick_label(value, value), number::unit_symbol(figure.unit));
        let place = if reach > 0.0 { FARTHEST_POSITION_OFFSET / reach } else { 1.0 };
        Some(Self {
            centre_mm: middle,
            units_per_mm: place,
            vector: MAX_UNFLAGGED_ARROW_LENGTH / length,
            scale_arrow: (value, text),
        })
    }

    pub(in crate::report) fn draw(&self, group: &ArrowGroup) -> Option<String> {
        draw_picture(PICTURE_SIZE, |area| {
            for (panel, sides) in PANEL_INDICES_AND_AXES {
                self.draw_panel(area, panel, sides, group)?;
            }
            self.draw_scale_arrow(area)
        })
    }

    fn draw_panel(&self, area: &Area<'_>, panel: i32, sides: [usize; 2], group: &ArrowGroup) -> DrawResult {
        let left = panel * PANEL_SIZE;
        draw_panel_frame(area, panel, sides)?;
        // Flagged arrows are drawn last, on top.
        let order = finite_arrows(group).filter(|a| !a.flagged).chain(finite_arrows(group).filter(|a| a.flagged));
        for arrow in order {
            let from = sides.map(|k| self.units_per_mm * (arrow.at_mm[k] - self.centre_mm[k]));
            let from = (left + PANEL_SIZE / 2 + from[0].round() as i32, PANEL_SIZE / 2 - from[1].round() as i32);
            self.draw_arrow_with_any_flag(area, from, sides.map(|k| arrow.vector[k]), arrow)?;
        }
        Ok(())
    }

    fn draw_arrow_with_any_flag(
        &self,
        area: &Area<'_>,
        from: (i32, i32),
        along: [f64; 2],
        arrow: &FigureArrow,
    ) -> DrawResult {
        let colour = if arrow.flagged { FIT_COLOUR } else { LINE_COLOUR };
        area.draw(&Circle::new(from, 4, INK_COLOUR.mix(0.5).filled()))?;
        let factor = self.arrow_scale(arrow.vector);
        let by = along.map(|part| factor * part);
        draw_arrow(area, from, by, colour)?;
        if arrow.flagged {
            area.draw(&Circle::new(from, 13, colour.stroke_width(4)))?;
            // The label is on the side opposite to the arrow.
            let (side, away) = if along[0] < 0.0 { (HPos::Left, 20) } else { (HPos::Right, -20) };
            let style = text_style(FONT_SIZE).pos(Pos::new(side, VPos::Center));
            area.draw(&Text::new(arrow.label.clone(), (from.0 + away, from.1 + 4), style))?;
        }
        Ok(())
    }

    /// Picture units per unit of `vector`, reduced where the arrow would be too long.
    pub(super) fn arrow_scale(&self, vector: [f64; 3]) -> f64 {
        self.vector * (MAX_ARROW_LENGTH / (self.vector * vector_length(vector))).min(1.0)
    }

    pub(super) fn draw_scale_arrow(&self, area: &Area<'_>) -> DrawResult {
        let (value, text) = &self.scale_arrow;
        let from = (24, PANEL_SIZE + SCALE_ARROW_STRIP_HEIGHT / 2);
        draw_arrow(area, from, [self.vector * value, 0.0], INK_COLOUR)?;
        let style = text_style(FONT_SIZE).pos(Pos::new(HPos::Left, VPos::Center));
        let right = from.0 + (self.vector * value) as i32 + 20;
        area.draw(&Text::new(text.clone(), (right, from.1), style))?;
        Ok(())
    }

    /// Magnification of lengths in `unit_symbol`; `None` for a unit that is not a length.
    pub(in crate::report) fn magnification(&self, unit: Unit) -> Option<f64> {
        let per_mm = match unit {
            Unit::Um => 1e3,
            Unit::Mm => 1.0,
            Unit::Urad | Unit::UmPerM | Unit::Ms => return None,
        };
        Some(self.vector * per_mm / self.units_per_mm)
    }

    /// Whether a flagged arrow is drawn shorter than to scale.
    pub(in crate::report) fn has_shortened_arrows(&self, figure: &ArrowFigure) -> bool {
        figure.groups.iter().flat_map(finite_arrows).any(|a| self.vector * vector_length(a.vector) > MAX_ARROW_LENGTH)
    }
}

/// Draws the frame of a panel with the names of its axes.
pub(super) fn draw_panel_frame(area: &Area<'_>, panel: i32, sides: [usize; 2]) -> DrawResult {
    let left = panel * PANEL_SIZE;
    let frame = [(left + 4, 4), (left + PANEL_SIZE - 4, PANEL_SIZE - 4)];
    area.draw(&Rectangle::new(frame, GRID_COLOUR.stroke_width(2)))?;
    let named = text_style(FONT_SIZE).pos(Pos::new(HPos::Left, VPos::Top));
    let name: String = sides.into_iter().map(|k| ['X', 'Y', 'Z'][k]).collect();
    area.draw(&Text::new(name, (left + 16, 14), named))?;
    Ok(())
}

/// Draws a line with an arrowhead; y is positive upwards.
fn draw_arrow(area: &Area<'_>, from: (i32, i32), [x, y]: [f64; 2], colour: RGBColor) -> DrawResult {
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
    area.draw(&PathElement::new(shaft, colour.stroke_width(4)))?;
    let back = length - head;
    let tip = vec![at(length, 0.0), at(back, 0.5 * head), at(back, -0.5 * head)];
    area.draw(&Polygon::new(tip, colour.filled()))?;
    Ok(())
}

pub(super) fn finite_arrows(group: &ArrowGroup) -> impl Iterator<Item = &FigureArrow> {
    group.arrows.iter().filter(|a| a.at_mm.iter().chain(&a.vector).all(|part| part.is_finite()))
}

fn vector_length(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}
