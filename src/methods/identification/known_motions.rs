//! Error motions of a rotary axis that earlier estimates give as functions of its commanded angle: their
//! values, and their uncertainty as sources of the budget.

use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm};
use machine::record::estimate::{Estimate, EstimatedFunction, Parameter, Unit};

use super::periodic_points::PeriodicPoints;
use super::probe_map::priors_without_probe_maps;
use super::uncertainty_source::{ResidualTreatment, UncertaintySource};
use crate::MethodRefusal;

/// Known error motions. Each has mean zero over the revolution, because the mean is part of the location of
/// the axis.
#[derive(Debug, Default)]
pub struct KnownErrorMotions<'a> {
    /// The estimates that are not maps of the probe.
    priors: Vec<&'a Estimate>,
    motions: Vec<KnownErrorMotion<'a>>,
}

/// One component of the error motion over the angle of the axis.
#[derive(Debug)]
struct KnownErrorMotion<'a> {
    /// Index of the estimate that gives the motion.
    prior_index: usize,
    /// Location error that displaces the axis as this motion does at one angle.
    location_error: ErrorParameter,
    /// Height Z at which the motion is valid, if it is not that of `point_mm`; machine frame with all axes at zero,
    /// mm.
    valid_height_mm: Option<f64>,
    representation: MotionRepresentation<'a>,
}

/// Values of a motion, and the form in which its uncertainty is known.
#[derive(Debug)]
enum MotionRepresentation<'a> {
    /// Cosine and sine parts with their symbols, if the estimate has their covariance.
    Harmonics(Vec<(&'a str, ErrorTerm)>),
    /// Points of the function, interpolated linearly; used if the estimate lacks such parts or their covariance.
    Points(PeriodicPoints),
}

impl<'a> KnownErrorMotions<'a> {
    /// # Errors
    /// An estimate has no error motions of `axis` and is not a map of the probe; a function does not cover
    /// one revolution; two estimates have the same function.
    pub fn new(axis: Axis, priors: &'a [Estimate]) -> Result<Self, MethodRefusal> {
        let priors: Vec<&Estimate> = priors_without_probe_maps(priors).collect();
        let mut motions: Vec<KnownErrorMotion<'_>> = Vec::new();
        for (prior, estimate) in priors.iter().copied().enumerate() {
            let all = estimate.functions.iter().filter_map(|f| Some((location_error_of_function(f)?, f)));
            let (own, others): (Vec<_>, Vec<_>) = all.partition(|(error, _)| error.axis() == axis);
            if own.is_empty() {
                return Err(missing_motions_refusal(axis, estimate, others.first().map(|(_, other)| *other)));
            }
            for (error, function) in own {
                if motions.iter().any(|motion| motion.location_error == error) {
                    return Err(MethodRefusal::new(
                        format!("two estimates contain {}", function.symbol),
                        "give only one of these estimates with --with",
                    ));
                }
                let form = MotionRepresentation::new(estimate, error, function)?;
                let height_mm = function.at_mm.map(|at_mm| at_mm[2]);
                motions.push(KnownErrorMotion {
                    prior_index: prior,
                    location_error: error,
                    valid_height_mm: height_mm,
                    representation: form,
                });
            }
        }
        Ok(Self { priors, motions })
    }

    pub fn is_empty(&self) -> bool {
        self.motions.is_empty()
    }

    pub fn has_component(&self, component: Axis) -> bool {
        self.motions.iter().any(|motion| motion.location_error.component() == component)
    }

    /// Errors that displace the axis at its commanded `angle`, rad.
    pub fn error_terms_at(&self, angle: f64) -> Vec<ErrorTerm> {
        let terms = |motion: &KnownErrorMotion<'_>| match &motion.representation {
            MotionRepresentation::Harmonics(terms) => terms.iter().map(|(_, term)| *term).collect(),
            MotionRepresentation::Points(points) => {
                vec![ErrorTerm {
                    parameter: motion.location_error,
                    value: points.interpolate(angle.to_degrees()).value,
                }]
            }
        };
        self.motions.iter().flat_map(terms).collect()
    }

    /// Uncertainty sources of the motions. Harmonics have their covariance. Points are fully correlated over
    /// the angle, because estimates have no covariance of points. `angles`: commanded angle of each
    /// observation, rad. `by_component`: derivative of each observation by a displacement of the axis along
    /// or about the component.
    pub fn uncertainty_sources(
        &self,
        angles: &[f64],
        by_component: impl Fn(Axis) -> Vec<f64>,
    ) -> Vec<UncertaintySource> {
        let mut sources = Vec::new();
        for (prior, estimate) in self.priors.iter().enumerate() {
            let (mut symbols, mut by_coefficient, mut by_points) = (vec![], vec![], vec![]);
            for motion in self.motions.iter().filter(|motion| motion.prior_index == prior) {
                let by = by_component(motion.location_error.component());
                let times = |factor: &dyn Fn(f64) -> f64| {
                    angles.iter().zip(&by).map(|(angle, by)| factor(*angle) * by).collect()
                };
                match &motion.representation {
                    MotionRepresentation::Harmonics(terms) => {
                        for (symbol, term) in terms {
                            symbols.push(*symbol);
                            by_coefficient.push(times(&|q| term.parameter.shape_factor(q)));
                        }
                    }
                    MotionRepresentation::Points(points) => {
                        by_points.push(times(&|q| points.interpolate(q.to_degrees()).u));
                    }
                }
            }
            sources.extend(UncertaintySource::from_prior(estimate, &symbols, &by_coefficient));
            let name = format!("estimate of {}", estimate.method);
            sources.push(UncertaintySource::new_unweighted(name, by_points, ResidualTreatment::InExpectedChi2));
        }
        sources.retain(|source| !source.is_zero());
        sources
    }

    /// One line per estimate: its method, its functions and how they are evaluated.
    pub fn describe(&self) -> Vec<String> {
        let line = |(prior, estimate): (usize, &&Estimate)| {
            let own = self.motions.iter().filter(|motion| motion.prior_index == prior);
            let own: Vec<String> = own.map(KnownErrorMotion::describe).collect();
            format!("known error motions from an estimate of {}: {}", estimate.method, own.join(", "))
        };
        self.priors.iter().enumerate().map(line).collect()
    }
}

impl KnownErrorMotion<'_> {
    fn describe(&self) -> String {
        let height = self.valid_height_mm.map_or(String::new(), |z| format!(" (valid at Z = {z:.1} mm)"));
        let name = format!("E{}{}{height}", self.location_error.component(), self.location_error.axis());
        match &self.representation {
            MotionRepresentation::Harmonics(terms) => {
                let orders = terms.iter().filter_map(|(_, term)| harmonic_order(term.parameter));
                let highest = orders.max().unwrap_or(0);
                format!("{name} from its Fourier coefficients up to order {highest}")
            }
            MotionRepresentation::Points(_) => {
                format!("{name} from its points, with linear interpolation, u fully correlated over the angle")
            }
        }
    }
}

impl<'a> MotionRepresentation<'a> {
    fn new(estimate: &'a Estimate, error: ErrorParameter, function: &EstimatedFunction) -> Result<Self, MethodRefusal> {
        let points = PeriodicPoints::new(function).map_err(|reason| {
            MethodRefusal::new(
                format!("{} of the estimate of {} {reason}", function.symbol, estimate.method),
                "give an estimate of one revolution without sub-harmonics",
            )
        })?;
        let parameters = estimate.parameters.iter().filter(|own| own.unit == function.unit);
        let terms: Vec<_> = parameters
            .filter_map(|own| Some((own.symbol.as_str(), harmonic_term(&function.symbol, error, own)?)))
            .collect();
        let has_all = terms.iter().all(|(symbol, _)| has_covariance(estimate, symbol));
        Ok(if has_all && !terms.is_empty() { Self::Harmonics(terms) } else { Self::Points(points) })
    }
}

/// The term of a parameter such as `EXC_c2` or `EXC_s2` of the function `EXC`, internal unit.
fn harmonic_term(function: &str, error: ErrorParameter, parameter: &Parameter) -> Option<ErrorTerm> {
    let suffix = parameter.symbol.strip_prefix(function)?.strip_prefix('_')?;
    let shape = match suffix.split_at_checked(1)? {
        ("c", order) => ErrorShape::Cos(order.parse().ok()?),
        ("s", order) => ErrorShape::Sin(order.parse().ok()?),
        _ => return None,
    };
    let parameter_of_order = ErrorParameter::new(error.component(), error.axis(), shape).ok()?;
    let value = parameter.value / parameter.unit.to_reported_value(1.0);
    Some(ErrorTerm { parameter: parameter_of_order, value })
}

fn harmonic_order(parameter: ErrorParameter) -> Option<u32> {
    match parameter.shape() {
        ErrorShape::Cos(order) | ErrorShape::Sin(order) => Some(order),
        _ => None,
    }
}

/// Location error with the component and axis of a function `EXC` to `ECC` of a rotary axis over its angle.
fn location_error_of_function(function: &EstimatedFunction) -> Option<ErrorParameter> {
    let mut letters = function.symbol.strip_prefix('E')?.chars();
    let mut axis = || letters.next()?.to_string().parse::<Axis>().ok();
    let (component, turned) = (axis()?, axis()?);
    let is_over_angle = function.argument == turned.name() && function.argument_unit == "deg";
    let has_unit = match component.is_linear() {
        true => matches!(function.unit, Unit::Um | Unit::Mm),
        false => function.unit == Unit::Urad,
    };
    let is_motion = letters.next().is_none() && !turned.is_linear() && is_over_angle && has_unit;
    let error = ErrorParameter::new(component, turned, ErrorShape::Location).ok();
    error.filter(|_| is_motion)
}

fn has_covariance(estimate: &Estimate, symbol: &str) -> bool {
    let covariance = &estimate.covariance;
    let count = covariance.symbols.len();
    let is_square = covariance.rows.len() == count;
    is_square
        && covariance.rows.iter().all(|row| row.len() == count)
        && covariance.symbols.iter().any(|own| own == symbol)
}

fn missing_motions_refusal(axis: Axis, estimate: &Estimate, other: Option<&EstimatedFunction>) -> MethodRefusal {
    let found = match other {
        Some(other) => format!("the function {} is of the axis {}", other.symbol, other.argument),
        None => "no such function".to_owned(),
    };
    MethodRefusal::new(
        format!("the estimate of {} has no error motions of {axis} over its angle: {found}", estimate.method),
        format!(
            "give an estimate with EX{axis}, EY{axis} (of ball-plate, multiprobe or r-test on this \
            machine), or remove --with"
        ),
    )
}
