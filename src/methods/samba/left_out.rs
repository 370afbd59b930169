//! Errors that a machine of this kind has by its standards, and that this measurement does not give.

use super::model::Model;
use super::parameters::implied;
use super::separable::{Beside, Way};
use crate::ball_measurement::tilts_spindle;
use machine::Axis;
use machine::kinematics::{ErrorParameter, Shape};

/// One of them.
pub struct LeftOut {
    pub error: ErrorParameter,
    /// What it cannot be told from; `None`: it could be told, and was not asked for.
    beside: Option<Beside>,
    why: &'static str,
}

const NOT_TURNED: &str = "the spindle was not turned";
const UPRIGHT: &str = "balls are touched from above only, so the axis stays at 0";

/// All that the axes would show if each of them turned, and the gains, less what is identified.
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

/// e.g. `EX0S: inseparable from tool_x (the spindle was not turned), so tool_x is given as tool_x + EX0S`.
pub fn in_words(all: &[LeftOut]) -> Vec<String> {
    let line = |left: &LeftOut| {
        let LeftOut { error, beside, why } = left;
        let Beside { names, sums } = beside.as_ref()?;
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
