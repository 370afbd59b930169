//! Single values over time with their uncertainties: control limits from the values before, steps marked.

use plotters::prelude::*;

use super::scale::{Ticked, bounds, widened};
use super::{FIT, GRID, INK, LINE, Sample, picture};
use crate::record::estimate::Unit;
use crate::report::number;

const SIZE: (u32, u32) = (1400, 560);

/// A chart of one value; times in seconds before now, negative.
#[derive(Debug, Clone, Default)]
pub struct Individuals {
    pub symbol: String,
    /// Time, value, expanded uncertainty; in order.
    pub values: Vec<[f64; 3]>,
    /// Lower limit, centre, upper limit; they hold from the value of this index on.
    pub limits: Option<([f64; 3], usize)>,
    /// Times at which it stepped.
    pub steps: Vec<f64>,
}

/// So many seconds are one of it.
const SPANS: [(f64, &str); 4] =
    [(86_400.0, "days"), (3600.0, "hours"), (60.0, "minutes"), (1.0, "seconds")];

impl Individuals {
    /// `None` without a finite value.
    pub fn draw(&self, unit: Unit) -> Option<String> {
        let (scale, word) = self.span();
        let finite = self.values.iter().filter(|value| value.iter().all(|part| part.is_finite()));
        let samples: Vec<Sample> =
            finite.map(|[t_s, y, half]| Sample { x: t_s / scale, y: *y, half: *half }).collect();
        let limits = self.limits.map(|(limits, _)| limits).into_iter().flatten();
        let ends =
            samples.iter().flat_map(|sample| [sample.y - sample.half, sample.y + sample.half]);
        let (low, high) = widened(bounds(ends.chain(limits))?);
        let (first, last) = widened(bounds(samples.iter().map(|sample| sample.x))?);
        let y_name = format!("{} / {}", number::plain_symbol(&self.symbol), number::unit(unit));
        let axes = (Ticked::round(first..last), Ticked::round(low..high));
        picture(SIZE, |area| {
            let x_name = format!("{word} before now");
            let mut chart = super::chart(area, (axes.0, &x_name), (axes.1, &y_name))?;
            if let Some(([lower, centre, upper], from)) = self.limits {
                let begin = self.values.get(from).map_or(first, |[t_s, ..]| t_s / scale);
                let band = [(begin, lower), (last, upper)];
                chart.draw_series([Rectangle::new(band, GRID.mix(0.4).filled())])?;
                for (y, width) in [(lower, 3), (centre, 2), (upper, 3)] {
                    let line = vec![(begin, y), (last, y)];
                    chart.draw_series([PathElement::new(line, FIT.stroke_width(width))])?;
                }
            }
            for t_s in &self.steps {
                let line = vec![(t_s / scale, low), (t_s / scale, high)];
                chart.draw_series([PathElement::new(line, INK.stroke_width(3))])?;
            }
            let bars = samples.iter().map(|Sample { x, y, half }| {
                let ends = vec![(*x, y - half), (*x, y + half)];
                PathElement::new(ends, LINE.mix(0.5).stroke_width(4))
            });
            chart.draw_series(bars)?;
            let joined: Vec<_> = samples.iter().map(|sample| (sample.x, sample.y)).collect();
            chart.draw_series([PathElement::new(joined.clone(), LINE.stroke_width(2))])?;
            chart.draw_series(joined.iter().map(|point| Circle::new(*point, 7, LINE.filled())))?;
            Ok(())
        })
    }

    /// The greatest of which there are at least two.
    fn span(&self) -> (f64, &'static str) {
        let [first, last] = [self.values.first(), self.values.last()]
            .map(|value| value.map_or(0.0, |[t_s, ..]| *t_s));
        let reach = (last - first).max(-first);
        SPANS.into_iter().find(|(scale, _)| reach >= 2.0 * scale).unwrap_or((1.0, "seconds"))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{attributes, inside};
    use super::*;

    #[test]
    fn values_limits_and_steps_stand_where_they_belong() {
        let value = |day: i32| [-86_400.0 * f64::from(10 - day), f64::from(day % 2), 0.5];
        let chart = Individuals {
            symbol: "EX0C".to_owned(),
            values: (0..10).map(value).collect(),
            limits: Some(([-1.0, 0.5, 2.0], 4)),
            steps: vec![-86_400.0 * 6.5],
        };
        let svg = chart.draw(Unit::Um).unwrap();
        assert!(inside(&svg) && svg.contains("days before now"), "{svg}");
        let dots: Vec<f64> = svg
            .lines()
            .filter(|line| line.contains("<circle"))
            .map(|line| attributes(line, "cx")[0].parse().unwrap())
            .collect();
        assert_eq!(dots.len(), 10);
        assert!(dots.windows(2).all(|pair| pair[1] > pair[0]));
        let band = svg.lines().find(|line| line.contains("<rect") && line.contains("0.4")).unwrap();
        // The limits begin at the fifth value.
        let begins: f64 = attributes(band, "x")[0].parse().unwrap();
        assert!((begins - dots[4]).abs() <= 1.0, "{begins} {dots:?}");
        let none = Individuals { values: vec![[0.0, f64::NAN, 1.0]], ..chart.clone() };
        assert_eq!(none.draw(Unit::Um), None);
        let soon =
            Individuals { values: vec![[-30.0, 1.0, 1.0]], limits: None, steps: vec![], ..chart };
        assert!(soon.draw(Unit::Um).unwrap().contains("seconds before now"));
    }
}
