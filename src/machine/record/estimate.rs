//! The estimate: the published result. Each value has its unit beside it.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::Axis;

pub const ESTIMATE_VERSION: u32 = 1;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    #[serde(rename = "um")]
    Um,
    #[serde(rename = "urad")]
    Urad,
    #[serde(rename = "um/m")]
    UmPerM,
    #[serde(rename = "mm")]
    Mm,
    #[serde(rename = "ms")]
    Ms,
}

impl Unit {
    /// Edge value from an internal one (mm, rad, mm/mm, s).
    pub fn from_internal(self, value: f64) -> f64 {
        match self {
            Unit::Um | Unit::Ms => value * 1e3,
            Unit::Urad | Unit::UmPerM => value * 1e6,
            Unit::Mm => value,
        }
    }

    /// As a reader expects it.
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

/// GUM: `u` standard uncertainty, `U = k·u` expanded, `dof` effective degrees of freedom
/// (`null`: infinitely many).
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
    /// Standard uncertainty by Monte Carlo (JCGM 101), beside the first-order `u`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub u_monte_carlo: Option<f64>,
    /// Its shortest interval that covers with the probability of k.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interval_monte_carlo: Option<[f64; 2]>,
    /// Standard uncertainty by source, same unit.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub budget: Vec<BudgetLine>,
    /// Against its limit, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub judged: Option<Judgement>,
}

/// What the limit of a parameter says.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Judgement {
    /// |value| may be so much, in the parameter's unit.
    pub limit: f64,
    pub verdict: Verdict,
    /// Probability that the true value is within the limit (JCGM 106, 7.2), by value, u and degrees of freedom; absent
    /// where the uncertainty cannot be trusted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conformance: Option<f64>,
}

/// How the size of a source of uncertainty was evaluated (JCGM 100, 4.2 and 4.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum EvaluationType {
    /// By statistics of repeated readings.
    A,
    /// By other means: a declaration, a certificate.
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

/// Of one draw of a source of uncertainty.
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
    /// Absent in estimates of earlier versions, as the distribution.
    #[serde(rename = "type", default, skip_serializing_if = "Option::is_none")]
    pub evaluation: Option<EvaluationType>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distribution: Option<Distribution>,
    /// Contribution to the standard uncertainty of the parameter, in its unit.
    pub u: f64,
    /// Degrees of freedom of its size; absent: infinitely many.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dof: Option<f64>,
    /// Of the machine file, that declares its size, as `probe.lobing_um`; `axes.*`: each of the axes. Absent: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key: Option<String>,
    /// `u` by the size that the key declares, of several axes or sensors the largest. Absent: it is not in proportion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensitivity: Option<f64>,
    /// Its size, or a part of it, is not declared but assumed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub assumed: bool,
}

impl Estimate {
    /// Symbols of the parameters that were judged so.
    pub fn with_verdict(&self, verdict: Verdict) -> Vec<&str> {
        let so = |p: &&Parameter| p.judged.is_some_and(|judged| judged.verdict == verdict);
        self.parameters.iter().filter(so).map(|p| p.symbol.as_str()).collect()
    }

    /// Its displacements along X and Y over an angle hold at this point, machine frame with all axes at zero, mm.
    pub fn displaced_at(mut self, at_mm: [f64; 3]) -> Self {
        let is_across = |f: &Function| f.symbol.starts_with("EX") || f.symbol.starts_with("EY");
        let is_displacement = |f: &&mut Function| f.argument_unit == "deg" && is_across(f);
        let displacements = self.functions.iter_mut().filter(is_displacement);
        displacements.for_each(|function| function.at_mm = Some(at_mm));
        self
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Function {
    pub symbol: String,
    pub argument: String,
    pub argument_unit: String,
    /// Rising; of a `curve`, a further curve over the same range begins where it falls.
    pub x: Vec<f64>,
    pub unit: Unit,
    pub y: Vec<f64>,
    /// Zero where none is stated.
    pub u: Vec<f64>,
    /// How to draw it: `curve`, `polar`, `points`, `histogram` or `spectrum`.
    #[serde(default)]
    pub figure: FigureKind,
    /// Where a displacement holds, machine frame with all axes at zero. Absent: at the Z of `point_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_mm: Option<[f64; 3]>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FigureKind {
    #[default]
    Curve,
    Polar,
    /// Single values over a number: nothing lies between them.
    Points,
    /// How often which value of y occurs.
    Histogram,
    /// Amplitudes over the harmonic order. A whole order from 1 to the highest that x does not hold is not
    /// identifiable.
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
    /// Expanded uncertainty of the centre in x and y.
    pub centre_expanded: [f64; 2],
}

/// Vectors at places in space, by group: what is left over at each ball, by indexation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArrowFigure {
    pub symbol: String,
    /// Of the vectors.
    pub unit: Unit,
    pub groups: Vec<Arrows>,
    /// How to draw it: `arrows` or `paths`.
    #[serde(default)]
    pub figure: VectorKind,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VectorKind {
    #[default]
    Arrows,
    /// Where each place was to be, and where it was found, the deviation magnified; joined in their
    /// order, and round.
    Paths,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Arrows {
    /// e.g. `B -30°, C 90°, S 0°`.
    pub name: String,
    pub arrows: Vec<Arrow>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Arrow {
    pub label: String,
    /// Where it begins; the method says in which frame.
    pub at_mm: [f64; 3],
    pub vector: [f64; 3],
    /// What the vector would be by what was identified.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub modelled: Option<[f64; 3]>,
    /// Worth a second look.
    #[serde(default)]
    pub flagged: bool,
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Covariance {
    pub symbols: Vec<String>,
    /// Square, in the products of the parameters' units.
    pub rows: Vec<Vec<f64>>,
}

/// |value| of the parameter `symbol` may be `limit` at most, in `unit`.
#[derive(Debug, Clone, PartialEq)]
pub struct Limit {
    pub symbol: String,
    pub unit: Unit,
    pub limit: f64,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    Pass,
    Fail,
    /// The uncertainty reaches across a limit.
    Undecided,
    /// The readings contradict the model and the declared sources: no uncertainty can be trusted,
    /// whatever the limits.
    #[serde(rename = "undecided (model)")]
    UndecidedModel,
    /// No limit is stated.
    #[default]
    None,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// A measurement that is far from what all others make expected. It is in the estimate: a person decides whether its
/// readings are flagged `excluded`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outlier {
    /// Several where the readings cannot tell which of them is off.
    pub candidates: Vec<Deviation>,
    /// Externally studentised residual.
    pub t: f64,
    /// What was done, in words; absent: nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolution: Option<String>,
}

/// Of one measurement, as the plan labels it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Deviation {
    pub label: String,
    /// Measured less expected by all others, outward along the touch; of a ball the length of the displacement.
    pub deviation_um: f64,
}

/// What an estimate was made from. Hashes are of JSON without white space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The program that identified it, with its version, and of a release its commit.
    pub program: String,
    /// Name of the machine.
    pub machine: String,
    pub plan_sha256: String,
    pub readings_sha256: String,
    /// Of what the probe is ([`Probe::identity`](super::machine::Probe::identity)): two runs of the same probe share its
    /// systematic errors.
    pub probe_sha256: String,
    /// Of the artefact as stated: likewise its certificate.
    pub artefact_sha256: String,
    /// Compensations of the control that were active, in its maker's words.
    pub compensations_active: Vec<String>,
    /// From the first to the last reading, s.
    pub duration_s: f64,
    /// Lowest and highest reading of each thermometer, °C.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub temperatures_c: BTreeMap<String, [f64; 2]>,
}

/// How large a deviation of one measurement must be to be found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SmallestFound {
    /// As the plan labels it.
    pub label: String,
    /// With a probability of 95 %; absent: no other measurement checks it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deviation_um: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    pub trued_estimate: u32,
    pub method: String,
    /// What it was made from; absent until the program that identifies has added it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub provenance: Option<Provenance>,
    /// Probability with which each value ± U covers, in percent; absent in estimates of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coverage_percent: Option<f64>,
    /// Number of Monte Carlo trials.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trials: Option<usize>,
    pub parameters: Vec<Parameter>,
    pub functions: Vec<Function>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub circles: Vec<CircleFigure>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub arrows: Vec<ArrowFigure>,
    pub covariance: Covariance,
    pub rank: usize,
    pub unknowns: usize,
    pub condition: f64,
    /// What limits it, in words: the least certain combination of unknowns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weakest: Option<String>,
    /// What was fixed by convention.
    pub gauge: Vec<String>,
    pub not_identifiable: Vec<String>,
    pub residual_rms_um: f64,
    pub degrees_of_freedom: usize,
    /// χ² over its expectation where all is as declared: the degrees of freedom, but where sources that
    /// move many readings together are declared.
    pub chi2_per_dof: f64,
    pub verdict: Verdict,
    /// By which it was judged, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decision_rule: Option<String>,
    pub warnings: Vec<String>,
    /// Measurements that are far from all others.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outliers: Vec<Outlier>,
    /// Of each measurement that is compared with all others.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub smallest_found: Vec<SmallestFound>,
    /// Hashes of the estimates taken as known.
    pub priors: Vec<String>,
    /// Ranges of the axes over which it was measured, mm and degrees.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub measured: BTreeMap<Axis, [f64; 2]>,
}
