//! Correlation of the results: the correlation matrix and its strongest pairs.

use minijinja::{Value, context};

use super::figure;
use super::number;
use machine::record::estimate::ParameterCovariance;

/// Minimum magnitude of the correlation of a listed pair.
const MIN_LISTED_CORRELATION: f64 = 0.5;
/// Maximum number of listed pairs.
const MAX_LISTED_CORRELATIONS: usize = 8;

/// Template values; `svg` is none if there is nothing to draw.
pub(super) fn correlation_values(covariance: &ParameterCovariance) -> Value {
    let drawn = figure::draw_matrix(covariance);
    let pairs = if drawn.is_some() { strongest_correlated_pairs(covariance) } else { Vec::new() };
    let named: Vec<Value> =
        pairs.iter().take(MAX_LISTED_CORRELATIONS).map(|pair| pair_template_value(covariance, pair)).collect();
    context! {
        svg => drawn.map_or(Value::from(()), Value::from_safe_string),
        strong => MIN_LISTED_CORRELATION,
        count => pairs.len(),
        named,
    }
}

/// Pairs at or above [`MIN_LISTED_CORRELATION`], strongest first.
fn strongest_correlated_pairs(covariance: &ParameterCovariance) -> Vec<(usize, usize, f64)> {
    let count = covariance.symbols.len();
    let all = (0..count).flat_map(|i| (i + 1..count).map(move |j| (i, j)));
    let known = all.filter_map(|(i, j)| Some((i, j, figure::correlation_coefficient(covariance, i, j)?)));
    let mut pairs: Vec<_> = known.filter(|(_, _, value)| value.abs() >= MIN_LISTED_CORRELATION).collect();
    pairs.sort_by(|a, b| b.2.abs().total_cmp(&a.2.abs()));
    pairs
}

fn pair_template_value(covariance: &ParameterCovariance, (i, j, value): &(usize, usize, f64)) -> Value {
    let symbol = |n: usize| {
        let (base, index) = number::split_into_base_and_index(&covariance.symbols[n]);
        context! { plain => covariance.symbols[n].clone(), base, index }
    };
    // The decimals depend on the difference from 1.
    let decimals = number::decimals_for_uncertainty(1.0 - value.abs()).max(2);
    context! { one => symbol(*i), other => symbol(*j), value => number::format_fixed(*value, decimals) }
}
