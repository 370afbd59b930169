//! Errors that standards define for a machine of this kind, but that this measurement does not give.

use super::model::Model;
use super::parameters::implied;
use super::separable::{Confounding, Way};
use crate::ball_measurement::tilts_spindle;
use machine::Axis;
use machine::kinematics::{ErrorParameter, Shape};

/// An error that is not identified.
pub struct LeftOut {
    pub error: ErrorParameter,
    /// What it is inseparable from. `None`: it is separable, but was not selected.
    beside: Option<Confounding>,
    why: &'static str,
}

const NOT_TURNED: &str = "the spindle was not turned";
const UPRIGHT: &str = "balls are touched from above only, so the axis stays at 0";

/// Errors that would be separable if each rotary axis turned, and the gains, without those that are
/// identified.
pub fn left_out(model: &Model) -> Vec<LeftOut> {
    let (way, taken) = (model.way(), model.parameters());
    let chain = way.chain;
    let mut expected = implied(Way { stands: &[], ..way });
    let linear = chain.topology().axes().filter(|axis| axis.is_linear());
    let gains = linear.filter_map(|axis| ErrorParameter::new(axis, axis, Shape::Gain).ok());
    let more: Vec<_> = gains.filter(|gain| !expected.contains(gain)).collect();
    expected.extend(more);
    expected.retain(|error| !taken.contains(error));
    let why = |error: ErrorParameter| match error.axis() {
        axis if !way.stands.contains(&axis) => "",
        Axis::S => NOT_TURNED,
        axis if tilts_spindle(chain, axis) => UPRIGHT,
        _ => "",
    };
    let told = |error: ErrorParameter| LeftOut {
        error,
        beside: way.inseparable(error, taken),
        why: why(error),
    };
    expected.into_iter().map(told).collect()
}

impl LeftOut {
    pub fn not_asked_for(&self) -> Option<String> {
        self.beside.is_none().then(|| self.error.to_string())
    }
}

/// One line per error, e.g. `EX0S: inseparable from tool_x (the spindle was not turned), so tool_x is given
/// as tool_x + EX0S`.
pub fn in_words(all: &[LeftOut]) -> Vec<String> {
    let line = |left: &LeftOut| {
        let LeftOut { error, beside, why } = left;
        let Confounding { names, sums } = beside.as_ref()?;
        let what = match names.as_slice() {
            [] => "changes nothing that is measured".to_owned(),
            [only] => format!("inseparable from {only}"),
            [others @ .., last] => format!("inseparable from {} and {last}", others.join(", ")),
        };
        let why = if why.is_empty() { String::new() } else { format!(" ({why})") };
        let so = match sums.as_slice() {
            [] if names.len() < 2 => String::new(),
            [] => format!(": what these say holds as far as {error} is 0"),
            sums => format!(", so {}", sums.join(" and ")),
        };
        Some(format!("{error}: {what}{why}{so}"))
    };
    all.iter().filter_map(line).collect()
}
