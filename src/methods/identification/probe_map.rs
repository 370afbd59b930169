//! The map of the probe's pre-travel over the direction, from an earlier qualification. It is subtracted from
//! the readings of later runs; its covariance is a source of their uncertainty.

use std::borrow::Cow;

use nalgebra::Vector3;

use super::azimuth_dependence::{DEFAULT_LOBING_ORDERS, azimuth_factor, azimuth_patterns, harmonic_sd_by_order};
use super::uncertainty_source::{prior_covariance, value_changes_by_prior_draws};
use crate::{IdentifyError, MethodRefusal};
use machine::Axis;
use machine::kinematics::KinematicChain;
use machine::record::estimate::{Estimate, Verdict};
use machine::record::machine::Probe;
use machine::record::plan::{Plan, Step, StepKind};
use machine::record::reading::Reading;

/// Name of the method that finds the pre-travel map of the probe.
pub const PROBE_QUALIFICATION_METHOD_NAME: &str = "probe-qualification";
/// Highest order that is searched for in an estimate.
const MAX_SEARCHED_MAP_ORDER: u32 = 180;

/// Symbols of the cosine and the sine part of an order.
pub fn probe_map_symbols(order: u32) -> [String; 2] {
    ["c", "s"].map(|part| format!("E_probe_{part}{order}"))
}

/// One cosine or sine part of the map.
#[derive(Debug, Clone)]
struct ProbeMapCoefficient {
    symbol: String,
    order: u32,
    /// 0 for the cosine part, 0.25 for the sine part.
    phase_turns: f64,
    value_mm: f64,
    u_mm: f64,
    /// Whether the part is subtracted; otherwise it counts as an uncertainty.
    is_subtracted: bool,
}

impl ProbeMapCoefficient {
    fn direction_factor(&self, normal: &Vector3<f64>) -> f64 {
        azimuth_factor(self.order, self.phase_turns, normal)
    }
}

/// Qualified pre-travel of the probe as harmonics of the azimuth in the spindle frame.
#[derive(Debug)]
pub struct ProbeMap<'a> {
    prior: &'a Estimate,
    /// The parts whose u does not exceed the size that `[probe]` declares for their order, and those without a declared
    /// size.
    coefficients: Vec<ProbeMapCoefficient>,
}

/// Priors of a plan that are not probe maps.
pub fn priors_without_probe_maps(priors: &[Estimate]) -> impl Iterator<Item = &Estimate> {
    priors.iter().filter(|prior| prior.method != PROBE_QUALIFICATION_METHOD_NAME)
}

impl<'a> ProbeMap<'a> {
    /// The probe map among the priors of the plan. `None`: there is none.
    ///
    /// # Errors
    /// The plan has more than one map; the fit of the map contradicts its model; the map has no covariance, or for
    /// every order a larger u than the machine file declares.
    pub fn from_plan(plan: &'a Plan) -> Result<Option<Self>, MethodRefusal> {
        let mut maps = plan.priors.iter().filter(|prior| prior.method == PROBE_QUALIFICATION_METHOD_NAME);
        let (prior, again) = (maps.next(), maps.next());
        MethodRefusal::require(
            again.is_none(),
            "two qualifications of the probe are given",
            "give only one estimate with --with",
        )?;
        let Some(prior) = prior else { return Ok(None) };
        MethodRefusal::require(
            prior.verdict != Verdict::UndecidedModel,
            "the readings of the probe qualification contradict its model",
            "read the warnings of the qualification and qualify the probe again",
        )?;
        let mut parts = read_map_coefficients(prior);
        // A part whose u exceeds the size declared in [probe] would increase the uncertainty.
        parts.retain(|part| declared_order_sd_mm(&plan.probe, part.order).is_none_or(|mm| part.u_mm <= mm));
        let map = Self { prior, coefficients: parts };
        let known: Vec<&str> = map.subtracted_coefficients().map(|part| part.symbol.as_str()).collect();
        MethodRefusal::require(
            map.subtracted_coefficients().next().is_some() && prior_covariance(prior, &known).is_some(),
            "every order of the qualified probe map has a larger u than [probe] declares",
            "set form_um in [method.probe-qualification] from the ball's certificate, or turn the spindle, \
            and qualify the probe again; or remove the qualification (--with)",
        )?;
        Ok(Some(map))
    }

    fn subtracted_coefficients(&self) -> impl Iterator<Item = &ProbeMapCoefficient> {
        self.coefficients.iter().filter(|part| part.is_subtracted)
    }

    /// Whether the map subtracts this order. Order 1 includes the stylus offset.
    pub fn subtracts_order(&self, order: u32) -> bool {
        self.subtracted_coefficients().any(|part| part.order == order)
    }

    /// Outward error of the reading of a touch along the outward unit `normal` (spindle frame), from the parts that
    /// the map subtracts, mm.
    pub fn pre_travel_mm(&self, normal: &Vector3<f64>) -> f64 {
        self.subtracted_coefficients().map(|part| part.value_mm * part.direction_factor(normal)).sum()
    }

    /// Remaining uncertainty of the pre-travel at contacts along `normals` (spindle frame), mm per draw: the
    /// covariance of the parts that are subtracted; the parts that are known but not subtracted; and of
    /// `lobing_sd_mm` those `declared_orders` that the map does not contain.
    pub fn uncertainty_patterns(
        &self,
        lobing_sd_mm: f64,
        declared_orders: &[u32],
        normals: &[Vector3<f64>],
    ) -> Vec<Vec<f64>> {
        let column = |part: &ProbeMapCoefficient, size: f64| -> Vec<f64> {
            normals.iter().map(|normal| size * part.direction_factor(normal)).collect()
        };
        let known: Vec<&ProbeMapCoefficient> = self.subtracted_coefficients().collect();
        let symbols: Vec<&str> = known.iter().map(|part| part.symbol.as_str()).collect();
        let known: Vec<Vec<f64>> = known.iter().map(|part| column(part, 1.0)).collect();
        let mut patterns = value_changes_by_prior_draws(self.prior, &symbols, &known).unwrap_or_default();
        let carried = self.coefficients.iter().filter(|part| !part.is_subtracted);
        patterns.extend(carried.map(|part| column(part, part.value_mm.hypot(part.u_mm))));
        let has = |order: u32| self.coefficients.iter().any(|part| part.order == order);
        patterns.extend(azimuth_patterns(lobing_sd_mm, declared_orders, normals, |order| !has(order)));
        patterns
    }

    /// A sentence for the estimate of a run that uses the map.
    pub fn describe(&self) -> String {
        let orders = |is_subtracted: bool| {
            let own = self.coefficients.iter().filter(|part| part.is_subtracted == is_subtracted);
            let mut orders: Vec<u32> = own.map(|part| part.order).collect();
            orders.dedup();
            orders.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
        };
        let carried = match orders(false) {
            none if none.is_empty() => String::new(),
            carried => format!("; order {carried} is included as an uncertainty"),
        };
        format!("the qualified pre-travel of the probe is subtracted: orders {}{carried}", orders(true))
    }
}

/// Standard deviation that `[probe]` declares for an order, mm. `None`: nothing is declared for this order.
fn declared_order_sd_mm(probe: &Probe, order: u32) -> Option<f64> {
    if order == 1 {
        return Some(probe.u_stylus_offset_um * 1e-3);
    }
    let sizes = harmonic_sd_by_order(probe.lobing_um * 1e-3, &probe.lobing_orders, &DEFAULT_LOBING_ORDERS);
    sizes.into_iter().find(|(of, _)| *of == order).map(|(_, mm)| mm)
}

fn read_map_coefficients(prior: &Estimate) -> Vec<ProbeMapCoefficient> {
    let mut parts = Vec::new();
    for order in 1..=MAX_SEARCHED_MAP_ORDER {
        for (symbol, quarter_turns) in probe_map_symbols(order).into_iter().zip([0.0, 0.25]) {
            let own = prior.parameters.iter().find(|parameter| parameter.symbol == symbol);
            let Some(parameter) = own else { continue };
            let unit = parameter.unit.to_reported_value(1.0);
            parts.push(ProbeMapCoefficient {
                symbol,
                order,
                phase_turns: quarter_turns,
                value_mm: parameter.value / unit,
                u_mm: parameter.u / unit,
                is_subtracted: parameter.identifiable,
            });
        }
    }
    parts
}

/// Whether the step is a touch of the probe, also of a reference; a scan is not.
pub fn is_probe_touch(step: &Step) -> bool {
    matches!(step.kind, StepKind::Touch | StepKind::Reference) && step.scan.is_none()
}

/// The readings, with the pre-travel of the plan's map subtracted from touches.
///
/// # Errors
/// The errors of [`ProbeMap::from_plan`]; the machine has no kinematics; a positionable spindle was not oriented.
pub fn subtract_pre_travel<'r>(plan: &Plan, readings: &'r [Reading]) -> Result<Cow<'r, [Reading]>, IdentifyError> {
    let Some(map) = ProbeMap::from_plan(plan)? else { return Ok(Cow::Borrowed(readings)) };
    let chain = KinematicChain::new(&plan.machine).map_err(MethodRefusal::from)?;
    let mut readings = readings.to_vec();
    for reading in &mut readings {
        let step = plan.steps.iter().find(|step| step.id == reading.step).filter(|step| is_probe_touch(step));
        let Some(step) = step else { continue };
        check_spindle_oriented(plan, step)?;
        let at = step.from.updated_by(&reading.position);
        let normal = Vector3::from(step.normal);
        let in_spindle = chain.machine_from_spindle(&at, &[]).rotation.inverse() * normal;
        // Linear axes that a rotary axis carries move in other directions than those of the machine frame.
        let axes_from_table = chain.inverse_linear_axes_jacobian(&at, &[]).map_err(MethodRefusal::from)?;
        let table = chain.machine_from_table(&at, &[]).rotation;
        let off = axes_from_table * (table.inverse() * normal) * map.pre_travel_mm(&in_spindle);
        for (axis, off) in Axis::LINEAR.into_iter().zip(off.iter()) {
            if let Some(value) = reading.position.get(axis) {
                reading.position.set(axis, value - off);
            }
        }
    }
    Ok(Cow::Owned(readings))
}

/// Refuses a step without a commanded position of S if the machine has an axis S.
fn check_spindle_oriented(plan: &Plan, step: &Step) -> Result<(), MethodRefusal> {
    let turns = plan.machine.axes.contains_key(&Axis::S);
    MethodRefusal::require(
        !turns || step.from.get(Axis::S).is_some(),
        "the probe map is valid only for an oriented spindle, and this run does not orient the spindle",
        "give the plan that was measured with the qualification, or remove the qualification (--with)",
    )
}
