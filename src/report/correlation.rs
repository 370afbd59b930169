//! Correlation of the results: the correlation matrix and its strongest pairs.

use minijinja::{Value, context};

use super::captions::{svg_value, symbol_value};
use super::figure;
use super::number;
use machine::record::estimate::ParameterCovariance;

/// Minimum magnitude of the correlation of a listed pair.
const MIN_LISTED_CORRELATION: f64 = 0.5;
/// Maximum number of listed pairs.
const MAX_LISTED_CORRELATIONS: usize = 8;
/// Minimum number of parameters for a matrix.
const MIN_MATRIX_PARAMETERS: usize = 3;
/// Maximum number of parameters in the matrix; more would not be legible.
const MAX_MATRIX_PARAMETERS: usize = 15;
/// Maximum number of parameters for correlations on the page. The estimate file always contains all correlations.
const MAX_PARAMETERS_WITH_CORRELATIONS: usize = 60;

/// Correlation coefficient of two parameters.
struct CorrelatedPair {
    /// Index of the first parameter in the covariance.
    first: usize,
    second: usize,
    /// Correlation coefficient, −1 to 1.
    coefficient: f64,
}

/// Template values; `svg` is none if there is nothing to draw.
pub(super) fn correlation_values(covariance: &ParameterCovariance) -> Value {
    let count = covariance.symbols.len();
    let pairs = if (MIN_MATRIX_PARAMETERS..=MAX_PARAMETERS_WITH_CORRELATIONS).contains(&count) {
        pairs_by_correlation(covariance)
    } else {
        Vec::new()
    };
    let shown = matrix_parameters(covariance, &pairs);
    let drawn = (shown.len() >= MIN_MATRIX_PARAMETERS && count <= MAX_PARAMETERS_WITH_CORRELATIONS)
        .then(|| figure::draw_matrix(covariance, &shown))
        .flatten();
    let is_listed = |pair: &&CorrelatedPair| {
        let is_in_matrix = shown.contains(&pair.first) || shown.contains(&pair.second);
        is_in_matrix && pair.coefficient.abs() >= MIN_LISTED_CORRELATION
    };
    let strong: Vec<&CorrelatedPair> = pairs.iter().filter(is_listed).collect();
    let named = strong.iter().take(MAX_LISTED_CORRELATIONS).map(|pair| pair_template_value(covariance, pair));
    context! {
        svg => svg_value(drawn),
        shown => shown.len(),
        parameters => count,
        strong => MIN_LISTED_CORRELATION,
        least => figure::MIN_SHOWN_COEFFICIENT,
        count => strong.len(),
        named => named.collect::<Vec<_>>(),
    }
}

/// Parameters of the matrix, in their order: all, or else the machine errors, or else those with the strongest
/// correlations.
fn matrix_parameters(covariance: &ParameterCovariance, pairs: &[CorrelatedPair]) -> Vec<usize> {
    let all: Vec<usize> = (0..covariance.symbols.len()).collect();
    if all.len() <= MAX_MATRIX_PARAMETERS {
        return all;
    }
    let is_machine_error = |n: &usize| number::split_into_base_and_index(&covariance.symbols[*n]).0 == "E";
    let machine_errors: Vec<usize> = all.into_iter().filter(is_machine_error).collect();
    if (MIN_MATRIX_PARAMETERS..=MAX_MATRIX_PARAMETERS).contains(&machine_errors.len()) {
        return machine_errors;
    }
    let mut strongest: Vec<usize> = Vec::new();
    for n in pairs.iter().flat_map(|pair| [pair.first, pair.second]) {
        if strongest.len() < MAX_MATRIX_PARAMETERS && !strongest.contains(&n) {
            strongest.push(n);
        }
    }
    strongest.sort_unstable();
    strongest
}

/// All pairs with a known correlation, strongest first.
fn pairs_by_correlation(covariance: &ParameterCovariance) -> Vec<CorrelatedPair> {
    let count = covariance.symbols.len();
    let all = (0..count).flat_map(|first| (first + 1..count).map(move |second| (first, second)));
    let known = all.filter_map(|(first, second)| {
        let coefficient = figure::correlation_coefficient(covariance, first, second)?;
        Some(CorrelatedPair { first, second, coefficient })
    });
    let mut pairs: Vec<_> = known.collect();
    pairs.sort_by(|a, b| b.coefficient.abs().total_cmp(&a.coefficient.abs()));
    pairs
}

fn pair_template_value(covariance: &ParameterCovariance, pair: &CorrelatedPair) -> Value {
    // The decimals depend on the difference from 1.
    let decimals = number::decimals_for_uncertainty(1.0 - pair.coefficient.abs()).max(2);
    context! {
        one => symbol_value(&covariance.symbols[pair.first]),
        other => symbol_value(&covariance.symbols[pair.second]),
        value => number::format_fixed(pair.coefficient, decimals),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parameters with these symbols; those at `pair` have the correlation 0.9, all others 0.1.
    fn covariance_of(symbols: Vec<String>, pair: [usize; 2]) -> ParameterCovariance {
        let entry = |i: usize, j: usize| match i == j {
            true => 1.0,
            false if pair.contains(&i) && pair.contains(&j) => 0.9,
            false => 0.1,
        };
        let count = symbols.len();
        ParameterCovariance { symbols, rows: (0..count).map(|i| (0..count).map(|j| entry(i, j)).collect()).collect() }
    }

    fn shown_parameters(covariance: &ParameterCovariance) -> Vec<usize> {
        matrix_parameters(covariance, &pairs_by_correlation(covariance))
    }

    #[test]
    fn matrix_shows_at_most_15_parameters() {
        let balls = |count: usize| (0..count).map(|n| format!("ball_{n}_x")).collect::<Vec<_>>();
        assert_eq!(shown_parameters(&covariance_of(balls(15), [3, 7])), (0..15).collect::<Vec<_>>());
        // Machine errors are shown alone.
        let errors = ["EX0C", "EY0C", "EA0B", "EC0Y"].map(str::to_owned).to_vec();
        let with_errors = covariance_of([balls(20), errors].concat(), [3, 7]);
        assert_eq!(shown_parameters(&with_errors), [20, 21, 22, 23]);
        // Without machine errors, the parameters of the strongest correlations.
        let shown = shown_parameters(&covariance_of(balls(40), [31, 37]));
        assert_eq!(shown.len(), MAX_MATRIX_PARAMETERS);
        assert!(shown.contains(&31) && shown.contains(&37) && shown.is_sorted(), "{shown:?}");
    }

    #[test]
    fn listed_pairs_contain_a_shown_parameter() {
        let balls = (0..20).map(|n| format!("ball_{n}_x"));
        let errors = ["EX0C", "EY0C", "EA0B"].map(str::to_owned);
        let symbols: Vec<String> = balls.chain(errors).collect();
        let listed = |pair| correlation_values(&covariance_of(symbols.clone(), pair)).to_string();
        assert!(listed([3, 21]).contains("0.90") && !listed([3, 7]).contains("0.90"));
        let svg_of = |count: usize| {
            let symbols = (0..count).map(|n| format!("ball_{n}_x")).collect();
            correlation_values(&covariance_of(symbols, [0, 1])).to_string().contains("<svg")
        };
        assert_eq!([2, 3, 60, 61].map(svg_of), [false, true, true, false]);
    }
}
