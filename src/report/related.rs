//! How much the results depend on each other: the correlation matrix and its strongest pairs.

use minijinja::{Value, context};

use super::figure;
use super::number;
use machine::record::estimate::Covariance;

/// Pairs beyond this are named, the strongest of them.
const STRONG: f64 = 0.5;
const NAMED: usize = 8;

/// `svg` is none where there is nothing to draw.
pub(super) fn related(covariance: &Covariance) -> Value {
    let drawn = figure::matrix(covariance);
    let pairs = if drawn.is_some() { strongest(covariance) } else { Vec::new() };
    let named: Vec<Value> =
        pairs.iter().take(NAMED).map(|pair| in_words(covariance, pair)).collect();
    context! {
        svg => drawn.map_or(Value::from(()), Value::from_safe_string),
        strong => STRONG,
        count => pairs.len(),
        named,
    }
}

/// Beyond [`STRONG`], strongest first.
fn strongest(covariance: &Covariance) -> Vec<(usize, usize, f64)> {
    let count = covariance.symbols.len();
    let all = (0..count).flat_map(|i| (i + 1..count).map(move |j| (i, j)));
    let known = all.filter_map(|(i, j)| Some((i, j, figure::correlation(covariance, i, j)?)));
    let mut pairs: Vec<_> = known.filter(|(_, _, value)| value.abs() >= STRONG).collect();
    pairs.sort_by(|a, b| b.2.abs().total_cmp(&a.2.abs()));
    pairs
}

fn in_words(covariance: &Covariance, (i, j, value): &(usize, usize, f64)) -> Value {
    let symbol = |n: usize| {
        let (base, index) = number::split_symbol(&covariance.symbols[n]);
        context! { plain => covariance.symbols[n].clone(), base, index }
    };
    // What is missing to 1 counts.
    let decimals = number::decimals(1.0 - value.abs()).max(2);
    context! { one => symbol(*i), other => symbol(*j), value => number::fixed(*value, decimals) }
}
