//! The estimate in its published form: parameters, covariance and functions.

use std::collections::BTreeMap;

use estimation::coverage::{COVERAGE_PROBABILITY, coverage_factor};
use estimation::monte_carlo::TrialStatistics;
use machine::record::estimate::{
    BudgetLine, ESTIMATE_VERSION, Estimate, EstimatedFunction, Parameter, ParameterCovariance, SourceEffect, Unit,
    Verdict,
};

use super::misfit_causes::{LikelyMisfitCause, find_likely_misfit_causes};
use super::monte_carlo_trials::{TrialSettings, propagate_by_trials};
use super::observation_model::{FitQuality, SolvedModel};
use super::outliers::OutlierCheck;
use super::outputs::{IdentificationOutputs, OutputCurve, OutputParameter};
use super::propagation::{OutputEffect, Propagation, Uncertainty};
use super::uncertainty_source::UncertaintySource;
use crate::IdentifyError;

/// Identified quantities with their uncertainty.
pub struct Identification {
    pub outputs: IdentificationOutputs,
    pub propagation: Propagation,
    /// Trials of the parameters in the order of the estimate, internal units.
    pub trial_statistics: Option<TrialStatistics>,
    pub fit_quality: FitQuality,
    pub outlier_check: OutlierCheck,
    /// Sources that may be larger than declared and would explain a misfit; empty without a misfit.
    pub likely_misfit_causes: Vec<LikelyMisfitCause>,
}

/// Propagates the sources to the outputs: to first order and, with `trial_settings`, by Monte Carlo trials.
///
/// # Errors
/// A source does not match the size of the model; fewer than two trials.
pub fn identify(
    solution: &SolvedModel<'_>,
    sources: &[UncertaintySource],
    outputs: IdentificationOutputs,
    trial_settings: Option<TrialSettings>,
) -> Result<Identification, IdentifyError> {
    let (observations, unknowns) = (solution.model.observation_count(), solution.model.unknown_count());
    if let Some(source) = sources.iter().find(|source| !source.has_matching_size(observations, unknowns)) {
        return Err(IdentifyError::IdentificationFailed(format!(
            "the size of the uncertainty source `{}` does not match {observations} observations and \
            {unknowns} unknowns",
            source.name
        )));
    }
    let propagation = Propagation::new(solution, sources);
    let misfit = &propagation.misfit;
    let run = |settings| propagate_by_trials(solution.model, sources, misfit, &outputs, settings);
    let trial_statistics = trial_settings.map(run).transpose()?;
    let outlier_check = OutlierCheck::new(solution, misfit, &propagation.residual_variances);
    let likely_misfit_causes =
        if misfit.is_above_bound { find_likely_misfit_causes(solution, sources) } else { Vec::new() };
    let fit_quality = solution.fit_quality;
    Ok(Identification { outputs, propagation, trial_statistics, fit_quality, outlier_check, likely_misfit_causes })
}

impl Identification {
    /// The estimate without the sentences and figures that the method adds. Its verdict is `undecided (model)` after a
    /// misfit or an outlier, otherwise none.
    pub fn estimate(&self, method: &str) -> Estimate {
        let (figures, misfit) = (&self.fit_quality, &self.propagation.misfit);
        let parameters = self.outputs.all_parameters().enumerate();
        let has_expected_chi2 = misfit.expected_chi2 > 0.0 && figures.dof > 0;
        let is_contradicted = misfit.is_above_bound || !self.outlier_check.outliers.is_empty();
        Estimate {
            trued_estimate: ESTIMATE_VERSION,
            method: method.to_owned(),
            provenance: None,
            coverage_percent: Some((COVERAGE_PROBABILITY * 1e4).round() / 1e2),
            trials: self.trial_statistics.as_ref().map(|trials| trials.trial_count),
            parameters: parameters.map(|(i, output)| self.build_parameter(i, output)).collect(),
            functions: self.outputs.curves.iter().map(|curve| self.build_function(curve)).collect(),
            circles: Vec::new(),
            arrows: Vec::new(),
            covariance: self.build_covariance(),
            rank: figures.rank,
            unknowns: figures.unknown_count,
            condition: figures.condition_number,
            weakest: None,
            gauge: Vec::new(),
            held_at_zero: Vec::new(),
            location_at_mm: None,
            not_identifiable: Vec::new(),
            residual_rms_um: figures.residual_rms_mm * 1e3,
            degrees_of_freedom: figures.dof,
            chi2_per_dof: if has_expected_chi2 { misfit.chi2 / misfit.expected_chi2 } else { 0.0 },
            verdict: if is_contradicted { Verdict::UndecidedModel } else { Verdict::None },
            decision_rule: None,
            warnings: Vec::new(),
            outliers: self.outlier_check.outliers.clone(),
            measurement_checks: self.outlier_check.measurement_checks.clone(),
            prior_hashes: Vec::new(),
            measured_ranges: BTreeMap::new(),
            source_effects: self.build_source_effects(),
        }
    }

    /// Effects of the sources that other runs may share on the linear parameters, in their reported units.
    fn build_source_effects(&self) -> Vec<SourceEffect> {
        let slopes = self.outputs.linear_parameter_slopes(self.propagation.unknown_count);
        let factors: Vec<f64> =
            self.outputs.linear_parameters.iter().map(|output| output.unit.to_reported_value(1.0)).collect();
        let in_reported_units =
            |draw: &[f64]| draw.iter().zip(&factors).map(|(change, factor)| change * factor).collect();
        let effect = |OutputEffect { source, changes_by_draw }: OutputEffect<'_>| SourceEffect {
            source: source.to_owned(),
            changes_by_draw: (0..changes_by_draw.ncols())
                .map(|draw| in_reported_units(changes_by_draw.col_as_slice(draw)))
                .collect(),
        };
        self.propagation.shareable_effects(&slopes).into_iter().map(effect).collect()
    }

    fn build_parameter(&self, index: usize, output: &OutputParameter) -> Parameter {
        let OutputParameter { symbol, unit, value, .. } = output;
        let interval = self.trial_statistics.as_ref().and_then(|trials| trials.shortest_interval.get(index));
        Parameter {
            u_monte_carlo: self.u_by_trials(index).map(|u| unit.to_reported_value(u)),
            interval_monte_carlo: interval.map(|mm| mm.map(|x| unit.to_reported_value(x))),
            ..parameter_with_budget(symbol, *unit, *value, self.output_uncertainty(index, output))
        }
    }

    /// Standard uncertainty from the trials, internal unit.
    fn u_by_trials(&self, index: usize) -> Option<f64> {
        self.trial_statistics.as_ref()?.standard_deviation.get(index).copied()
    }

    /// Uncertainty of a parameter in its internal unit, by its index in the estimate. `None`: there is no
    /// such parameter.
    pub fn parameter_uncertainty(&self, index: usize) -> Option<Uncertainty> {
        let output = self.outputs.all_parameters().nth(index)?;
        Some(self.output_uncertainty(index, output))
    }

    /// First-order uncertainty of a linear parameter; u by the trials for a nonlinear one, NaN without trials.
    /// Internal unit.
    fn output_uncertainty(&self, index: usize, output: &OutputParameter) -> Uncertainty {
        match &output.linear_slope {
            Some(slope) => self.propagation.output_uncertainty(slope),
            None => Uncertainty { u: self.u_by_trials(index).unwrap_or(f64::NAN), dof: None, budget: Vec::new() },
        }
    }

    /// Covariance of the linear parameters, in the products of their reported units.
    fn build_covariance(&self) -> ParameterCovariance {
        let outputs = &self.outputs.linear_parameters;
        let slopes = self.outputs.linear_parameter_slopes(self.propagation.unknown_count);
        let full = self.propagation.output_covariance(&slopes);
        let edge: Vec<f64> = outputs.iter().map(|o| o.unit.to_reported_value(1.0)).collect();
        let row = |i: usize| (0..edge.len()).map(|j| full[(i, j)] * edge[i] * edge[j]).collect();
        ParameterCovariance {
            symbols: outputs.iter().map(|output| output.symbol.clone()).collect(),
            rows: (0..edge.len()).map(row).collect(),
        }
    }

    fn build_function(&self, curve: &OutputCurve) -> EstimatedFunction {
        let u = |slope: &Vec<f64>| curve.unit.to_reported_value(self.propagation.output_uncertainty(slope).u);
        EstimatedFunction {
            symbol: curve.symbol.clone(),
            argument: curve.argument.to_owned(),
            argument_unit: curve.argument_unit.to_owned(),
            x: curve.x.clone(),
            unit: curve.unit,
            y: curve.y.iter().map(|y| curve.unit.to_reported_value(*y)).collect(),
            u: curve.slopes.iter().map(u).collect(),
            figure: curve.figure,
            at_mm: None,
        }
    }

    /// Symbols of the linear parameters whose first-order u contradicts the trials (JCGM 101, 8.1.3).
    pub fn symbols_contradicted_by_trials(&self) -> Vec<&str> {
        let Some(trials) = &self.trial_statistics else { return Vec::new() };
        let parameters = self.outputs.linear_parameters.iter().enumerate();
        parameters
            .filter(|(i, output)| trials.contradicts_uncertainty(*i, self.output_uncertainty(*i, output).u))
            .map(|(_, output)| output.symbol.as_str())
            .collect()
    }
}

/// A parameter without trials, with the given `value` (internal unit) and uncertainty.
pub fn parameter_with_budget(symbol: &str, unit: Unit, value: f64, own: Uncertainty) -> Parameter {
    let lines = own.budget.into_iter();
    Parameter {
        budget: lines.map(|line| BudgetLine { u: unit.to_reported_value(line.u), ..line }).collect(),
        ..parameter_without_budget(symbol, unit, value, own.u, own.dof)
    }
}

/// A parameter without budget and trials, with the given `value` and standard uncertainty `u` (internal unit)
/// and `dof` effective degrees of freedom (`None`: infinitely many).
pub fn parameter_without_budget(symbol: &str, unit: Unit, value: f64, u: f64, dof: Option<f64>) -> Parameter {
    let k = coverage_factor(dof.unwrap_or(f64::INFINITY));
    Parameter {
        symbol: symbol.to_owned(),
        value: unit.to_reported_value(value),
        unit,
        u: unit.to_reported_value(u),
        expanded: unit.to_reported_value(k * u),
        k,
        dof,
        identifiable: true,
        u_monte_carlo: None,
        interval_monte_carlo: None,
        budget: Vec::new(),
        judged: None,
    }
}
