//! Reported quantities as functions of the unknowns.

use faer::{Mat, MatRef};
use machine::kinematics::{ErrorParameter, ErrorShape};
use machine::record::estimate::{FunctionFigureKind, Unit};

/// A parameter of the estimate. Internal units: mm, rad, mm/mm, s.
#[derive(Debug, Clone)]
pub struct OutputParameter {
    pub symbol: String,
    /// Unit in which the estimate reports the parameter.
    pub unit: Unit,
    /// Value at the solution, internal unit.
    pub value: f64,
    /// Derivative by each unknown, internal units. `None`: its uncertainty comes from the trials alone.
    pub linear_slope: Option<Vec<f64>>,
}

impl OutputParameter {
    /// The output coefficients·x.
    pub fn from_coefficients(symbol: &str, unit: Unit, coefficients: Vec<f64>, x: &[f64]) -> Self {
        let value = dot_product(&coefficients, x);
        Self { symbol: symbol.to_owned(), unit, value, linear_slope: Some(coefficients) }
    }

    /// The output that is the unknown `index` of `x`.
    pub fn from_unknown(symbol: &str, unit: Unit, index: usize, x: &[f64]) -> Self {
        Self::from_coefficients(symbol, unit, slope_of_unknown(index, x.len()), x)
    }
}

/// The sum coefficients·x.
pub fn dot_product(coefficients: &[f64], x: &[f64]) -> f64 {
    coefficients.iter().zip(x).map(|(c, x)| c * x).sum()
}

/// Derivative of the unknown `index` by each of the `unknowns`: a unit vector.
pub fn slope_of_unknown(index: usize, unknowns: usize) -> Vec<f64> {
    (0..unknowns).map(|j| f64::from(u8::from(j == index))).collect()
}

/// A function of the estimate whose points are linear in the unknowns. Its u is of first order.
#[derive(Debug, Clone)]
pub struct OutputCurve {
    pub symbol: String,
    /// Name of the argument: an axis, or e.g. `ball` or `position`.
    pub argument: &'static str,
    pub argument_unit: &'static str,
    /// Arguments in `argument_unit`.
    pub x: Vec<f64>,
    /// Values at the solution, internal unit.
    pub y: Vec<f64>,
    /// Unit in which the estimate reports y.
    pub unit: Unit,
    pub figure: FunctionFigureKind,
    /// Points × unknowns: derivative of each y by each unknown, internal units.
    pub slopes: Vec<Vec<f64>>,
}

/// Function from trials × unknowns to trials × outputs, internal units.
pub type TrialFunction = Box<dyn Fn(MatRef<'_, f64>) -> Mat<f64> + Send + Sync>;

/// Parameters that are nonlinear functions of the unknowns, such as the centre of a circle or a largest
/// deviation. They are not in the covariance. A parameter without slope has no budget; its u comes from the
/// trials and is NaN without trials.
pub struct NonlinearOutputs {
    pub outputs: Vec<OutputParameter>,
    /// Values of the outputs, in their order.
    pub trial_values: TrialFunction,
}

/// Quantities that an identification reports.
#[derive(Default)]
pub struct IdentificationOutputs {
    /// Linear parameters with budget and covariance. Each has a slope.
    pub linear_parameters: Vec<OutputParameter>,
    pub curves: Vec<OutputCurve>,
    pub nonlinear: Option<NonlinearOutputs>,
}

impl IdentificationOutputs {
    /// Derivatives of the `linear_parameters`: outputs × unknowns. NaN if a slope is missing.
    pub fn linear_parameter_slopes(&self, unknowns: usize) -> Mat<f64> {
        let slope = |i: usize| self.linear_parameters[i].linear_slope.as_deref().unwrap_or_default();
        Mat::from_fn(self.linear_parameters.len(), unknowns, |i, j| slope(i).get(j).copied().unwrap_or(f64::NAN))
    }

    /// Parameters in the order of the estimate: linear parameters, then nonlinear ones.
    pub fn all_parameters(&self) -> impl Iterator<Item = &OutputParameter> {
        self.linear_parameters.iter().chain(self.nonlinear.iter().flat_map(|of| &of.outputs))
    }

    /// Functions that each trial computes, as functions × unknowns: the parameters, or all unknowns if some
    /// parameters are nonlinear.
    pub fn trial_function_slopes(&self, unknowns: usize) -> Mat<f64> {
        match &self.nonlinear {
            None => self.linear_parameter_slopes(unknowns),
            Some(_) => Mat::identity(unknowns, unknowns),
        }
    }

    /// Trials × parameters in the order of the estimate, internal units, from the values (trials × functions)
    /// of the functions that each trial computes. A linear parameter is computed as slope·x; if its value differs
    /// from that, its trials are shifted by a constant.
    pub fn parameters_from_trial_functions(&self, values: Mat<f64>) -> Mat<f64> {
        let Some(nonlinear) = &self.nonlinear else { return values };
        let linear = &values * self.linear_parameter_slopes(values.ncols()).transpose();
        let others = (nonlinear.trial_values)(values.as_ref());
        Mat::from_fn(values.nrows(), linear.ncols() + others.ncols(), |trial, j| match j.checked_sub(linear.ncols()) {
            Some(j) => others[(trial, j)],
            None => linear[(trial, j)],
        })
    }
}

/// Derivatives of `function` at `arguments` by central differences of half width `step`: values × arguments. `None`:
/// `function` has no value at one of these points.
pub fn central_differences(
    arguments: &[f64],
    step: f64,
    function: impl Fn(&[f64]) -> Option<Vec<f64>>,
) -> Option<Vec<Vec<f64>>> {
    let mut slopes = vec![vec![0.0; arguments.len()]; function(arguments)?.len()];
    for j in 0..arguments.len() {
        let moved = |by: f64| {
            let mut moved = arguments.to_vec();
            moved[j] += by;
            function(&moved)
        };
        for (slope, (up, down)) in slopes.iter_mut().zip(moved(step)?.iter().zip(moved(-step)?)) {
            slope[j] = (up - down) / (2.0 * step);
        }
    }
    Some(slopes)
}

/// The unit in which an error parameter is reported.
pub fn reported_unit(error: &ErrorParameter) -> Unit {
    match (error.shape(), error.component().is_linear()) {
        (ErrorShape::Gain, _) => Unit::UmPerM,
        (_, true) => Unit::Um,
        (_, false) => Unit::Urad,
    }
}
