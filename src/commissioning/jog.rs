//! One small motion: planned, rendered, read back and proven before it is sent.

use super::MachineCheck;
use crate::setup;
use devices::controllers::ControllerError;
use machine::record::machine::StatedAxis;
use machine::record::motion::{Motion, MotionBlock};
use machine::record::question::{AxisDirection, Jog};
use machine::{Axis, Position};
use planning::proof::{ProvenBlock, SingleMoveKind, SingleMoveProofRequest, StageProofError, prove_single_move};

/// Feed of a jog, mm/min or degrees/min, slow enough to be watched: a millimetre or a degree takes a second.
const MAX_JOG_FEED_PER_MIN: f64 = 60.0;
/// Distance of one retract increment, mm.
pub(super) const RETRACT_INCREMENT_MM: f64 = 1.0;
/// Maximum distance of a homed axis beyond its limit, mm or degrees.
const LIMIT_TOLERANCE_MM_OR_DEG: f64 = 0.01;
/// Maximum difference between two reported positions of a machine that was not moved, mm or degrees.
const UNMOVED_TOLERANCE_MM_OR_DEG: f64 = 0.02;
/// Number in the N words of the lines of a jog.
const JOG_N_WORD_NUMBER: u32 = 1;

/// Reason why a jog did not reach its end.
#[derive(Debug, thiserror::Error)]
pub(super) enum JogError {
    /// The jog cannot be rendered for the control, or the collision check refuses it.
    #[error("{prefix}{0}", prefix = proof_error_prefix(.0))]
    NotProven(#[from] StageProofError),
    /// Error of the control; `DriverTaskEnded` also if no control is open, `Halted` also after a stop request.
    #[error(transparent)]
    Control(#[from] ControllerError),
    #[error("the machine was moved by hand: {axis} is at {reported_mm_or_deg:.3}, not at {expected_mm_or_deg:.3}")]
    PositionChanged { axis: Axis, expected_mm_or_deg: f64, reported_mm_or_deg: f64 },
}

fn proof_error_prefix(error: &StageProofError) -> &'static str {
    match error {
        StageProofError::Render(_) => "the jog cannot be written for this control: ",
        StageProofError::Refused(_) => "the collision check refuses the jog: ",
    }
}

impl JogError {
    pub fn remedy(&self) -> String {
        match self {
            Self::NotProven(error) => error.remedy(),
            Self::Control(error) => error.remedy(),
            Self::PositionChanged { .. } => {
                "do not move the machine by hand during the check; repeat the check".to_owned()
            }
        }
    }

    /// Whether the jog failed in its proof, before anything was sent. False for `PositionChanged`: the machine was
    /// moved by hand.
    pub fn is_proof_failure(&self) -> bool {
        !matches!(self, Self::Control(_) | Self::PositionChanged { .. })
    }
}

/// A jog by `distance_mm_or_deg` away from the nearer limit. `None`: the position is not known, the axis lacks the
/// travel, or it is beyond a limit.
pub(super) fn jog_away_from_limit(
    axis: Axis,
    distance_mm_or_deg: f64,
    spec: &StatedAxis,
    position: &Position,
) -> Option<Jog> {
    let here = axis.to_mm_or_deg(position.get(axis)?);
    let (up, down) = (spec.max - here, here - spec.min);
    let by = if up >= down { distance_mm_or_deg } else { -distance_mm_or_deg };
    let feed_per_min = MAX_JOG_FEED_PER_MIN.min(spec.rapid_per_min);
    (up.max(down) >= by.abs() && up.min(down) >= -LIMIT_TOLERANCE_MM_OR_DEG).then_some(Jog { axis, by, feed_per_min })
}

/// The jog back to the start position.
pub(super) fn reversed_jog(jog: &Jog) -> Jog {
    Jog { by: -jog.by, ..*jog }
}

/// A proven jog or retract increment.
pub(super) struct ProvenJog {
    pub block: ProvenBlock,
    /// End position of the axis, mm or rad.
    pub target_mm_or_rad: f64,
}

/// Proves that a jog keeps its clearance to all bodies.
///
/// # Errors
/// The jog cannot be rendered, or it comes too close to a body.
pub(super) fn prove_planned_jog(check: &MachineCheck<'_>, jog: &Jog) -> Result<ProvenJog, JogError> {
    let position = check.position.as_ref().ok_or(ControllerError::DriverTaskEnded)?;
    prove_move(check, position, jog, SingleMoveKind::Jog)
}

/// Proves a motion of one axis from `position`: a linear axis jogs with a guarded move; a rotary axis, and any axis
/// in a retract, moves without guarding against contact.
fn prove_move(
    check: &MachineCheck<'_>,
    position: &Position,
    jog: &Jog,
    kind: SingleMoveKind,
) -> Result<ProvenJog, JogError> {
    let dialect = check.devices.as_ref().map(|devices| &devices.dialect);
    let dialect = dialect.ok_or(ControllerError::DriverTaskEnded)?;
    let axis = jog.axis;
    let to = axis.to_mm_or_rad(axis.to_mm_or_deg(position.get_or_zero(axis)) + jog.by);
    let (end, feed_mm_min) = (Position::new().with(axis, to), jog.feed_per_min);
    // A jog of a linear axis is guarded; a rotary axis turns at feed. A probing move is impossible while the probe
    // input is closed.
    let motion = match kind {
        SingleMoveKind::Jog if axis.is_linear() => Motion::Guarded { to: end, feed_mm_min },
        _ => Motion::BackOff { to: end, feed_mm_min },
    };
    let block = MotionBlock { step: JOG_N_WORD_NUMBER, repeat: 0, motions: vec![motion] };
    let transmission = check.transmission.as_ref().ok_or(ControllerError::DriverTaskEnded)?;
    let plan = setup::plan_without_steps(check.machine_file, "check", serde_json::Value::Null);
    let request = SingleMoveProofRequest {
        kind,
        plan: &plan,
        start_position: position,
        axis,
        target_mm_or_rad: to,
        max_feed_mm_or_deg_per_min: MAX_JOG_FEED_PER_MIN,
        dialect,
    };
    Ok(ProvenJog { block: prove_single_move(&request, transmission, &block)?, target_mm_or_rad: to })
}

/// Proves a jog and checks that the machine is still at the start position of the proof: from another start position
/// the same program text commands another motion.
///
/// # Errors
/// The errors of [`prove_planned_jog`]; or the machine was moved, or the control does not report its position.
pub(super) async fn prove_jog_and_check_position_unchanged(
    check: &MachineCheck<'_>,
    jog: &Jog,
) -> Result<ProvenJog, JogError> {
    let proven = prove_planned_jog(check, jog)?;
    check_position_unchanged(check).await?;
    Ok(proven)
}

/// Executes a jog and sets the stored position to the commanded end; the position is not read again.
///
/// # Errors
/// The errors of [`prove_jog_and_check_position_unchanged`]; or the error of the control that stopped the jog.
pub(super) async fn run_jog(check: &mut MachineCheck<'_>, jog: &Jog) -> Result<(), JogError> {
    let ProvenJog { block, target_mm_or_rad: to } = prove_jog_and_check_position_unchanged(check, jog).await?;
    execute_block(check, block).await?;
    if let Some(position) = &mut check.position {
        position.set(jog.axis, to);
    }
    Ok(())
}

/// Moves by one retract increment out of contact from `position`, which the driver compares with the control's report.
///
/// # Errors
/// The errors of the proof; or the error of the control that stopped the move. `ProbeStillClosed`: the move is
/// complete, and the probe input is still closed.
pub(super) async fn run_retract_increment(
    check: &MachineCheck<'_>,
    position: &Position,
    direction: AxisDirection,
) -> Result<(), JogError> {
    let AxisDirection { axis, is_positive } = direction;
    let by = if is_positive { RETRACT_INCREMENT_MM } else { -RETRACT_INCREMENT_MM };
    let rapid = check.machine_file.machine.axes.get(&axis).map_or(MAX_JOG_FEED_PER_MIN, |spec| spec.rapid_per_min);
    let feed_per_min = MAX_JOG_FEED_PER_MIN.min(rapid).min(check.machine_file.probe.search_feed_mm_min);
    let ProvenJog { block, .. } =
        prove_move(check, position, &Jog { axis, by, feed_per_min }, SingleMoveKind::Retract)?;
    execute_block(check, block).await
}

/// Executes a block; a stop holds the machine during the motion.
async fn execute_block(check: &MachineCheck<'_>, block: ProvenBlock) -> Result<(), JogError> {
    let controller = check.controller().map_err(|_| ControllerError::DriverTaskEnded)?;
    let _motion = check.stop.begin_motion().ok_or(ControllerError::Halted)?;
    controller.execute(block).await?;
    Ok(())
}

/// Compares the reported position of all axes except S with the stored position.
async fn check_position_unchanged(check: &MachineCheck<'_>) -> Result<(), JogError> {
    let controller = check.controller().map_err(|_| ControllerError::DriverTaskEnded)?;
    let now = controller.read_snapshot().await?.position;
    for (axis, at) in check.position.iter().flat_map(Position::iter).filter(|(axis, _)| *axis != Axis::S) {
        let (was, now) = (axis.to_mm_or_deg(at), axis.to_mm_or_deg(now.get_or_zero(axis)));
        if (now - was).abs() > UNMOVED_TOLERANCE_MM_OR_DEG {
            return Err(JogError::PositionChanged { axis, expected_mm_or_deg: was, reported_mm_or_deg: now });
        }
    }
    Ok(())
}
