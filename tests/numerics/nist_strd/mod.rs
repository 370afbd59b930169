//! NIST's 27 nonlinear regression problems, each from both of its starting points: our results compared with the
//! certified values. Each is solved twice, by the same function and with the same limits as SAMBA: with all
//! unknowns in one dense block, and with the first of them eliminated as a ball's are. `cargo test --test nist_strd
//! -- --nocapture` prints the table: at least seven digits of parameters and, except for `ROUNDED_AWAY`, six and a
//! half of standard deviations.
//!
//! This test is not a certificate. NIST certifies the values, not programs that reproduce them; and 27 small
//! problems prove nothing about the model or the uncertainties of any machine. It shows that
//! `estimation::nonlinear` finds a minimum, from near and far starting points, to the digits that double precision
//! allows. Problems with many blocks are compared with dense solutions in `estimation/` and with scipy in
//! `benches/samba.rs`.

mod file;
mod models;

use estimation::nonlinear::minimise_squares;
use estimation::schur::{BlockRows, factorise};
use file::{Dataset, read_dataset};
use models::{MODELS, Model};

/// The data have so many digits that the residuals (1e-13 of values near 1) are mostly rounding errors of double
/// precision: their sum of squares, and with it the standard deviations, has three digits.
const DATASET_WITHOUT_RESIDUALS: &str = "Lanczos1";

struct CorrectDigits {
    /// Digits of the worst parameter, of the worst standard deviation, of the residual sum of squares.
    least_digits: [f64; 3],
    factors: usize,
}

/// Solves with the first `own` unknowns eliminated. The sigma of the readings is unknown: 1 for each.
fn solve(dataset: &Dataset, model: Model, start: usize, own: usize) -> Result<CorrectDigits, String> {
    let unknowns = dataset.parameters.len();
    // The common unknowns come first.
    let turned = |b: &[f64], by: usize| -> Vec<f64> { [&b[by..], &b[..by]].concat() };
    let at = |x: &[f64]| -> Vec<(f64, Vec<f64>)> {
        let b = turned(x, unknowns - own);
        dataset.x.iter().map(|x| model(&b, x)).collect()
    };
    let residuals = |x: &[f64]| -> Vec<f64> { dataset.y.iter().zip(at(x)).map(|(y, (value, _))| y - value).collect() };
    let rows = |x: &[f64]| {
        let mut rows = BlockRows::zeros(dataset.y.len(), own, unknowns - own);
        for (i, (y, (value, gradient))) in dataset.y.iter().zip(at(x)).enumerate() {
            rows.set_right_side(i, y - value);
            (0..own).for_each(|j| rows.set_own(i, j, gradient[j]));
            (own..unknowns).for_each(|j| rows.set_common(i, j - own, gradient[j]));
        }
        vec![rows]
    };
    let found = minimise_squares(turned(&dataset.start_values[start], own), rows, residuals)
        .map_err(|error| error.to_string())?;
    let squares = found.residuals.iter().map(|r| r * r).sum::<f64>();
    let scale = (squares / (dataset.y.len() - unknowns) as f64).sqrt();
    // Linearised at the solution, because so many digits are required.
    let covariance = factorise(rows(&found.x)).0.covariance();
    let deviations: Vec<f64> = (0..unknowns).map(|j| scale * covariance[(j, j)].sqrt()).collect();
    let digits = [
        correct_digits(&turned(&found.x, unknowns - own), &dataset.parameters),
        correct_digits(&turned(&deviations, unknowns - own), &dataset.standard_deviations),
        correct_digits(&[squares], &[dataset.residual_sum_of_squares]),
    ];
    Ok(CorrectDigits { least_digits: digits, factors: found.jacobian_evaluation_count })
}

/// Smallest number of correct digits, by the log relative error; 11 digits are certified.
fn correct_digits(found: &[f64], certified: &[f64]) -> f64 {
    assert_eq!(found.len(), certified.len());
    let each = found.iter().zip(certified).map(|(f, c)| -((f - c) / c).abs().log10());
    // A NaN counts as zero digits.
    each.map(|digits| if digits.is_nan() { 0.0 } else { digits }).fold(11.0, f64::min)
}

#[test]
fn all_54_cases_have_at_least_six_digits_dense_and_eliminated() {
    let mut short = Vec::new();
    let mut least = [11.0_f64; 3];
    println!("problem    start  eliminated  parameters  deviations  squares  Jacobians");
    for (name, model) in MODELS {
        let dataset = read_dataset(name);
        for (start, own) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let case = format!("{name:<10} {:>5} {own:>11}", start + 1);
            let CorrectDigits { least_digits: digits, factors } = match solve(&dataset, model, start, own) {
                Ok(found) => found,
                Err(why) => {
                    short.push(format!("{case}: {why}"));
                    continue;
                }
            };
            let [parameters, deviations, squares] = digits;
            println!("{case} {parameters:>11.1} {deviations:>11.1} {squares:>8.1} {factors:>10}");
            let wanted = if name == DATASET_WITHOUT_RESIDUALS { [7.0, 2.0, 2.0] } else { [7.0, 6.5, 9.0] };
            if digits.iter().zip(wanted).any(|(digits, wanted)| *digits < wanted) {
                short.push(format!("{case}: {digits:.1?} digits"));
            }
            if name != DATASET_WITHOUT_RESIDUALS {
                least = std::array::from_fn(|k| least[k].min(digits[k]));
            }
        }
    }
    println!("least but for {DATASET_WITHOUT_RESIDUALS}: {least:.1?}");
    assert!(short.is_empty(), "\n{}", short.join("\n"));
}

#[test]
fn the_table_is_complete() {
    let folder = std::fs::read_dir(file::FOLDER).unwrap();
    let mut files: Vec<String> = folder
        .filter_map(|entry| entry.unwrap().file_name().to_str().map(str::to_owned))
        .filter_map(|name| name.strip_suffix(".dat").map(str::to_owned))
        .collect();
    files.sort();
    let mut modelled = MODELS.map(|(name, _)| name);
    modelled.sort_unstable();
    assert_eq!(files, modelled);
    assert_eq!(files.len(), 27);
}

/// Compares the analytic Jacobians with central differences at the second starting point.
#[test]
fn jacobians_agree_with_finite_differences() {
    for (name, model) in MODELS {
        let dataset = read_dataset(name);
        let b = &dataset.start_values[1];
        for x in &dataset.x {
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
