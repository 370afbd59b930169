//! Commanded and measured positions with magnified deviations, joined in their order to a closed path.

use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::arrow_scales::{ArrowScales, finite_arrows};
use super::views::{SCALE_ROW_HEIGHT, View};
use super::{Area, DrawResult, FIT_COLOUR, FONT_SIZE, INK_COLOUR, LINE_COLOUR, text_style};
use machine::record::estimate::{ArrowGroup, FigureArrow};

/// Length and gap of the dashes of the model's path.
const MODEL_DASH_AND_GAP_LENGTH: (u32, u32) = (12, 8);
const LEGEND_NAMES: [&str; 3] = ["commanded", "measured", "model"];

/// Positions in the picture; `None` for a vector that is not finite or not stated.
struct PathPoint {
    commanded: Option<(i32, i32)>,
    measured: Option<(i32, i32)>,
    modelled: Option<(i32, i32)>,
}

impl ArrowScales {
    /// Draws the closed paths of a group: measured positions with a thick line, those of the model with a dashed one.
    pub(super) fn draw_paths(&self, area: &Area<'_>, view: View, group: &ArrowGroup) -> DrawResult {
        let points: Vec<PathPoint> = finite_arrows(group).map(|arrow| self.path_point(view, arrow)).collect();
        let path = |position_of: fn(&PathPoint) -> Option<(i32, i32)>| {
            let mut round: Vec<_> = points.iter().filter_map(position_of).collect();
            round.extend(round.first().copied().filter(|_| round.len() > 2));
            round
        };
        area.draw(&PathElement::new(path(|point| point.commanded), INK_COLOUR.stroke_width(2)))?;
        area.draw(&PathElement::new(path(|point| point.measured), LINE_COLOUR.stroke_width(4)))?;
        let modelled = path(|point| point.modelled);
        if modelled.len() > 1 {
            let (dash, gap) = MODEL_DASH_AND_GAP_LENGTH;
            area.draw(&DashedPathElement::new(modelled, dash, gap, FIT_COLOUR.stroke_width(3)))?;
        }
        Ok(())
    }

    /// Draws the paths of a group with a mark at each position.
    pub(super) fn draw_paths_with_marks(&self, area: &Area<'_>, view: View, group: &ArrowGroup) -> DrawResult {
        self.draw_paths(area, view, group)?;
        finite_arrows(group).try_for_each(|arrow| draw_marks(area, &self.path_point(view, arrow)))
    }

    fn path_point(&self, view: View, arrow: &FigureArrow) -> PathPoint {
        let is_finite = |vector: &[f64; 3]| vector.iter().all(|part| part.is_finite());
        PathPoint {
            commanded: Some(self.start(view, arrow)),
            measured: Some(self.tip(view, arrow, arrow.vector)),
            modelled: arrow.modelled.filter(is_finite).map(|vector| self.tip(view, arrow, vector)),
        }
    }
}

/// Draws the marks with their names, one row each.
pub(super) fn draw_path_legend(area: &Area<'_>, (left, top): (i32, i32)) -> DrawResult {
    for (row, name) in (0..).zip(LEGEND_NAMES) {
        let at = (left + 20, top + row * SCALE_ROW_HEIGHT);
        let of_row = |own: i32| (own == row).then_some(at);
        draw_marks(area, &PathPoint { commanded: of_row(0), measured: of_row(1), modelled: of_row(2) })?;
        let style = text_style(FONT_SIZE).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(name, (at.0 + 30, at.1), style))?;
    }
    Ok(())
}

/// Draws the marks of the commanded, measured and modelled positions.
fn draw_marks(area: &Area<'_>, point: &PathPoint) -> DrawResult {
    if let Some(at) = point.commanded {
        area.draw(&Circle::new(at, 6, INK_COLOUR.filled()))?;
    }
    if let Some(at) = point.modelled {
        area.draw(&TriangleMarker::new(at, 11, FIT_COLOUR.stroke_width(3)))?;
    }
    if let Some(at) = point.measured {
        area.draw(&Circle::new(at, 9, LINE_COLOUR.stroke_width(4)))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{attribute_values, is_inside_picture};
    use super::*;
    use machine::record::estimate::{ArrowFigure, Unit, VectorFigureKind};

    /// Two positions 200 mm apart in X; the longest deviation, 40 µm, is drawn 80 units long.
    #[test]
    fn measured_points_are_drawn_at_the_magnified_deviation() {
        let arrow = |x: f64, vector, modelled| FigureArrow {
            label: String::new(),
            at_mm: [x, 5.0, 7.0],
            vector,
            modelled,
            flagged: false,
        };
        let arrows =
            vec![arrow(-100.0, [40.0, 0.0, 0.0], None), arrow(100.0, [0.0, 10.0, 30.0], Some([0.0, 0.0, 20.0]))];
        let groups = vec![ArrowGroup { name: "B 0°".to_owned(), arrows }];
        let (symbol, kind) = ("deviation".to_owned(), VectorFigureKind::Paths);
        let mut figure = ArrowFigure { symbol, unit: Unit::Um, groups, figure: kind };
        let common = ArrowScales::new(&figure).unwrap();
        // Scale of the deviations (80 units per 0.040 mm) over that of the machine (140 units per 100 mm).
        assert!((common.magnification(Unit::Um).unwrap() - 80.0 / 0.040 / 1.4).abs() < 1e-6);
        assert_eq!(common.magnification(Unit::Urad), None);
        let svg = common.draw_group(&figure.groups[0], kind).unwrap();
        let rings = |radius: &str| -> Vec<[String; 2]> {
            let marked = svg.lines().filter(|line| line.contains(&format!(" r=\"{radius}\"")));
            marked.map(|l| ["cx", "cy"].map(|name| attribute_values(l, name)[0].to_owned())).collect()
        };
        // Views XZ, YZ and XY.
        let commanded =
            [["110", "250"], ["390", "250"], ["750", "250"], ["750", "250"], ["110", "750"], ["390", "750"]];
        assert_eq!(rings("6")[..6], commanded);
        let measured = [["190", "250"], ["390", "190"], ["750", "250"], ["770", "190"], ["190", "750"], ["390", "730"]];
        assert_eq!(rings("9")[..6], measured);
        // The modelled position: once in each of 3 views and once in the legend; the scale; two axes in each view.
        assert_eq!(svg.matches("<polygon").count(), 3 + 1 + 1 + 6, "{svg}");
        assert!(is_inside_picture(&svg) && svg.contains("commanded"));
        figure.groups[0].arrows[0].vector[1] = f64::NAN;
        figure.groups[0].arrows[1].modelled = Some([f64::INFINITY; 3]);
        figure.groups[0].arrows[1].vector = [1e9; 3];
        figure.groups[0].arrows[1].flagged = true;
        assert!(is_inside_picture(&common.draw_group(&figure.groups[0], kind).unwrap()));
        assert!(is_inside_picture(&common.draw_all(&figure).unwrap()));
    }
}
