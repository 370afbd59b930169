//! Vectors at positions in space: all groups of a figure in one picture, and one group in more detail, at one scale.

use std::collections::BTreeSet;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::arrow_scales::{ArrowScales, finite_arrows};
use super::ticked_axis::tick_label;
use super::views::{Labels, PICTURE_SIZE, SCALE_ROW_HEIGHT, SCALES_LEFT_AND_TOP, VIEWS, View, draw_arrow};
use super::{Area, DrawResult, FIT_COLOUR, FONT_SIZE, INK_COLOUR, LINE_COLOUR, draw_picture, text_style};
use machine::record::estimate::{ArrowFigure, ArrowGroup, FigureArrow, VectorFigureKind};

/// Distance from the left end of the scales to their names, in picture units.
const SCALE_NAME_LEFT: i32 = 150;

impl ArrowScales {
    /// Draws all groups over each other, without arrowheads; flagged vectors are circled and named.
    pub(in crate::report) fn draw_all(&self, figure: &ArrowFigure) -> Option<String> {
        draw_picture(PICTURE_SIZE, |area| {
            for view in VIEWS {
                view.draw_frame(area)?;
                match figure.figure {
                    VectorFigureKind::Arrows => self.draw_lines(area, view, figure)?,
                    VectorFigureKind::Paths => {
                        figure.groups.iter().try_for_each(|group| self.draw_paths(area, view, group))?;
                    }
                }
                let mut labels = Labels::default();
                let mut flagged = figure.groups.iter().flat_map(finite_arrows).filter(|arrow| arrow.flagged);
                flagged.try_for_each(|arrow| self.draw_flagged_arrow(area, view, arrow, &mut labels))?;
            }
            self.draw_scales(area, figure.figure)
        })
    }

    /// Draws one group with arrowheads or marks, and with the names of its positions.
    pub(in crate::report) fn draw_group(&self, group: &ArrowGroup, kind: VectorFigureKind) -> Option<String> {
        draw_picture(PICTURE_SIZE, |area| {
            for view in VIEWS {
                view.draw_frame(area)?;
                match kind {
                    VectorFigureKind::Arrows => self.draw_arrows(area, view, group)?,
                    VectorFigureKind::Paths => self.draw_paths_with_marks(area, view, group)?,
                }
                // Names of flagged positions have priority over the others.
                let (flagged, others): (Vec<_>, Vec<_>) = finite_arrows(group).partition(|arrow| arrow.flagged);
                let mut labels = Labels::default();
                flagged.into_iter().try_for_each(|arrow| self.draw_flagged_arrow(area, view, arrow, &mut labels))?;
                others.into_iter().try_for_each(|arrow| self.draw_label(area, view, arrow, &mut labels))?;
            }
            self.draw_scales(area, kind)
        })
    }

    /// Draws the vectors as lines that begin at a dot.
    fn draw_lines(&self, area: &Area<'_>, view: View, figure: &ArrowFigure) -> DrawResult {
        let arrows = || figure.groups.iter().flat_map(finite_arrows);
        for arrow in arrows() {
            let line = [self.start(view, arrow), self.tip(view, arrow, arrow.vector)];
            area.draw(&PathElement::new(line, LINE_COLOUR.stroke_width(2)))?;
        }
        let starts: BTreeSet<_> = arrows().map(|arrow| self.start(view, arrow)).collect();
        starts.into_iter().try_for_each(|at| area.draw(&Circle::new(at, 4, INK_COLOUR.filled())))?;
        Ok(())
    }

    fn draw_arrows(&self, area: &Area<'_>, view: View, group: &ArrowGroup) -> DrawResult {
        for arrow in finite_arrows(group) {
            let colour = if arrow.flagged { FIT_COLOUR } else { LINE_COLOUR };
            let vector = view.project(self.drawn_vector(arrow.vector));
            draw_arrow(area, self.start(view, arrow), vector, colour.stroke_width(4))?;
        }
        finite_arrows(group)
            .try_for_each(|arrow| area.draw(&Circle::new(self.start(view, arrow), 4, INK_COLOUR.filled())))?;
        Ok(())
    }

    /// Draws the circle about the start of a flagged vector, and its name.
    fn draw_flagged_arrow(&self, area: &Area<'_>, view: View, arrow: &FigureArrow, labels: &mut Labels) -> DrawResult {
        area.draw(&Circle::new(self.start(view, arrow), 13, FIT_COLOUR.stroke_width(4)))?;
        let line = [self.start(view, arrow), self.tip(view, arrow, arrow.vector)];
        area.draw(&PathElement::new(line, FIT_COLOUR.stroke_width(4)))?;
        self.draw_label(area, view, arrow, labels)
    }

    /// Draws the name on the side opposite to the vector.
    fn draw_label(&self, area: &Area<'_>, view: View, arrow: &FigureArrow, labels: &mut Labels) -> DrawResult {
        let (x, y) = self.start(view, arrow);
        let is_left = view.project(arrow.vector)[0] >= 0.0;
        labels.draw_beside(area, &arrow.label, (if is_left { x - 20 } else { x + 20 }, y), is_left)
    }

    /// Draws the scale of the vectors, the scale of the positions, and the legend.
    fn draw_scales(&self, area: &Area<'_>, kind: VectorFigureKind) -> DrawResult {
        let (left, top) = (SCALES_LEFT_AND_TOP.0 + 30, SCALES_LEFT_AND_TOP.1 + 60);
        let style = text_style(FONT_SIZE).pos(Pos::new(HPos::Left, VPos::Center));
        let name = |text: String, row: i32| {
            Text::new(text, (left + SCALE_NAME_LEFT, top + row * SCALE_ROW_HEIGHT), style.clone())
        };
        let unit = self.unit.symbol();
        let arrow_length = self.picture_units_per_vector_unit * self.scale_arrow_length;
        draw_arrow(area, (left, top), [arrow_length, 0.0], INK_COLOUR.stroke_width(4))?;
        area.draw(&name(format!("{} {unit}", tick_label(self.scale_arrow_length, self.scale_arrow_length)), 0))?;
        if let Some(mm) = self.scale_bar_mm {
            let (right, y) = (left + (self.picture_units_per_mm * mm).round() as i32, top + SCALE_ROW_HEIGHT);
            let bar = [(left, y - 12), (left, y), (right, y), (right, y - 12)];
            area.draw(&PathElement::new(bar, INK_COLOUR.stroke_width(2)))?;
            area.draw(&name(format!("{} mm", tick_label(mm, mm)), 1))?;
        }
        match kind {
            VectorFigureKind::Arrows => Ok(()),
            VectorFigureKind::Paths => super::paths::draw_path_legend(area, (left, top + 2 * SCALE_ROW_HEIGHT)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{attribute_values, is_inside_picture, smallest_text_on_a_phone};
    use super::*;
    use machine::record::estimate::Unit;

    struct TestArrow {
        at_mm: [f64; 3],
        vector: [f64; 3],
        flagged: bool,
    }

    fn group_of(arrows: &[TestArrow]) -> ArrowGroup {
        let arrow = |(n, arrow): (usize, &TestArrow)| FigureArrow {
            label: format!("ball {n}"),
            at_mm: arrow.at_mm,
            vector: arrow.vector,
            modelled: None,
            flagged: arrow.flagged,
        };
        ArrowGroup { name: "B 0°".to_owned(), arrows: arrows.iter().enumerate().map(arrow).collect() }
    }

    fn figure_of(groups: Vec<ArrowGroup>) -> ArrowFigure {
        ArrowFigure { symbol: "residuals".to_owned(), unit: Unit::Um, groups, figure: VectorFigureKind::Arrows }
    }

    fn points(element: &str) -> Vec<(i32, i32)> {
        let pair = |pair: &str| pair.split_once(',').map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap())).unwrap();
        attribute_values(element, "points")[0].split_whitespace().map(pair).collect()
    }

    /// Tips of the arrowheads of this colour: the first corner of each head.
    fn arrow_tips(svg: &str, colour: &str) -> Vec<(i32, i32)> {
        svg.lines()
            .filter(|line| line.contains("<polygon") && line.contains(colour))
            .map(|line| points(line)[0])
            .collect()
    }

    /// Lines of this colour and width.
    fn lines(svg: &str, colour: &str, width: u32) -> Vec<Vec<(i32, i32)>> {
        let width = format!("stroke-width=\"{width}\"");
        let of_style = |line: &&str| line.contains("<polyline") && line.contains(colour) && line.contains(&width);
        svg.lines().filter(of_style).map(points).collect()
    }

    fn two_arrows() -> Vec<TestArrow> {
        vec![
            TestArrow { at_mm: [-100.0, 5.0, 7.0], vector: [4.0, 0.0, 0.0], flagged: false },
            TestArrow { at_mm: [100.0, 5.0, 7.0], vector: [0.0, 1.0, 3.0], flagged: false },
        ]
    }

    /// Two positions 200 mm apart in X, both in the middle of Y and Z; the longest arrow is 80 units long. The middle
    /// of the view XZ is at (250, 250), of YZ at (750, 250), of XY at (250, 750).
    #[test]
    fn arrows_have_the_direction_of_the_vectors() {
        let figure = figure_of(vec![group_of(&two_arrows())]);
        let scales = ArrowScales::new(&figure).unwrap();
        let svg = scales.draw_group(&figure.groups[0], VectorFigureKind::Arrows).unwrap();
        let expected = [
            (250 - 140 + 80, 250),
            (250 + 140, 250 - 60),
            // View YZ: both arrows begin in its middle; the first points along X and has no head there.
            (750 + 20, 250 - 60),
            (250 - 140 + 80, 750),
            (250 + 140, 750 - 20),
        ];
        assert_eq!(arrow_tips(&svg, "#1F6FB2"), expected);
        // Scales: 2 µm are 40 units, 50 mm are 70 units.
        assert!(arrow_tips(&svg, "#22262B").contains(&(530 + 40, 560)), "{svg}");
        assert!(lines(&svg, "#22262B", 2).contains(&vec![(530, 612), (530, 624), (600, 624), (600, 612)]));
        for text in ["2 µm", "50 mm", "ball 0", "ball 1"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(is_inside_picture(&svg) && smallest_text_on_a_phone(&svg) >= 9.0);
        assert!(!scales.has_shortened_arrows(&figure));
    }

    /// All groups are lines in one picture, each from its start to its tip.
    #[test]
    fn all_groups_are_in_one_picture() {
        let one = |arrow: TestArrow| group_of(&[arrow]);
        let [first, second] = <[TestArrow; 2]>::try_from(two_arrows()).ok().unwrap();
        let figure = figure_of(vec![one(first), one(second)]);
        let svg = ArrowScales::new(&figure).unwrap().draw_all(&figure).unwrap();
        let vectors = lines(&svg, "#1F6FB2", 2);
        assert_eq!(vectors.len(), 3 * 2);
        assert_eq!(vectors[0], [(110, 250), (190, 250)]);
        assert_eq!(vectors[5], [(390, 750), (390, 730)]);
        assert!(is_inside_picture(&svg) && smallest_text_on_a_phone(&svg) >= 9.0);
        // The names of the positions belong to the picture of one group.
        assert!(!svg.contains("ball"));
    }

    #[test]
    fn flagged_arrow_is_ringed_and_does_not_change_the_scale() {
        let quiet = TestArrow { at_mm: [0.0; 3], vector: [0.0, 2.0, 0.0], flagged: false };
        let loud = TestArrow { at_mm: [50.0, 0.0, 0.0], vector: [0.0, 900.0, 0.0], flagged: true };
        let figure = figure_of(vec![group_of(&[loud]), group_of(&[quiet])]);
        let scales = ArrowScales::new(&figure).unwrap();
        assert!(scales.has_shortened_arrows(&figure));
        let svg = scales.draw_all(&figure).unwrap();
        // In the view XY: the quiet arrow 80 units long, the loud one shortened to 100.
        assert!(lines(&svg, "#1F6FB2", 2).contains(&vec![(110, 750), (110, 670)]));
        assert!(lines(&svg, "#C2571A", 4).contains(&vec![(390, 750), (390, 650)]));
        assert_eq!(svg.matches("r=\"13\"").count(), 3);
        // Both arrows are labelled "ball 0" in their own group; only the flagged one is named here.
        assert_eq!(svg.matches("ball 0").count(), 3);
        // An empty figure, and values that are not finite.
        let nan = TestArrow { at_mm: [f64::NAN; 3], vector: [0.0; 3], flagged: true };
        assert!(ArrowScales::new(&figure_of(vec![group_of(&[nan])])).is_none());
        let still = TestArrow { at_mm: [1.0; 3], vector: [0.0; 3], flagged: false };
        let infinite = TestArrow { at_mm: [2.0; 3], vector: [f64::INFINITY; 3], flagged: true };
        let figure = figure_of(vec![group_of(&[still, infinite])]);
        assert!(is_inside_picture(&ArrowScales::new(&figure).unwrap().draw_all(&figure).unwrap()));
    }

    /// Five balls at one place: one name is legible, five on top of each other are not.
    #[test]
    fn labels_do_not_overlap() {
        let at = |x: f64| TestArrow { at_mm: [x, 0.0, 0.0], vector: [1.0, 0.0, 0.0], flagged: true };
        let figure = figure_of(vec![group_of(&[at(0.0), at(0.1), at(0.2), at(0.3), at(100.0)])]);
        let svg = ArrowScales::new(&figure).unwrap().draw_all(&figure).unwrap();
        let names = |name: &str| svg.matches(name).count();
        // In the view YZ all five are at one point.
        assert_eq!(["ball 0", "ball 1", "ball 2", "ball 3", "ball 4"].map(names), [3, 0, 0, 0, 2]);
    }
}
