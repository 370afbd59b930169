//! The estimate: the published result of a measurement. Each value has its unit.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::measurement_check::{MeasurementCheck, Outlier};
use crate::Axis;

pub const ESTIMATE_VERSION: u32 = 1;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    Um,
    Urad,
    #[serde(rename = "um/m")]
    UmPerM,
    Mm,
    Ms,
}

impl Unit {
    /// Converts an internal value (mm, rad, mm/mm, s) into this unit, in which it is reported.
    pub fn to_reported_value(self, value: f64) -> f64 {
        match self {
            Unit::Um | Unit::Ms => value * 1e3,
            Unit::Urad | Unit::UmPerM => value * 1e6,
            Unit::Mm => value,
        }
    }

    pub fn symbol(self) -> &'static str {
        match self {
            Unit::Um => "µm",
            Unit::Urad => "µrad",
            Unit::UmPerM => "µm/m",
            Unit::Mm => "mm",
            Unit::Ms => "ms",
        }
    }
}

/// An estimated parameter, in `unit`. GUM: `u` standard uncertainty, `U = k·u` expanded uncertainty, `dof` effective
/// degrees of freedom (`null`: infinitely many).
#[allow(non_snake_case)]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    pub symbol: String,
    pub value: f64,
    pub unit: Unit,
    pub u: f64,
    #[serde(rename = "U")]
    pub expanded: f64,
    pub k: f64,
    pub dof: Option<f64>,
    pub identifiable: bool,
    /// Standard uncertainty by Monte Carlo (JCGM 101). `u` is of first order; for a nonlinear parameter, this value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub u_monte_carlo: Option<f64>,
    /// Shortest Monte Carlo interval with the coverage probability of k, in the same unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interval_monte_carlo: Option<[f64; 2]>,
    /// Contributions to `u`, one line per source, in the same unit.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub budget: Vec<BudgetLine>,
    /// Judgement against the limit; absent if no limit is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub judged: Option<LimitVerdict>,
}

/// Judgement of a parameter against its limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LimitVerdict {
    /// Maximum |value|, in the parameter's unit.
    pub limit: f64,
    pub verdict: Verdict,
    /// Probability that the true value is within the limit (JCGM 106, 7.2), from value, u and degrees of freedom;
    /// absent if the uncertainty is not reliable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conformance: Option<f64>,
}

/// Evaluation type of a source's uncertainty (JCGM 100, 4.2 and 4.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum EvaluationType {
    /// From statistics of repeated readings.
    A,
    /// From other information: a declaration, a certificate.
    B,
}

impl EvaluationType {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
        }
    }
}

/// Distribution of one draw of an uncertainty source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Distribution {
    Normal,
    Rectangular,
}

impl Distribution {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Rectangular => "rectangular",
        }
    }
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct BudgetLine {
    pub source: String,
    /// Evaluation type; absent in estimates of earlier versions, like the distribution.
    #[serde(rename = "type", default, skip_serializing_if = "Option::is_none")]
    pub evaluation_type: Option<EvaluationType>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distribution: Option<Distribution>,
    /// Contribution to the standard uncertainty of the parameter, in its unit.
    pub u: f64,
    /// Degrees of freedom of the source's uncertainty; absent: infinitely many.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dof: Option<f64>,
    /// Key of the machine file that declares the size of the source, such as `probe.lobing_um`; `axes.*` means each
    /// of the axes. Absent: no key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key: Option<String>,
    /// Ratio of `u` to the value of `key`; if several keys match, to the largest. Absent: not proportional.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensitivity: Option<f64>,
    /// Whether the size of the source, or a part of this size, is assumed instead of declared.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub assumed: bool,
}

impl Estimate {
    /// Numbers of the runs that the estimate combines; empty for an estimate of one run.
    pub fn combined_runs(&self) -> &[i64] {
        self.provenance.as_ref().map_or(&[], |provenance| &provenance.combined_runs)
    }

    /// Sets the point for which the displacements along X and Y over an angle are valid, machine frame with all
    /// axes at zero, mm.
    pub fn with_displacement_point(mut self, at_mm: [f64; 3]) -> Self {
        let is_across = |f: &EstimatedFunction| f.symbol.starts_with("EX") || f.symbol.starts_with("EY");
        let is_displacement = |f: &&mut EstimatedFunction| f.argument_unit == "deg" && is_across(f);
        let displacements = self.functions.iter_mut().filter(is_displacement);
        displacements.for_each(|function| function.at_mm = Some(at_mm));
        self
    }
}

/// A function by its points: `y` with its `u`, in `unit`, at `x`, in `argument_unit`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EstimatedFunction {
    pub symbol: String,
    pub argument: String,
    pub argument_unit: String,
    /// Increasing; in a `curve`, a decrease begins another curve over the same range.
    pub x: Vec<f64>,
    pub unit: Unit,
    pub y: Vec<f64>,
    /// Standard uncertainty of each `y`; zero if none is stated.
    pub u: Vec<f64>,
    /// Kind of figure: `curve`, `polar`, `points`, `histogram` or `spectrum`.
    #[serde(default)]
    pub figure: FunctionFigureKind,
    /// Point for which a displacement is valid, machine frame, all axes at zero. Absent: at the Z of `point_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_mm: Option<[f64; 3]>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FunctionFigureKind {
    #[default]
    Curve,
    Polar,
    /// Single values over a number, without connecting lines.
    Points,
    /// The figure shows the frequencies of the values `y`; `x` numbers the values.
    Histogram,
    /// Amplitudes over the harmonic order. An order below the highest one in `x` is not identifiable if `x` lacks it.
    Spectrum,
}

/// Points in a plane with the circle fitted through them: the axis position and its wander.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CircleFigure {
    pub symbol: String,
    pub unit: Unit,
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    pub centre: [f64; 2],
    pub radius: f64,
    /// Expanded uncertainty U of the centre in x and y.
    pub centre_expanded: [f64; 2],
}

/// Vectors at points in space, by group: the residuals at each ball, by indexation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArrowFigure {
    pub symbol: String,
    /// Unit of the vectors.
    pub unit: Unit,
    pub groups: Vec<ArrowGroup>,
    /// Kind of figure: `arrows` or `paths`.
    #[serde(default)]
    pub figure: VectorFigureKind,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VectorFigureKind {
    #[default]
    Arrows,
    /// Nominal and measured position of each point, deviations magnified; in order, the points form a closed path.
    Paths,
}

/// The arrows of one indexation, or of all indexations with one tilt of the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArrowGroup {
    /// e.g. `B -30°, C 90°, S 0°`.
    pub name: String,
    pub arrows: Vec<FigureArrow>,
}

/// One vector of an [`ArrowFigure`]: its start, its measured and its modelled value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FigureArrow {
    pub label: String,
    /// Start point; its frame depends on the method.
    pub at_mm: [f64; 3],
    pub vector: [f64; 3],
    /// The vector by the identified model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub modelled: Option<[f64; 3]>,
    /// Whether the vector belongs to an outlier.
    #[serde(default)]
    pub flagged: bool,
}

/// Covariance of the parameters in `symbols`: those that are linear in the unknowns. Other parameters are missing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterCovariance {
    pub symbols: Vec<String>,
    /// Square matrix, in the products of the parameters' units.
    pub rows: Vec<Vec<f64>>,
}

/// Tolerance of a parameter: |value| of `symbol` is at most `limit`, inclusive, in `unit`.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterTolerance {
    pub symbol: String,
    pub unit: Unit,
    pub limit: f64,
}

/// Judgement with guard band: a parameter passes if |value| + U is at most the limit, and fails if |value| − U is
/// above.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    Pass,
    Fail,
    /// The interval value ± U contains a limit, or the parameter is not identifiable or not finite.
    Undecided,
    /// The readings contradict the model and the declared sources: no uncertainty is reliable, whatever the limits.
    #[serde(rename = "undecided (model)")]
    UndecidedModel,
    /// No limit is stated.
    #[default]
    None,
}

impl Verdict {
    pub const ALL: [Self; 5] = [Self::Pass, Self::Fail, Self::Undecided, Self::UndecidedModel, Self::None];
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Effect on the parameters of the covariance of an uncertainty source that several runs may share.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceEffect {
    pub source: String,
    /// For each independent draw of the source (unit variance) the change of each parameter, in the order and in the
    /// units of the covariance.
    pub changes_by_draw: Vec<Vec<f64>>,
}

/// Inputs of an estimate. Hashes are of JSON without white space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Program that made the identification, with its version, and the commit for a release.
    pub program: String,
    /// Name of the machine.
    pub machine: String,
    pub plan_sha256: String,
    pub readings_sha256: String,
    /// Hash of the probe's identity ([`Probe::identity`](super::machine::Probe::identity)): two runs with the same
    /// probe share its systematic errors.
    pub probe_sha256: String,
    /// Hash of the stated artefact: two runs with the same artefact share the errors of its certificate.
    pub artefact_sha256: String,
    /// Compensations that were active in the control, by the control's own names.
    pub compensations_active: Vec<String>,
    /// Time from the first to the last reading, s.
    pub duration_s: f64,
    /// Lowest and highest reading of each thermometer, °C.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub temperatures_c: BTreeMap<String, [f64; 2]>,
    /// Numbers of the combined runs, ascending; empty for one run. The other fields are those of the newest of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub combined_runs: Vec<i64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Version of the format, `ESTIMATE_VERSION`.
    pub trued_estimate: u32,
    pub method: String,
    /// Inputs of the estimate; absent until the identifying program adds them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub provenance: Option<Provenance>,
    /// Coverage probability of each value ± U, in percent; absent in estimates of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coverage_percent: Option<f64>,
    /// Number of Monte Carlo trials; absent: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trials: Option<usize>,
    pub parameters: Vec<Parameter>,
    pub functions: Vec<EstimatedFunction>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub circles: Vec<CircleFigure>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub arrows: Vec<ArrowFigure>,
    pub covariance: ParameterCovariance,
    /// Rank of the equations of the fit.
    pub rank: usize,
    /// Number of free unknowns of the fit, without those that a gauge fixes.
    pub unknowns: usize,
    /// Condition number σmax/σmin of the column-scaled equations of the fit; of several fits or runs: the largest.
    pub condition: f64,
    /// The least certain combination of unknowns, as text; absent if the method does not compute it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weakest: Option<String>,
    /// Conventions and definitions that the parameters are based on, one sentence each.
    pub gauge: Vec<String>,
    /// Symbols of location errors that are held at zero because they are equivalent to reported parameters.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held_at_zero: Vec<String>,
    /// Point, machine frame with all axes at zero, where the location errors along X and Y are displacements of the
    /// rotary axis relative to the tip: they contain the errors of X, Y and Z there. Absent: they are those of the
    /// kinematic model at `point_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub location_at_mm: Option<[f64; 3]>,
    /// What the measurement cannot determine, as text.
    pub not_identifiable: Vec<String>,
    /// Root mean square of the residuals without weights; of several runs: that of their values.
    pub residual_rms_um: f64,
    /// Degrees of freedom of the fit; 0 if its residuals are not compared with the declared sources.
    pub degrees_of_freedom: usize,
    /// χ² divided by its expected value if all declared values are correct (the number of degrees of freedom, unless
    /// declared sources affect many readings together); 0 if there is no expected value.
    pub chi2_per_dof: f64,
    pub verdict: Verdict,
    /// Decision rule of the verdict, as text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decision_rule: Option<String>,
    pub warnings: Vec<String>,
    /// Measurements that are far from the values predicted by all others.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outliers: Vec<Outlier>,
    /// Residual and smallest detectable deviation of each measurement that is compared with all others.
    #[serde(rename = "smallest_found", default, skip_serializing_if = "Vec::is_empty")]
    pub measurement_checks: Vec<MeasurementCheck>,
    /// Hashes of the estimates that are used as known values.
    #[serde(rename = "priors")]
    pub prior_hashes: Vec<String>,
    /// Measured ranges of the axes, mm and degrees.
    #[serde(rename = "measured", default, skip_serializing_if = "BTreeMap::is_empty")]
    pub measured_ranges: BTreeMap<Axis, [f64; 2]>,
    /// Effects of the sources that other runs may share. Not in the JSON: only the identification computes them.
    #[serde(skip)]
    pub source_effects: Vec<SourceEffect>,
}
