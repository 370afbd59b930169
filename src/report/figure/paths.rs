//! Commanded and measured positions with magnified deviations: three views of each group.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::arrows::{
    ArrowScales, PANEL_INDICES_AND_AXES, PANEL_SIZE, PICTURE_SIZE, SCALE_ARROW_STRIP_HEIGHT, draw_panel_frame,
    finite_arrows,
};
use super::{Area, DrawResult, FIT_COLOUR, FONT_SIZE, INK_COLOUR, LINE_COLOUR, draw_picture, text_style};
use machine::record::estimate::{ArrowGroup, FigureArrow};

/// Names in the legend, with their positions at the foot of the picture.
const LEGEND_TEXTS_AND_MARK_X: [(&str, i32); 3] = [("commanded", 320), ("measured", 580), ("model", 810)];

impl ArrowScales {
    /// Draws one group as [`ArrowScales::draw`] does, and joins the positions in their order to a closed path.
    pub(in crate::report) fn draw_path(&self, group: &ArrowGroup) -> Option<String> {
        draw_picture(PICTURE_SIZE, |area| {
            for (panel, sides) in PANEL_INDICES_AND_AXES {
                draw_panel_frame(area, panel, sides)?;
                self.draw_closed_path(
                    area,
                    group,
                    |arrow| self.picture_position(panel, sides, arrow, Some([0.0; 3])),
                    INK_COLOUR,
                )?;
                self.draw_closed_path(
                    area,
                    group,
                    |arrow| self.picture_position(panel, sides, arrow, arrow.modelled),
                    FIT_COLOUR,
                )?;
                self.draw_closed_path(
                    area,
                    group,
                    |a| self.picture_position(panel, sides, a, Some(a.vector)),
                    LINE_COLOUR,
                )?;
                for arrow in finite_arrows(group) {
                    let at = |vector| self.picture_position(panel, sides, arrow, vector);
                    let places = [at(Some([0.0; 3])), at(Some(arrow.vector)), at(arrow.modelled)];
                    draw_marks(area, places, arrow.flagged)?;
                }
            }
            self.draw_scale_arrow(area)?;
            for (number, (text, left)) in LEGEND_TEXTS_AND_MARK_X.into_iter().enumerate() {
                let here = (left, PANEL_SIZE + SCALE_ARROW_STRIP_HEIGHT / 2);
                let place = |k: usize| (k == number).then_some(here);
                draw_marks(area, [place(0), place(1), place(2)], false)?;
                let style = text_style(FONT_SIZE).pos(Pos::new(HPos::Left, VPos::Center));
                area.draw(&Text::new(text, (here.0 + 20, here.1), style))?;
            }
            Ok(())
        })
    }

    /// Position of the tip of `vector` in the picture; `None` if the vector is not finite. `view_axes`: axis that
    /// points to the right, and axis that points up.
    fn picture_position(
        &self,
        panel: i32,
        view_axes: [usize; 2],
        arrow: &FigureArrow,
        vector: Option<[f64; 3]>,
    ) -> Option<(i32, i32)> {
        let vector = vector.filter(|vector| vector.iter().all(|part| part.is_finite()))?;
        let factor = self.arrow_scale(vector);
        let [right, up] =
            view_axes.map(|k| self.units_per_mm * (arrow.at_mm[k] - self.centre_mm[k]) + factor * vector[k]);
        let middle = PANEL_SIZE / 2;
        Some((panel * PANEL_SIZE + middle + right.round() as i32, middle - up.round() as i32))
    }

    fn draw_closed_path(
        &self,
        area: &Area<'_>,
        group: &ArrowGroup,
        position_of: impl Fn(&FigureArrow) -> Option<(i32, i32)>,
        colour: RGBColor,
    ) -> DrawResult {
        let mut round: Vec<_> = finite_arrows(group).filter_map(position_of).collect();
        round.extend(round.first().copied().filter(|_| round.len() > 2));
        area.draw(&PathElement::new(round, colour.mix(0.6).stroke_width(2)))?;
        Ok(())
    }
}

/// Marks of the commanded, measured and modelled positions.
fn draw_marks(area: &Area<'_>, commanded_measured_modelled: [Option<(i32, i32)>; 3], is_flagged: bool) -> DrawResult {
    let [commanded, measured, modelled] = commanded_measured_modelled;
    if let Some(at) = commanded {
        area.draw(&Circle::new(at, 6, INK_COLOUR.filled()))?;
    }
    if let Some(at) = modelled {
        area.draw(&TriangleMarker::new(at, 11, FIT_COLOUR.stroke_width(3)))?;
    }
    if let Some(at) = measured {
        area.draw(&Circle::new(at, 9, LINE_COLOUR.stroke_width(4)))?;
        if is_flagged {
            area.draw(&Circle::new(at, 15, FIT_COLOUR.stroke_width(4)))?;
        }
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
        let (symbol, figure) = ("deviation".to_owned(), VectorFigureKind::Paths);
        let mut figure = ArrowFigure { symbol, unit: Unit::Um, groups, figure };
        let common = ArrowScales::new(&figure).unwrap();
        // Scale of the deviations (80 units per 0.040 mm) over that of the machine (140 units per 100 mm).
        assert!((common.magnification(Unit::Um).unwrap() - 80.0 / 0.040 / 1.4).abs() < 1e-6);
        assert_eq!(common.magnification(Unit::Urad), None);
        let svg = common.draw_path(&figure.groups[0]).unwrap();
        let rings = |radius: &str| -> Vec<[String; 2]> {
            let marked = svg.lines().filter(|line| line.contains(&format!(" r=\"{radius}\"")));
            marked.map(|l| ["cx", "cy"].map(|name| attribute_values(l, name)[0].to_owned())).collect()
        };
        let commanded = [["110", "250"], ["390", "250"], ["610", "250"], ["890", "250"]];
        assert_eq!(rings("6")[..4], commanded);
        assert_eq!(rings("6")[4..6], [["1250", "250"]; 2]);
        let measured = [["190", "250"], ["390", "230"], ["690", "250"], ["890", "190"]];
        assert_eq!(rings("9")[..4], measured);
        assert_eq!(rings("9")[4..6], [["1250", "250"], ["1270", "190"]]);
        // The modelled position: once in each of 3 panels and once in the legend; and the scale.
        assert_eq!(svg.matches("<polygon").count(), 3 + 1 + 1, "{svg}");
        assert!(is_inside_picture(&svg) && svg.contains("commanded"));
        figure.groups[0].arrows[0].vector[1] = f64::NAN;
        figure.groups[0].arrows[1].modelled = Some([f64::INFINITY; 3]);
        figure.groups[0].arrows[1].vector = [1e9; 3];
        figure.groups[0].arrows[1].flagged = true;
        assert!(is_inside_picture(&common.draw_path(&figure.groups[0]).unwrap()));
    }
}
