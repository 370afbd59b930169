//! Position of the spindle in an estimate that does not separate the spindle from the stylus.

use faer::Mat;

use super::known_errors::{KnownErrors, internal_value};
use super::uncertainty_source::prior_covariance;
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm, KinematicChain};
use machine::record::estimate::Estimate;
use machine::record::machine::{Machine, Probe};

/// Minimum measured range of the spindle that counts as a turn, degrees: measured ranges are rounded outwards.
const MIN_SPINDLE_TURN_DEG: f64 = 1.0;
const STYLUS_OFFSET_KEY: &str = "probe.stylus_offset_um";

/// Standard uncertainties of the stylus as the machine file states it, mm. `None`: not stated.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StatedStylusUncertainty {
    /// Standard uncertainty of the offset of the stylus ball from the spindle axis, in each of X and Y.
    pub offset_u_mm: Option<f64>,
    /// Standard uncertainty of the stylus length, relative to the tool lengths in the control.
    pub length_u_mm: Option<f64>,
}

/// A coordinate of the stylus that contains the position of the spindle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpindleTerm<'a> {
    /// The deviation from the stated stylus, as location error of the last axis of the tool branch, mm.
    pub error: ErrorTerm,
    /// Symbol of the coordinate in the estimate, e.g. `tool_x`.
    pub symbol: &'a str,
    /// Standard uncertainty of the stated stylus, mm.
    pub u_stylus_mm: f64,
}

/// Position of the spindle from an estimate: the measured minus the stated stylus.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SpindlePosition<'a> {
    /// One term for each linear axis along which the estimate gives the position of the spindle.
    pub terms: Vec<SpindleTerm<'a>>,
    /// Linear axes along which the estimate does not give the position of the spindle.
    pub undetermined: Vec<UndeterminedSpindleComponent>,
}

/// A direction in which the position of the spindle is not determined, and what would determine it.
#[derive(Debug, Clone, PartialEq)]
pub struct UndeterminedSpindleComponent {
    pub component: Axis,
    pub reason: String,
    pub remedy: String,
}

impl StatedStylusUncertainty {
    /// `assumed_keys`: keys of the machine file whose values are assumed.
    pub fn new(probe: &Probe, assumed_keys: &[String]) -> Self {
        let is_assumed = assumed_keys.iter().any(|key| key == STYLUS_OFFSET_KEY);
        Self {
            offset_u_mm: (!is_assumed).then_some(probe.u_stylus_offset_um * 1e-3),
            length_u_mm: probe.u_stylus_length_um.map(|um| um * 1e-3),
        }
    }

    fn u_along_mm(&self, component: Axis) -> Option<f64> {
        if component == Axis::Z { self.length_u_mm } else { self.offset_u_mm }
    }
}

impl<'a> KnownErrors<'a> {
    /// Adds the position of the spindle, where the estimate contains it in the coordinates of the stylus: as location
    /// errors of the last axis of the tool branch, with the symbols `tool_x`, `tool_y`, `tool_z`. Adds nothing if the
    /// estimate lacks their joint covariance.
    pub fn with_spindle_position(mut self, position: &SpindlePosition<'a>) -> Self {
        let Some(all) = prior_covariance(
            self.estimate,
            &self.symbols.iter().copied().chain(position.terms.iter().map(|term| term.symbol)).collect::<Vec<_>>(),
        ) else {
            return self;
        };
        let (axes, count) = (self.errors.len(), self.errors.len() + position.terms.len());
        let derivatives = Mat::from_fn(count, count, |i, j| match i < axes && j < axes {
            true => self.derivatives_by_parameters[(i, j)],
            false => f64::from(u8::from(i == j)),
        });
        let mut covariance = &derivatives * all * derivatives.transpose();
        for (i, term) in position.terms.iter().enumerate() {
            covariance[(axes + i, axes + i)] += term.u_stylus_mm.powi(2);
        }
        self.errors.extend(position.terms.iter().map(|term| term.error));
        self.symbols.extend(position.terms.iter().map(|term| term.symbol));
        Self { covariance, derivatives_by_parameters: derivatives, ..self }
    }
}

impl<'a> SpindlePosition<'a> {
    /// Empty for a machine whose rotary axes turn the tool: its stylus is separable from the axes.
    pub fn new(
        estimate: &'a Estimate,
        machine: &Machine,
        chain: &KinematicChain,
        known: &KnownErrors<'_>,
        stylus: StatedStylusUncertainty,
    ) -> Self {
        let mut position = Self::default();
        let tool_branch = chain.topology().tool_branch();
        let is_tool_turned = tool_branch.iter().any(|axis| !axis.is_linear() && *axis != Axis::S);
        let (Some(last), false) = (tool_branch.last(), is_tool_turned) else { return position };
        for (k, component) in Axis::LINEAR.into_iter().enumerate() {
            if has_spindle_location(component, known) {
                continue;
            }
            let Some(symbol) = stylus_symbol(estimate, component) else {
                position.undetermined.extend(undetermined_without_stylus(estimate, component, stylus));
                continue;
            };
            if component != Axis::Z && was_spindle_turned(estimate) {
                position.undetermined.push(unidentified_spindle_position(estimate, component));
                continue;
            }
            let error = ErrorParameter::new(component, *last, ErrorShape::Location);
            match (stylus.u_along_mm(component), error, stylus_value(estimate, symbol)) {
                (Some(u_stylus_mm), Ok(parameter), Some(measured)) => position.terms.push(SpindleTerm {
                    error: ErrorTerm { parameter, value: measured - machine.tool_mm[k] },
                    symbol,
                    u_stylus_mm,
                }),
                _ => position.undetermined.push(position_inseparable_from_stylus(estimate, component)),
            }
        }
        position
    }
}

/// Whether the estimate contains the position of the spindle along X or Y, which requires that the spindle was turned;
/// always `false` for Z.
fn has_spindle_location(component: Axis, known: &KnownErrors<'_>) -> bool {
    let location = ErrorParameter::new(component, Axis::S, ErrorShape::Location);
    component != Axis::Z && location.is_ok_and(|location| known.has_error(location))
}

fn was_spindle_turned(estimate: &Estimate) -> bool {
    estimate.measured_ranges.get(&Axis::S).is_some_and(|[least, most]| most - least > MIN_SPINDLE_TURN_DEG)
}

/// The spindle was turned, so the stylus is separate from it; but its position is not among the errors.
fn unidentified_spindle_position(estimate: &Estimate, component: Axis) -> UndeterminedSpindleComponent {
    UndeterminedSpindleComponent {
        component,
        reason: format!("E{component}0S is not among the identified errors of the {} run", estimate.method),
        remedy: "add EX0S and EY0S to the parameters of the method".to_owned(),
    }
}

fn stylus_symbol(estimate: &Estimate, component: Axis) -> Option<&str> {
    let symbol = format!("tool_{}", component.name().to_lowercase());
    let parameter = estimate.parameters.iter().find(|parameter| parameter.symbol == symbol)?;
    Some(&parameter.symbol)
}

/// Value of a stylus coordinate, mm. `None`: not determined, or without covariance.
fn stylus_value(estimate: &Estimate, symbol: &str) -> Option<f64> {
    let parameter = estimate.parameters.iter().find(|parameter| parameter.symbol == symbol)?;
    (parameter.identifiable && prior_covariance(estimate, &[symbol]).is_some()).then(|| internal_value(parameter))
}

/// An estimate without coordinates of a stylus contains the stylus, or a sensor, in the positions of its axes.
/// `None`: these positions count as relative to the spindle along `component`.
fn undetermined_without_stylus(
    estimate: &Estimate,
    component: Axis,
    stylus: StatedStylusUncertainty,
) -> Option<UndeterminedSpindleComponent> {
    if estimate.parameters.iter().any(|parameter| parameter.symbol.starts_with("zero_")) {
        return Some(UndeterminedSpindleComponent {
            component,
            reason: format!("the {} run does not give stylus or sensor relative to the spindle", estimate.method),
            remedy: "give a run of samba".to_owned(),
        });
    }
    let lines = estimate.parameters.iter().flat_map(|parameter| &parameter.budget);
    let has_stylus = lines.into_iter().any(|line| line.key.as_deref() == Some(STYLUS_OFFSET_KEY));
    let is_unknown = component != Axis::Z && has_stylus && stylus.offset_u_mm.is_none();
    is_unknown.then(|| position_inseparable_from_stylus(estimate, component))
}

fn position_inseparable_from_stylus(estimate: &Estimate, component: Axis) -> UndeterminedSpindleComponent {
    let (what, remedy) = match component {
        Axis::Z => (
            "the length of the stylus from the position of the axes",
            "state the uncertainty of the stylus length as u_stylus_length_um in [probe]",
        ),
        _ => (
            "the stylus from the axis of the spindle",
            "measure with an oriented spindle (add S to the topology, and angles of S to the method), or state the \
             run-out of the stylus as stylus_offset_um in [probe]",
        ),
    };
    UndeterminedSpindleComponent {
        component,
        reason: format!("the {} run does not separate {what}", estimate.method),
        remedy: remedy.to_owned(),
    }
}
