//! Commanded and measured positions with magnified deviations: three views of each group.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::arrows::{Common, FOOT, PANEL, SIZE, VIEWS, drawable, frame};
use super::{Area, Drawn, FIT, FONT, INK, LINE, picture, text_style};
use machine::record::estimate::{Arrow, Arrows};

/// Names in the legend, with their positions at the foot of the picture.
const KEY: [(&str, i32); 3] = [("commanded", 320), ("measured", 580), ("model", 810)];

impl Common {
    /// Draws one group as [`Common::draw`] does, and joins the positions in their order to a closed path.
    pub(in crate::report) fn draw_path(&self, group: &Arrows) -> Option<String> {
        picture(SIZE, |area| {
            for (panel, sides) in VIEWS {
                frame(area, panel, sides)?;
                self.joined(
                    area,
                    group,
                    |arrow| self.at(panel, sides, arrow, Some([0.0; 3])),
                    INK,
                )?;
                self.joined(
                    area,
                    group,
                    |arrow| self.at(panel, sides, arrow, arrow.modelled),
                    FIT,
                )?;
                self.joined(area, group, |a| self.at(panel, sides, a, Some(a.vector)), LINE)?;
                for arrow in drawable(group) {
                    let at = |vector| self.at(panel, sides, arrow, vector);
                    let places = [at(Some([0.0; 3])), at(Some(arrow.vector)), at(arrow.modelled)];
                    marks(area, places, arrow.flagged)?;
                }
            }
            self.scale(area)?;
            for (number, (text, left)) in KEY.into_iter().enumerate() {
                let here = (left, PANEL + FOOT / 2);
                let place = |k: usize| (k == number).then_some(here);
                marks(area, [place(0), place(1), place(2)], false)?;
                let style = text_style(FONT).pos(Pos::new(HPos::Left, VPos::Center));
                area.draw(&Text::new(text, (here.0 + 20, here.1), style))?;
            }
            Ok(())
        })
    }

    /// Position in the picture; `None` if the vector is not finite.
    fn at(
        &self,
        panel: i32,
        sides: [usize; 2],
        arrow: &Arrow,
        vector: Option<[f64; 3]>,
    ) -> Option<(i32, i32)> {
        let vector = vector.filter(|vector| vector.iter().all(|part| part.is_finite()))?;
        let factor = self.factor(vector);
        let [right, up] =
            sides.map(|k| self.place * (arrow.at_mm[k] - self.middle[k]) + factor * vector[k]);
        let middle = PANEL / 2;
        Some((panel * PANEL + middle + right.round() as i32, middle - up.round() as i32))
    }

    fn joined(
        &self,
        area: &Area<'_>,
        group: &Arrows,
        place: impl Fn(&Arrow) -> Option<(i32, i32)>,
        colour: RGBColor,
    ) -> Drawn {
        let mut round: Vec<_> = drawable(group).filter_map(place).collect();
        round.extend(round.first().copied().filter(|_| round.len() > 2));
        area.draw(&PathElement::new(round, colour.mix(0.6).stroke_width(2)))?;
        Ok(())
    }
}

/// Marks of the commanded, measured and modelled positions.
fn marks(area: &Area<'_>, places: [Option<(i32, i32)>; 3], flagged: bool) -> Drawn {
    let [commanded, measured, modelled] = places;
    if let Some(at) = commanded {
        area.draw(&Circle::new(at, 6, INK.filled()))?;
    }
    if let Some(at) = modelled {
        area.draw(&TriangleMarker::new(at, 11, FIT.stroke_width(3)))?;
    }
    if let Some(at) = measured {
        area.draw(&Circle::new(at, 9, LINE.stroke_width(4)))?;
        if flagged {
            area.draw(&Circle::new(at, 15, FIT.stroke_width(4)))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{attributes, inside};
    use super::*;
    use machine::record::estimate::{ArrowFigure, Unit, VectorKind};

    /// Two positions 200 mm apart in X; the longest deviation, 40 µm, is drawn 80 units long.
    #[test]
    fn places_are_found_where_the_magnified_deviation_leads() {
        let arrow = |x: f64, vector, modelled| Arrow {
            label: String::new(),
            at_mm: [x, 5.0, 7.0],
            vector,
            modelled,
            flagged: false,
        };
        let arrows = vec![
            arrow(-100.0, [40.0, 0.0, 0.0], None),
            arrow(100.0, [0.0, 10.0, 30.0], Some([0.0, 0.0, 20.0])),
        ];
        let groups = vec![Arrows { name: "B 0°".to_owned(), arrows }];
        let (symbol, figure) = ("deviation".to_owned(), VectorKind::Paths);
        let mut figure = ArrowFigure { symbol, unit: Unit::Um, groups, figure };
        let common = Common::of(&figure).unwrap();
        // 80 units per 0.040 mm against 140 units per 100 mm.
        assert!((common.magnified(Unit::Um).unwrap() - 80.0 / 0.040 / 1.4).abs() < 1e-6);
        assert_eq!(common.magnified(Unit::Urad), None);
        let svg = common.draw_path(&figure.groups[0]).unwrap();
        let rings = |radius: &str| -> Vec<[String; 2]> {
            let marked = svg.lines().filter(|line| line.contains(&format!(" r=\"{radius}\"")));
            marked.map(|l| ["cx", "cy"].map(|name| attributes(l, name)[0].to_owned())).collect()
        };
        let commanded = [["110", "250"], ["390", "250"], ["610", "250"], ["890", "250"]];
        assert_eq!(rings("6")[..4], commanded);
        assert_eq!(rings("6")[4..6], [["1250", "250"]; 2]);
        let measured = [["190", "250"], ["390", "230"], ["690", "250"], ["890", "190"]];
        assert_eq!(rings("9")[..4], measured);
        assert_eq!(rings("9")[4..6], [["1250", "250"], ["1270", "190"]]);
        // The model at one position in each panel, and in the legend.
        assert_eq!(svg.matches("<polygon").count(), 3 + 1 + 1, "{svg}");
        assert!(inside(&svg) && svg.contains("commanded"));
        figure.groups[0].arrows[0].vector[1] = f64::NAN;
        figure.groups[0].arrows[1].modelled = Some([f64::INFINITY; 3]);
        figure.groups[0].arrows[1].vector = [1e9; 3];
        figure.groups[0].arrows[1].flagged = true;
        assert!(inside(&common.draw_path(&figure.groups[0]).unwrap()));
    }
}
