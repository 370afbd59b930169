//! Vectors at positions in space: three views of each group, all groups of a figure at one scale.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::scale::{bounds, label, round_step};
use super::{Area, Drawn, FIT, FONT, GRID, INK, LINE, picture, text_style};
use crate::report::number;
use machine::record::estimate::{Arrow, ArrowFigure, Arrows, Unit};

/// Width of the square panels, height of the scale below them, and size of the picture, in picture units.
pub(super) const PANEL: i32 = 500;
pub(super) const FOOT: i32 = 70;
pub(super) const SIZE: (u32, u32) = (3 * PANEL as u32, (PANEL + FOOT) as u32);
/// Axes of each panel, to the right and upwards: from above, and from two sides.
pub(super) const VIEWS: [(i32, [usize; 2]); 3] = [(0, [0, 1]), (1, [0, 2]), (2, [1, 2])];
/// Distance from the middle of a panel to the farthest position, and length of the longest arrow without a
/// flag, in picture units.
const PANEL_HALF_WIDTH: f64 = 140.0;
const LONGEST: f64 = 80.0;
/// Maximum length of an arrow, in picture units: flagged ones may be longer than the others by orders of
/// magnitude.
const MAX_ARROW_LENGTH: f64 = 100.0;
const HEAD: f64 = 18.0;

/// Scales that all groups of a figure share.
pub(in crate::report) struct Common {
    /// Centre of all positions, mm.
    pub(super) middle: [f64; 3],
    /// Picture units per mm, and per unit of the vectors.
    pub(super) place: f64,
    pub(super) vector: f64,
    /// Value and label of the scale arrow.
    key: (f64, String),
}

impl Common {
    /// The scales of a figure; `None` without a finite arrow.
    pub(in crate::report) fn of(figure: &ArrowFigure) -> Option<Self> {
        let all = || figure.groups.iter().flat_map(drawable);
        let side = |k: usize| bounds(all().map(|arrow| arrow.at_mm[k]));
        let sides = [side(0)?, side(1)?, side(2)?];
        let middle = sides.map(|(low, high)| 0.5 * (low + high));
        let reach = sides.iter().map(|(low, high)| 0.5 * (high - low)).fold(0.0, f64::max);
        let longest = |flagged: bool| {
            let chosen = all().filter(|arrow| flagged || !arrow.flagged);
            chosen.map(|arrow| norm(arrow.vector)).fold(0.0, f64::max)
        };
        let length = [longest(false), longest(true)].into_iter().find(|length| *length > 0.0);
        let length = length.unwrap_or(1.0);
        let value = round_step(0.4 * length);
        let text = format!("{} {}", label(value, value), number::unit(figure.unit));
        let place = if reach > 0.0 { PANEL_HALF_WIDTH / reach } else { 1.0 };
        Some(Self { middle, place, vector: LONGEST / length, key: (value, text) })
    }

    pub(in crate::report) fn draw(&self, group: &Arrows) -> Option<String> {
        picture(SIZE, |area| {
            for (panel, sides) in VIEWS {
                self.panel(area, panel, sides, group)?;
            }
            self.scale(area)
        })
    }

    fn panel(&self, area: &Area<'_>, panel: i32, sides: [usize; 2], group: &Arrows) -> Drawn {
        let left = panel * PANEL;
        frame(area, panel, sides)?;
        // Flagged arrows are drawn last, on top.
        let order =
            drawable(group).filter(|a| !a.flagged).chain(drawable(group).filter(|a| a.flagged));
        for arrow in order {
            let from = sides.map(|k| self.place * (arrow.at_mm[k] - self.middle[k]));
            let from =
                (left + PANEL / 2 + from[0].round() as i32, PANEL / 2 - from[1].round() as i32);
            self.arrow(area, from, sides.map(|k| arrow.vector[k]), arrow)?;
        }
        Ok(())
    }

    fn arrow(&self, area: &Area<'_>, from: (i32, i32), along: [f64; 2], arrow: &Arrow) -> Drawn {
        let colour = if arrow.flagged { FIT } else { LINE };
        area.draw(&Circle::new(from, 4, INK.mix(0.5).filled()))?;
        let factor = self.factor(arrow.vector);
        let by = along.map(|part| factor * part);
        drawn(area, from, by, colour)?;
        if arrow.flagged {
            area.draw(&Circle::new(from, 13, colour.stroke_width(4)))?;
            // The label is on the side opposite to the arrow.
            let (side, away) = if along[0] < 0.0 { (HPos::Left, 20) } else { (HPos::Right, -20) };
            let style = text_style(FONT).pos(Pos::new(side, VPos::Center));
            area.draw(&Text::new(arrow.label.clone(), (from.0 + away, from.1 + 4), style))?;
        }
        Ok(())
    }

    /// Picture units per unit of `vector`, reduced where the arrow would be too long.
    pub(super) fn factor(&self, vector: [f64; 3]) -> f64 {
        self.vector * (MAX_ARROW_LENGTH / (self.vector * norm(vector))).min(1.0)
    }

    pub(super) fn scale(&self, area: &Area<'_>) -> Drawn {
        let (value, text) = &self.key;
        let from = (24, PANEL + FOOT / 2);
        drawn(area, from, [self.vector * value, 0.0], INK)?;
        let style = text_style(FONT).pos(Pos::new(HPos::Left, VPos::Center));
        let right = from.0 + (self.vector * value) as i32 + 20;
        area.draw(&Text::new(text.clone(), (right, from.1), style))?;
        Ok(())
    }

    /// Magnification of lengths in `unit`; `None` for a unit that is not a length.
    pub(in crate::report) fn magnified(&self, unit: Unit) -> Option<f64> {
        let per_mm = match unit {
            Unit::Um => 1e3,
            Unit::Mm => 1.0,
            Unit::Urad | Unit::UmPerM | Unit::Ms => return None,
        };
        Some(self.vector * per_mm / self.place)
    }

    /// Whether a flagged arrow is drawn shorter than to scale.
    pub(in crate::report) fn cuts(&self, figure: &ArrowFigure) -> bool {
        figure
            .groups
            .iter()
            .flat_map(drawable)
            .any(|a| self.vector * norm(a.vector) > MAX_ARROW_LENGTH)
    }
}

/// Draws the frame of a panel with the names of its axes.
pub(super) fn frame(area: &Area<'_>, panel: i32, sides: [usize; 2]) -> Drawn {
    let left = panel * PANEL;
    let frame = [(left + 4, 4), (left + PANEL - 4, PANEL - 4)];
    area.draw(&Rectangle::new(frame, GRID.stroke_width(2)))?;
    let named = text_style(FONT).pos(Pos::new(HPos::Left, VPos::Top));
    let name: String = sides.into_iter().map(|k| ['X', 'Y', 'Z'][k]).collect();
    area.draw(&Text::new(name, (left + 16, 14), named))?;
    Ok(())
}

/// Draws a line with an arrowhead; y is positive upwards.
fn drawn(area: &Area<'_>, from: (i32, i32), [x, y]: [f64; 2], colour: RGBColor) -> Drawn {
    let length = x.hypot(y);
    if length < 1.0 {
        return Ok(());
    }
    let at = |along: f64, aside: f64| {
        let (u, v) = (x / length, y / length);
        let (dx, dy) = (along * u - aside * v, along * v + aside * u);
        (from.0 + dx.round() as i32, from.1 - dy.round() as i32)
    };
    let head = HEAD.min(0.6 * length);
    let shaft = vec![from, at(length - 0.5 * head, 0.0)];
    area.draw(&PathElement::new(shaft, colour.stroke_width(4)))?;
    let back = length - head;
    let tip = vec![at(length, 0.0), at(back, 0.5 * head), at(back, -0.5 * head)];
    area.draw(&Polygon::new(tip, colour.filled()))?;
    Ok(())
}

pub(super) fn drawable(group: &Arrows) -> impl Iterator<Item = &Arrow> {
    group.arrows.iter().filter(|a| a.at_mm.iter().chain(&a.vector).all(|part| part.is_finite()))
}

fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}
