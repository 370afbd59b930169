//! Vectors at positions in space: one figure with all groups, the group with the largest vectors, and the size of the
//! vectors of each group.

use minijinja::{Value, context};

use super::captions::{svg_value, symbol_value};
use super::figure::{self, ArrowScales};
use super::number;
use machine::record::estimate::{
    ArrowFigure, ArrowGroup, EstimatedFunction, FigureArrow, FunctionFigureKind, VectorFigureKind,
};

/// Minimum number of groups for a figure of the vector size of each group.
const MIN_GROUPS_IN_SIZE_FIGURE: usize = 3;
/// Decimals of a length in µm.
const LENGTH_DECIMALS: usize = 1;

pub(super) fn vector_figure_value(figure: &ArrowFigure) -> Value {
    let scales = ArrowScales::new(figure);
    let worst = worst_group(figure);
    let flagged = figure.groups.iter().flat_map(|group| {
        let flagged = group.arrows.iter().filter(|arrow| arrow.flagged);
        flagged.map(|arrow| describe_arrow(figure, &group.name, arrow))
    });
    context! {
        symbol => symbol_value(&figure.symbol),
        all => svg_value(scales.as_ref().and_then(|scales| scales.draw_all(figure))),
        count => figure.groups.len(),
        has_arrows => figure.figure == VectorFigureKind::Arrows,
        worst => worst.filter(|_| figure.groups.len() > 1).map(|(group, rms)| context! {
            name => with_minus_signs(&group.name),
            rms => format!("{} {}", number::format_fixed(rms, LENGTH_DECIMALS), figure.unit.symbol()),
            svg => svg_value(scales.as_ref().and_then(|scales| scales.draw_group(group, figure.figure))),
        }),
        sizes => svg_value(group_rms_function(figure).and_then(|function| figure::draw_function(&function, 1.0))),
        flagged => flagged.collect::<Vec<_>>(),
        cut => scales.as_ref().is_some_and(|scales| scales.has_shortened_arrows(figure)),
        magnified => scales
            .and_then(|scales| scales.magnification(figure.unit))
            .map(|by| format!("magnified {} times", round_to_two_digits(by))),
    }
}

fn round_to_two_digits(value: f64) -> f64 {
    let digit = 10f64.powf(value.log10().floor() - 1.0);
    (value / digit).round() * digit
}

/// The group with the largest root mean square of its vectors.
fn worst_group(figure: &ArrowFigure) -> Option<(&ArrowGroup, f64)> {
    let sizes = figure.groups.iter().filter_map(|group| Some((group, figure::group_rms(group)?)));
    sizes.max_by(|one, other| one.1.total_cmp(&other.1))
}

/// Root mean square of the vectors of each group over the group number; `None` for fewer than
/// [`MIN_GROUPS_IN_SIZE_FIGURE`].
fn group_rms_function(figure: &ArrowFigure) -> Option<EstimatedFunction> {
    let numbered = (1..).map(f64::from).zip(&figure.groups);
    let (x, y): (Vec<f64>, Vec<f64>) = numbered.filter_map(|(n, group)| Some((n, figure::group_rms(group)?))).unzip();
    (x.len() >= MIN_GROUPS_IN_SIZE_FIGURE).then(|| EstimatedFunction {
        symbol: "rms".to_owned(),
        argument: "group number".to_owned(),
        argument_unit: String::new(),
        u: Vec::new(),
        x,
        y,
        unit: figure.unit,
        figure: FunctionFigureKind::Points,
        at_mm: None,
    })
}

fn describe_arrow(figure: &ArrowFigure, group: &str, FigureArrow { label, vector, .. }: &FigureArrow) -> String {
    let [x, y, z] = vector.map(|part| number::format_fixed(part, LENGTH_DECIMALS));
    let group = with_minus_signs(group);
    format!("{label} at {group}: ({x}, {y}, {z}) {}", figure.unit.symbol())
}

/// The name of a group, such as `B -30°`, with a minus sign instead of the hyphen before a number.
fn with_minus_signs(name: &str) -> String {
    let mut text = String::with_capacity(name.len());
    let mut letters = name.chars().peekable();
    while let Some(letter) = letters.next() {
        let is_sign = letter == '-' && letters.peek().is_some_and(char::is_ascii_digit);
        text.push(if is_sign { '−' } else { letter });
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::record::estimate::Unit;

    /// One arrow of this length for each group, along Y.
    fn figure_with_lengths(lengths_um: &[f64]) -> ArrowFigure {
        let arrow = |(n, length): (usize, &f64)| FigureArrow {
            label: "ball 1".to_owned(),
            at_mm: [10.0 * n as f64, 0.0, 0.0],
            vector: [0.0, *length, 0.0],
            modelled: None,
            flagged: false,
        };
        let group = |(n, arrow): (usize, FigureArrow)| ArrowGroup { name: format!("C {n}°"), arrows: vec![arrow] };
        let groups = lengths_um.iter().enumerate().map(arrow).enumerate().map(group).collect();
        ArrowFigure { symbol: "residuals".to_owned(), unit: Unit::Um, groups, figure: VectorFigureKind::Arrows }
    }

    /// Thirty groups have three pictures: all together, the largest, and the sizes in their order.
    #[test]
    fn many_groups_have_one_figure() {
        let lengths: Vec<f64> = (0..30).map(|n| f64::from((7 * n) % 30)).collect();
        let figure = figure_with_lengths(&lengths);
        let value = vector_figure_value(&figure).to_string();
        assert_eq!(value.matches("<svg").count(), 3);
        // 7·17 = 119 = 29 + 3·30.
        let (worst, rms) = worst_group(&figure).unwrap();
        assert_eq!((worst.name.as_str(), rms), ("C 17°", 29.0));
        assert_eq!(group_rms_function(&figure).unwrap().y, lengths);
    }

    #[test]
    fn single_group_has_one_picture() {
        let value = vector_figure_value(&figure_with_lengths(&[2.0])).to_string();
        assert_eq!(value.matches("<svg").count(), 1);
        assert_eq!(vector_figure_value(&figure_with_lengths(&[])).to_string().matches("<svg").count(), 0);
    }

    #[test]
    fn negative_angles_have_a_minus_sign() {
        for (name, expected) in
            [("B -30°, C 90°", "B −30°, C 90°"), ("B-90 C0", "B−90 C0"), ("re-clamped", "re-clamped")]
        {
            assert_eq!(with_minus_signs(name), expected);
        }
    }

    #[test]
    fn magnification_has_two_digits() {
        for (value, expected) in [(51_577.2, 52_000.0), (587.0, 590.0), (9.96, 10.0), (4.44, 4.4)] {
            assert!((round_to_two_digits(value) - expected).abs() < 1e-9, "{value}");
        }
    }
}
