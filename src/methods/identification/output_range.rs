//! Range of a function whose points are linear in the unknowns, such as a total error motion: largest minus
//! smallest value.

use faer::{Mat, MatRef};
use machine::record::estimate::Unit;

use super::outputs::{NonlinearOutputs, OutputParameter};

/// The largest minus the smallest value of a function at its points, as a parameter of the estimate.
pub struct RangeOutput {
    pub symbol: String,
    /// Unit in which the estimate reports the range.
    pub unit: Unit,
    /// Points × unknowns: derivative of each point by each unknown, internal units.
    pub slopes: Vec<Vec<f64>>,
}

/// Largest minus smallest value; −∞ if there are no values.
pub fn value_range(values: &[f64]) -> f64 {
    let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let smallest = values.iter().copied().fold(f64::INFINITY, f64::min);
    largest - smallest
}

/// The ranges at the solution `x`. Their uncertainty comes from the trials.
pub fn range_outputs(ranges: Vec<RangeOutput>, x: &[f64]) -> NonlinearOutputs {
    let matrix = |range: &RangeOutput| Mat::from_fn(range.slopes.len(), x.len(), |i, j| range.slopes[i][j]);
    let slopes: Vec<Mat<f64>> = ranges.iter().map(matrix).collect();
    let solution = Mat::from_fn(1, x.len(), |_, j| x[j]);
    let outputs = ranges.into_iter().zip(&slopes).map(|(range, slopes)| OutputParameter {
        symbol: range.symbol,
        unit: range.unit,
        value: ranges_of_trials(slopes, solution.as_ref())[0],
        linear_slope: None,
    });
    let outputs = outputs.collect();
    let values = move |trials: MatRef<'_, f64>| {
        let columns: Vec<Vec<f64>> = slopes.iter().map(|s| ranges_of_trials(s, trials)).collect();
        Mat::from_fn(trials.nrows(), columns.len(), |trial, j| columns[j][trial])
    };
    NonlinearOutputs { outputs, trial_values: Box::new(values) }
}

/// Largest minus smallest value of the function in each trial; `trials`: trials × unknowns.
fn ranges_of_trials(slopes: &Mat<f64>, trials: MatRef<'_, f64>) -> Vec<f64> {
    let points = slopes * trials.transpose();
    (0..points.ncols()).map(|trial| value_range(points.col_as_slice(trial))).collect()
}
