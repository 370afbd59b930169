//! NIST's 27 nonlinear regression problems, each from both of its starting points: our results compared with the
//! certified values. Each is solved twice, by the same function and with the same limits as SAMBA: with all
//! unknowns in one dense block, and with the first of them eliminated as a ball's are.
//! `cargo test -p numerics nist_strd -- --nocapture` prints the table: at least seven digits of parameters and, except
//! for `DATASET_WITH_ROUNDING_RESIDUALS`, six and a half of standard deviations.
//!
//! This test is not a certificate. NIST certifies the values, not programs that reproduce them; and 27 small
//! problems prove nothing about the model or the uncertainties of any machine. It shows that
//! `estimation::nonlinear` finds a minimum, from near and far starting points, to the digits that double precision
//! allows. Problems with many blocks are compared with dense solutions in `estimation/` and with scipy in
//! `benches/samba.rs`.

mod dataset_file;
mod regression_models;

use dataset_file::{Dataset, read_dataset};
use estimation::nonlinear_least_squares::minimise_squares;
use estimation::schur::{BlockRows, factorise_and_project_right_side};
use regression_models::{DATASET_MODELS, Model};

/// The data have so many digits that the residuals (1e-13 of values near 1) are mostly rounding errors of double
/// precision: their sum of squares, and with it the standard deviations, has three digits.
const DATASET_WITH_ROUNDING_RESIDUALS: &str = "Lanczos1";

struct SolutionAccuracy {
    /// Correct digits of the worst parameter, of the worst standard deviation, of the residual sum of squares.
    min_correct_digits: [f64; 3],
    jacobian_evaluation_count: usize,
}

/// Solves with the first `eliminated_count` unknowns eliminated. The sigma of the readings is unknown: 1 for each.
fn solve_nist_problem(
    dataset: &Dataset,
    model: Model,
    start_index: usize,
    eliminated_count: usize,
) -> Result<SolutionAccuracy, String> {
    let unknowns = dataset.certified_parameters.len();
    // The common unknowns come first.
    let turned = |b: &[f64], by: usize| -> Vec<f64> { [&b[by..], &b[..by]].concat() };
    let at = |x: &[f64]| -> Vec<(f64, Vec<f64>)> {
        let b = turned(x, unknowns - eliminated_count);
        dataset.predictors.iter().map(|x| model(&b, x)).collect()
    };
    let residuals =
        |x: &[f64]| -> Vec<f64> { dataset.responses.iter().zip(at(x)).map(|(y, (value, _))| y - value).collect() };
    let rows = |x: &[f64]| {
        let mut rows = BlockRows::zeros(dataset.responses.len(), eliminated_count, unknowns - eliminated_count);
        for (i, (y, (value, gradient))) in dataset.responses.iter().zip(at(x)).enumerate() {
            rows.set_right_side(i, y - value);
            (0..eliminated_count).for_each(|j| rows.set_own_coefficient(i, j, gradient[j]));
            (eliminated_count..unknowns)
                .for_each(|j| rows.set_common_coefficient(i, j - eliminated_count, gradient[j]));
        }
        vec![rows]
    };
    let found = minimise_squares(turned(&dataset.start_values[start_index], eliminated_count), rows, residuals)
        .map_err(|error| error.to_string())?;
    let squares = found.residuals.iter().map(|r| r * r).sum::<f64>();
    let scale = (squares / (dataset.responses.len() - unknowns) as f64).sqrt();
    // Linearised at the solution, because so many digits are required.
    let covariance = factorise_and_project_right_side(rows(&found.x)).0.covariance();
    let deviations: Vec<f64> = (0..unknowns).map(|j| scale * covariance[(j, j)].sqrt()).collect();
    let digits = [
        min_correct_digits(&turned(&found.x, unknowns - eliminated_count), &dataset.certified_parameters),
        min_correct_digits(&turned(&deviations, unknowns - eliminated_count), &dataset.certified_standard_deviations),
        min_correct_digits(&[squares], &[dataset.certified_residual_sum_of_squares]),
    ];
    Ok(SolutionAccuracy { min_correct_digits: digits, jacobian_evaluation_count: found.jacobian_evaluation_count })
}

/// Smallest number of correct digits, by the log relative error; 11 digits are certified.
fn min_correct_digits(found: &[f64], certified: &[f64]) -> f64 {
    assert_eq!(found.len(), certified.len());
    let each = found.iter().zip(certified).map(|(f, c)| -((f - c) / c).abs().log10());
    // A NaN counts as zero digits.
    each.map(|digits| if digits.is_nan() { 0.0 } else { digits }).fold(11.0, f64::min)
}

#[test]
fn nist_parameters_agree_to_seven_digits_from_54_starts() {
    let mut short = Vec::new();
    let mut least = [11.0_f64; 3];
    println!("problem    start  eliminated  parameters  deviations  squares  Jacobians");
    for (name, model) in DATASET_MODELS {
        let dataset = read_dataset(name);
        for (start, own) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let case = format!("{name:<10} {:>5} {own:>11}", start + 1);
            let SolutionAccuracy { min_correct_digits: digits, jacobian_evaluation_count: factors } =
                match solve_nist_problem(&dataset, model, start, own) {
                    Ok(found) => found,
                    Err(why) => {
                        short.push(format!("{case}: {why}"));
                        continue;
                    }
                };
            let [parameters, deviations, squares] = digits;
            println!("{case} {parameters:>11.1} {deviations:>11.1} {squares:>8.1} {factors:>10}");
            let wanted = if name == DATASET_WITH_ROUNDING_RESIDUALS { [7.0, 2.0, 2.0] } else { [7.0, 6.5, 9.0] };
            if digits.iter().zip(wanted).any(|(digits, wanted)| *digits < wanted) {
                short.push(format!("{case}: {digits:.1?} digits"));
            }
            if name != DATASET_WITH_ROUNDING_RESIDUALS {
                least = std::array::from_fn(|k| least[k].min(digits[k]));
            }
        }
    }
    println!("least but for {DATASET_WITH_ROUNDING_RESIDUALS}: {least:.1?}");
    assert!(short.is_empty(), "\n{}", short.join("\n"));
}

#[test]
fn each_nist_dataset_has_a_model() {
    let folder = std::fs::read_dir(dataset_file::NIST_STRD_FOLDER).unwrap();
    let mut files: Vec<String> = folder
        .filter_map(|entry| entry.unwrap().file_name().to_str().map(str::to_owned))
        .filter_map(|name| name.strip_suffix(".dat").map(str::to_owned))
        .collect();
    files.sort();
    let mut modelled = DATASET_MODELS.map(|(name, _)| name);
    modelled.sort_unstable();
    assert_eq!(files, modelled);
    assert_eq!(files.len(), 27);
}

/// Compares the analytic Jacobians with central differences at the second starting point.
#[test]
fn jacobians_agree_with_finite_differences() {
    for (name, model) in DATASET_MODELS {
        let dataset = read_dataset(name);
        let b = &dataset.start_values[1];
        for x in &dataset.predictors {
            let (value, gradient) = model(b, x);
            for j in 0..b.len() {
                let step = 1e-6 * b[j].abs();
                let at = |by: f64| {
                    let mut moved = b.clone();
                    moved[j] += by;
                    model(&moved, x).0
                };
                let difference = (at(step) - at(-step)) / (2.0 * step);
                let scale = gradient[j].abs() + 1e-3 * (value / b[j]).abs();
                let error = (gradient[j] - difference).abs();
                assert!(error <= 1e-5 * scale, "{name} b{} at {x:?}: {error:e}", j + 1);
            }
        }
    }
}
