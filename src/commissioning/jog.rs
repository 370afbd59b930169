//! One small motion: planned, rendered, read back and proven before it is sent.

use super::Check;
use crate::setup;
use devices::controllers::ControllerError;
use machine::record::machine::AxisSpec;
use machine::record::motion::{Block, Motion};
use machine::record::question::{AxisDirection, Jog};
use machine::{Axis, Position};
use planning::gcode::{RenderError, Transmission};
use planning::proof::{JogRequest, ProvenBlock, Refusal, Unproven, prove_jog, prove_retract};

/// Feed of a jog, mm/min or degrees/min, slow enough to be watched: a millimetre or a degree takes a second.
const FEED_PER_MIN: f64 = 60.0;
/// Length of one retract step, mm.
pub(super) const RETRACT_MM: f64 = 1.0;
/// Maximum distance of a homed axis beyond its limit, mm or degrees.
const AT_LIMIT: f64 = 0.01;
/// Maximum difference between two reported positions at rest, mm or degrees.
const STILL: f64 = 0.02;
/// Step number in the N words.
const STEP: u32 = 1;

/// Reason why a jog did not reach its end.
#[derive(Debug, thiserror::Error)]
pub(super) enum JogError {
    #[error("it cannot be written: {0}")]
    Unwritable(RenderError),
    #[error("it is not proven to be free: {0}")]
    Unproven(Refusal),
    #[error(transparent)]
    Control(#[from] ControllerError),
    #[error("it was moved by hand: {axis} stands at {now:.3}, not at {was:.3}")]
    Moved { axis: Axis, was: f64, now: f64 },
}

impl From<Unproven> for JogError {
    fn from(unproven: Unproven) -> Self {
        match unproven {
            Unproven::Unwritable(error) => Self::Unwritable(error),
            Unproven::Refused(refusal) => Self::Unproven(refusal),
        }
    }
}

impl JogError {
    pub fn remedy(&self) -> String {
        match self {
            Self::Unwritable(error) => error.remedy().to_owned(),
            Self::Unproven(refusal) => refusal.remedy().to_owned(),
            Self::Control(error) => error.remedy(),
            Self::Moved { .. } => {
                "leave the machine alone while it is checked; then check again".to_owned()
            }
        }
    }

    /// Whether nothing has moved and the control is unchanged.
    pub fn is_harmless(&self) -> bool {
        !matches!(self, Self::Control(_) | Self::Moved { .. })
    }
}

/// A jog by `by` away from the nearer limit. `None`: the axis lacks the travel.
pub(super) fn inwards(axis: Axis, by: f64, spec: &AxisSpec, stands: &Position) -> Option<Jog> {
    let here = axis.to_edge(stands.get(axis)?);
    let (up, down) = (spec.max - here, here - spec.min);
    let by = if up >= down { by } else { -by };
    let feed_per_min = FEED_PER_MIN.min(spec.rapid_per_min);
    (up.max(down) >= by.abs() && up.min(down) >= -AT_LIMIT).then_some(Jog {
        axis,
        by,
        feed_per_min,
    })
}

/// The jog back.
pub(super) fn back(jog: &Jog) -> Jog {
    Jog { by: -jog.by, ..*jog }
}

/// A proven jog.
pub(super) struct Proven {
    pub block: ProvenBlock,
    /// End position, mm or rad.
    pub to: f64,
}

/// Proves a jog.
///
/// # Errors
/// The jog cannot be rendered, or it comes too close to a body.
pub(super) fn proven(check: &Check<'_>, jog: &Jog) -> Result<Proven, JogError> {
    let stands = check.stands.as_ref().ok_or(ControllerError::DriverGone)?;
    prove(check, stands, jog, &JOG)
}

/// Motion and proof of a kind of move.
struct MoveKind {
    motion: fn(&Jog, f64) -> Motion,
    proof: fn(&JogRequest<'_>, &Transmission, &Block) -> Result<ProvenBlock, Unproven>,
}

const JOG: MoveKind = MoveKind { motion, proof: prove_jog };
const RETRACT: MoveKind = MoveKind { motion: back_off, proof: prove_retract };

fn prove(
    check: &Check<'_>,
    stands: &Position,
    jog: &Jog,
    kind: &MoveKind,
) -> Result<Proven, JogError> {
    let dialect = check.devices.as_ref().map(|devices| &devices.dialect);
    let dialect = dialect.ok_or(ControllerError::DriverGone)?;
    let axis = jog.axis;
    let to = axis.from_edge(axis.to_edge(stands.at(axis)) + jog.by);
    let block = Block { step: STEP, repeat: 0, motions: vec![(kind.motion)(jog, to)] };
    let transmission = check.transmission.as_ref().ok_or(ControllerError::DriverGone)?;
    let plan = setup::without_steps(check.file, "check", serde_json::Value::Null);
    let feed_at_most = FEED_PER_MIN;
    let request = JogRequest { plan: &plan, stands, axis, to, feed_at_most, dialect };
    Ok(Proven { block: (kind.proof)(&request, transmission, &block)?, to })
}

/// Proves a jog and checks that the machine is still at the start position of the proof: from elsewhere the
/// same text is another motion.
///
/// # Errors
/// See [`proven`]; or the machine was moved, or the control does not report its position.
pub(super) async fn proven_there(check: &Check<'_>, jog: &Jog) -> Result<Proven, JogError> {
    let proven = proven(check, jog)?;
    unmoved(check).await?;
    Ok(proven)
}

/// Executes a jog and updates the position.
///
/// # Errors
/// See [`proven_there`]; or the error of the control that stopped the jog.
pub(super) async fn go(check: &mut Check<'_>, jog: &Jog) -> Result<(), JogError> {
    let Proven { block, to } = proven_there(check, jog).await?;
    execute(check, block).await?;
    if let Some(stands) = &mut check.stands {
        stands.set(jog.axis, to);
    }
    Ok(())
}

/// Makes one step out of contact from `stands`, which the driver compares with the control's report.
///
/// # Errors
/// As [`go`]; `StillTripped`: the step is complete, and the probe input is still closed.
pub(super) async fn retract(
    check: &Check<'_>,
    stands: &Position,
    direction: AxisDirection,
) -> Result<(), JogError> {
    let AxisDirection { axis, is_positive } = direction;
    let by = if is_positive { RETRACT_MM } else { -RETRACT_MM };
    let rapid = check.file.machine.axes.get(&axis).map_or(FEED_PER_MIN, |spec| spec.rapid_per_min);
    let feed_per_min = FEED_PER_MIN.min(rapid).min(check.file.probe.search_feed_mm_min);
    let Proven { block, .. } = prove(check, stands, &Jog { axis, by, feed_per_min }, &RETRACT)?;
    execute(check, block).await
}

/// Executes a block; a stop holds the machine during the motion.
async fn execute(check: &Check<'_>, block: ProvenBlock) -> Result<(), JogError> {
    let controller = check.controller().map_err(|_| ControllerError::DriverGone)?;
    let _motion = check.stop.motion().ok_or(ControllerError::Halted)?;
    controller.execute(block).await?;
    Ok(())
}

async fn unmoved(check: &Check<'_>) -> Result<(), JogError> {
    let controller = check.controller().map_err(|_| ControllerError::DriverGone)?;
    let now = controller.look().await?.stands;
    for (axis, at) in
        check.stands.iter().flat_map(Position::iter).filter(|(axis, _)| *axis != Axis::S)
    {
        let (was, now) = (axis.to_edge(at), axis.to_edge(now.at(axis)));
        if (now - was).abs() > STILL {
            return Err(JogError::Moved { axis, was, now });
        }
    }
    Ok(())
}

/// A jog of a linear axis is guarded; a rotary axis turns at feed.
fn motion(jog: &Jog, to: f64) -> Motion {
    let (axis, feed_mm_min) = (jog.axis, jog.feed_per_min);
    let to = Position::new().with(axis, to);
    match axis.is_linear() {
        true => Motion::Guarded { to, feed_mm_min },
        false => Motion::BackOff { to, feed_mm_min },
    }
}

/// A probing move is impossible while the probe input is closed.
fn back_off(jog: &Jog, to: f64) -> Motion {
    Motion::BackOff { to: Position::new().with(jog.axis, to), feed_mm_min: jog.feed_per_min }
}
