//! Parameters of all runs as the rows of one least-squares problem.

use nalgebra::{DMatrix, DVector};

use super::MeasuredRun;
use crate::named_symbol::named_symbol;
use crate::symbol_names::ResultGroup;
use machine::record::estimate::{Parameter, Unit};

/// A parameter of the combination.
#[derive(Debug, Clone)]
pub struct CombinationUnknown {
    pub symbol: String,
    pub unit: Unit,
    /// Standard uncertainty of the parameter in the first run that has it; divides the values and covariances of the
    /// rows.
    pub scale: f64,
}

/// One parameter of one run.
pub struct ParameterRow {
    pub run_index: usize,
    pub unknown_index: usize,
    /// Index in the covariance of the run's estimate.
    covariance_index: usize,
}

/// The parameters of all runs. Each value is divided by the scale of its unknown.
pub struct ParameterRows {
    /// One unknown for each symbol: a parameter of several runs is one unknown.
    pub unknowns: Vec<CombinationUnknown>,
    /// One row for each identified parameter of each run, by run.
    pub rows: Vec<ParameterRow>,
    /// Value of each row, divided by the scale of its unknown.
    pub values: DVector<f64>,
}

impl ParameterRows {
    /// `runs`: checked, ascending. The parameters of the set-up are those of the last run.
    pub fn new(runs: &[MeasuredRun<'_>]) -> Self {
        let (mut unknowns, mut rows, mut values) = (Vec::<CombinationUnknown>::new(), Vec::new(), Vec::new());
        for (run_index, run) in runs.iter().enumerate() {
            for (covariance_index, parameter) in used_parameters(run, run_index + 1 == runs.len()) {
                let Parameter { symbol, unit, u, value, .. } = parameter;
                let known = unknowns.iter().position(|known| known.symbol == *symbol);
                let unknown_index = known.unwrap_or_else(|| {
                    unknowns.push(CombinationUnknown { symbol: symbol.clone(), unit: *unit, scale: *u });
                    unknowns.len() - 1
                });
                values.push(value / unknowns[unknown_index].scale);
                rows.push(ParameterRow { run_index, unknown_index, covariance_index });
            }
        }
        Self { unknowns, rows, values: values.into() }
    }

    pub fn count(&self) -> usize {
        self.rows.len()
    }

    /// Row of a parameter in a run.
    pub fn row_index(&self, run_index: usize, unknown_index: usize) -> Option<usize> {
        let is_wanted = |row: &ParameterRow| (row.run_index, row.unknown_index) == (run_index, unknown_index);
        self.rows.iter().position(is_wanted)
    }

    /// Scale of the unknown of a row.
    fn scale(&self, row: usize) -> f64 {
        self.unknowns[self.rows[row].unknown_index].scale
    }

    /// Covariances of the runs without correlation between them.
    pub fn covariance_without_correlation(&self, runs: &[MeasuredRun<'_>]) -> DMatrix<f64> {
        let entry = |i: usize, j: usize| {
            let (one, other) = (&self.rows[i], &self.rows[j]);
            let of_run = &runs[one.run_index].estimate.covariance.rows;
            match one.run_index == other.run_index {
                true => of_run[one.covariance_index][other.covariance_index] / (self.scale(i) * self.scale(j)),
                false => 0.0,
            }
        };
        DMatrix::from_fn(self.count(), self.count(), entry)
    }

    /// Changes of all rows (rows × draws) by the draws of a source of one run. `None`: the run has no such source.
    pub fn changes_by_source(&self, run: &MeasuredRun<'_>, run_index: usize, source: &str) -> Option<DMatrix<f64>> {
        let draws = &run.source_effects.iter().find(|effect| effect.source == source)?.changes_by_draw;
        let entry = |i: usize, draw: usize| match self.rows[i].run_index == run_index {
            true => draws[draw][self.rows[i].covariance_index] / self.scale(i),
            false => 0.0,
        };
        Some(DMatrix::from_fn(self.count(), draws.len(), entry))
    }
}

/// Identified parameters of the run with their index in its covariance; without the set-up unless `with_setup`.
fn used_parameters<'a>(
    run: &MeasuredRun<'a>,
    with_setup: bool,
) -> impl Iterator<Item = (usize, &'a Parameter)> + use<'a> {
    let MeasuredRun { estimate, .. } = *run;
    let indexed = estimate.covariance.symbols.iter().enumerate();
    let identified = indexed.filter_map(|(index, symbol)| {
        let parameter = estimate.parameters.iter().find(|parameter| parameter.symbol == *symbol)?;
        (parameter.identifiable && parameter.value.is_finite()).then_some((index, parameter))
    });
    let is_setup =
        |symbol: &str| named_symbol(&estimate.method, symbol).is_some_and(|named| named.group == ResultGroup::Setup);
    identified.filter(move |(_, parameter)| with_setup || !is_setup(&parameter.symbol))
}
