//! Vectors at positions in space: a picture of each group, and the flagged vectors in words.

use minijinja::{Value, context};

use super::figure;
use super::number;
use machine::record::estimate::{ArrowFigure, FigureArrow, VectorFigureKind};

pub(super) fn vector_figure_value(figure: &ArrowFigure) -> Value {
    let common = figure::ArrowScales::new(figure);
    let groups = figure.groups.iter().map(|group| {
        let drawn = common.as_ref().and_then(|common| match figure.figure {
            VectorFigureKind::Arrows => common.draw(group),
            VectorFigureKind::Paths => common.draw_path(group),
        });
        context! {
            name => group.name.as_str(),
            svg => drawn.map_or(Value::from(()), Value::from_safe_string),
        }
    });
    let flagged = figure.groups.iter().flat_map(|group| {
        let flagged = group.arrows.iter().filter(|arrow| arrow.flagged);
        flagged.map(|arrow| describe_arrow(figure, &group.name, arrow))
    });
    let (base, index) = number::split_into_base_and_index(&figure.symbol);
    context! {
        symbol => context! { plain => figure.symbol.as_str(), base, index },
        groups => groups.collect::<Vec<_>>(),
        flagged => flagged.collect::<Vec<_>>(),
        cut => common.as_ref().is_some_and(|common| common.has_shortened_arrows(figure)),
        magnified => common
            .and_then(|common| common.magnification(figure.unit))
            .map(|by| format!("magnified {by:.0} times")),
    }
}

fn describe_arrow(figure: &ArrowFigure, group: &str, FigureArrow { label, vector, .. }: &FigureArrow) -> String {
    let [x, y, z] = vector.map(|part| number::format_fixed(part, 1));
    format!("{label} at {group}: ({x}, {y}, {z}) {}", number::unit_symbol(figure.unit))
}
