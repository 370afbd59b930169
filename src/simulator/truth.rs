//! The truth of a simulated machine: the errors that the daemon must identify without access to them.

use std::collections::BTreeMap;

use nalgebra::{Vector2, Vector3};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::SimulatedWorldError;
use super::datum_cylinder_truth::{DatumCylinderTruth, IndexingStageTruth};
use super::rotary_motion::RotaryMotionMagnitudes;
use super::sensor_truth::SensorTruth;
use super::thermometer_truth::ThermometerTruth;
use super::true_round_part::FormHarmonic;
use super::wiring::Wiring;
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm};
use machine::record::artefact::Balls;

/// The `[simulated]` table of the machine file. Values given here are exact; errors that the machine file declares
/// by magnitude only are drawn from `seed`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MachineTruth {
    pub seed: u64,
    /// ISO 230-1 location errors and linear gains; the unit follows the symbol: `EX0C_um`, `EA0C_urad`,
    /// `EXX1_um_per_m`.
    pub errors: BTreeMap<String, f64>,
    /// Error motions of rotary axes; each entry is one harmonic.
    pub error_motion: Vec<ErrorMotionHarmonic>,
    /// Error motions of rotary axes, declared by magnitude.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub rotary_motion: Vec<RotaryMotionMagnitudes>,
    /// Form and tilt of a datum cylinder.
    pub datum_cylinder: DatumCylinderTruth,
    /// Errors of the indexing stage of a datum cylinder.
    pub stage: IndexingStageTruth,
    /// True centre of the artefact minus the stated one, table frame X and Y.
    pub centre_offset_mm: [f64; 2],
    /// True mean radius of the artefact, of each section or of each ball minus the stated one.
    pub radius_offset_mm: f64,
    /// Form deviation of a round artefact (radius over the angle about its own axis), or of each section of a datum
    /// cylinder.
    pub form: Vec<FormHarmonic>,
    /// Standard deviation of a cylinder's random roughness, drawn from `seed`.
    pub roughness_um: f64,
    /// True stylus centre minus the stated one, spindle frame; added to the drawn offset.
    pub tool_offset_um: [f64; 3],
    /// Standard deviation of the draws of each coordinate of a ball's true centre minus the stated one.
    pub ball_offset_mm: f64,
    /// Standard deviation of the draws of a ball's true diameter minus the stated one.
    pub ball_diameter_um: f64,
    /// Standard deviation of a ball's radius over the directions (a drawn oval), for balls without `form_um`.
    pub ball_form_um: f64,
    /// Errors of single balls; centre and diameter in addition to the drawn ones.
    pub ball: Vec<BallTruth>,
    /// Balls that come loose during the run.
    pub ball_moves: Vec<BallMove>,
    /// Relative excess of the true lengths over the certified lengths at their true temperature.
    pub length_error_um_per_m: f64,
    /// Deflection of the table when the part is tilted.
    pub sag: Vec<SagTerm>,
    /// Whole lost motion of a linear axis when it reverses; without a value, drawn from the declared magnitude.
    pub backlash_um: BTreeMap<Axis, f64>,
    /// Wiring of the motors and of the probe.
    #[serde(skip_serializing_if = "Wiring::is_correct")]
    pub wiring: Wiring,
    /// Delay between contact and latch.
    pub latch: LatchDelay,
    /// True errors of the displacement sensors.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sensor: Vec<SensorTruth>,
    /// True temperatures at the thermometers.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub thermometer: Vec<ThermometerTruth>,
    /// Faults of the control: read by the simulated control, ignored by the world.
    #[serde(skip_serializing)]
    pub fault: IgnoredAny,
}

/// `cos·cos(nq) + sin·sin(nq)`, q the angle of the axis; um for EX., EY., EZ., urad for EA., EB., EC.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ErrorMotionHarmonic {
    /// e.g. `EXC`: motion along X of the axis C.
    pub symbol: String,
    /// Order n of the axis angle.
    pub harmonic: u32,
    #[serde(default)]
    pub cos_um: f64,
    #[serde(default)]
    pub sin_um: f64,
    #[serde(default)]
    pub cos_urad: f64,
    #[serde(default)]
    pub sin_urad: f64,
}

/// True errors of one ball.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallTruth {
    pub id: String,
    /// True centre minus the stated one, table frame, in addition to the drawn error. Certified lengths take
    /// precedence.
    #[serde(default)]
    pub offset_mm: [f64; 3],
    /// True diameter minus the stated one, in addition to the drawn error.
    #[serde(default)]
    pub diameter_um: f64,
    /// Standard deviation of this ball's radius over the directions; `None`: `ball_form_um`.
    pub form_um: Option<f64>,
}

/// A ball that is displaced by `by_mm` (table frame) from `at_s` on, in addition to its earlier displacements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallMove {
    pub ball: String,
    /// Simulated time since the world was created.
    pub at_s: f64,
    pub by_mm: [f64; 3],
}

/// Delay between a contact and the latched position. The axes move on during the delay, and brake after it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LatchDelay {
    /// Constant delay: the probe's filter and radio link, and the reaction of the control.
    pub delay_ms: f64,
    /// Period at which a PLC reads the probe; the contact occurs at a random time within it.
    pub scan_ms: f64,
}

/// Displacement of the table as a function of the angle q of a tilt axis, machine frame, given at q = 90°.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SagTerm {
    pub axis: Axis,
    #[serde(default)]
    pub law: SagLaw,
    /// Displacement of the table's origin along X, Y and Z.
    #[serde(default)]
    pub um: [f64; 3],
    /// Rotation vector about the position of the table's origin.
    #[serde(default)]
    pub urad: [f64; 3],
}

/// Deflection at the angle q of the axis, as a share of that at 90°.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SagLaw {
    /// sin q: for a weight whose lever arm changes sides.
    #[default]
    Sin,
    /// 1 − cos q: equal on both sides.
    OneMinusCos,
}

impl MachineTruth {
    /// Offset of the artefact as a whole, table frame, mm.
    pub(super) fn artefact_offset_mm(&self) -> Vector3<f64> {
        Vector2::from(self.centre_offset_mm).push(0.0)
    }

    /// Rejects keys that apply to balls only.
    pub(super) fn reject_ball_keys(&self) -> Result<(), SimulatedWorldError> {
        let is_stated = [
            ("ball_offset_mm", self.ball_offset_mm != 0.0),
            ("ball_diameter_um", self.ball_diameter_um != 0.0),
            ("ball_form_um", self.ball_form_um != 0.0),
            ("length_error_um_per_m", self.length_error_um_per_m != 0.0),
            ("ball", !self.ball.is_empty()),
            ("ball_moves", !self.ball_moves.is_empty()),
        ];
        reject_stated_keys(&is_stated, "balls")
    }

    /// Rejects the keys `form` and `roughness_um`, which describe a cylinder.
    pub(super) fn reject_form_keys(&self) -> Result<(), SimulatedWorldError> {
        let is_stated = [("form", !self.form.is_empty()), ("roughness_um", self.roughness_um != 0.0)];
        reject_stated_keys(&is_stated, "cylinder")
    }

    /// Rejects the keys `form` and `roughness_um`, which describe a cylinder, and unknown balls.
    pub(super) fn check_keys_for_balls(&self, balls: &Balls) -> Result<(), SimulatedWorldError> {
        self.reject_form_keys()?;
        let referenced_ids = self.ball.iter().map(|ball| &ball.id);
        let mut referenced_ids = referenced_ids.chain(self.ball_moves.iter().map(|moved| &moved.ball));
        match referenced_ids.find(|id| balls.balls.iter().all(|ball| ball.id != **id)) {
            None => Ok(()),
            Some(id) => Err(SimulatedWorldError::UnknownBall { id: id.clone() }),
        }
    }

    /// All errors of the machine in `errors` and `error_motion`, in mm, rad and mm/mm.
    pub(super) fn error_terms(&self) -> Result<Vec<ErrorTerm>, SimulatedWorldError> {
        let stated = self.errors.iter().map(|(key, value)| parse_error_term(key, *value));
        let mut terms = stated.collect::<Result<Vec<_>, _>>()?;
        for motion in &self.error_motion {
            let values = [
                ("cos", "um", motion.cos_um),
                ("sin", "um", motion.sin_um),
                ("cos", "urad", motion.cos_urad),
                ("sin", "urad", motion.sin_urad),
            ];
            for (part, unit, value) in values.into_iter().filter(|(_, _, value)| *value != 0.0) {
                let key = format!("{}_{part}{}_{unit}", motion.symbol, motion.harmonic);
                terms.push(parse_error_term(&key, value)?);
            }
        }
        Ok(terms)
    }
}

/// Rejects the first stated key; `kind`: artefacts to which the keys apply.
fn reject_stated_keys(is_stated: &[(&'static str, bool)], kind: &'static str) -> Result<(), SimulatedWorldError> {
    match is_stated.iter().find(|(_, is_stated)| *is_stated) {
        Some((key, _)) => Err(SimulatedWorldError::WrongArtefactKind { key, kind }),
        None => Ok(()),
    }
}

/// Parses a key and value such as `EX0C_um = 50.0`.
fn parse_error_term(key: &str, value: f64) -> Result<ErrorTerm, SimulatedWorldError> {
    let units = [("_um_per_m", 1e-6), ("_urad", 1e-6), ("_um", 1e-3)];
    let (symbol, unit, scale) = units
        .into_iter()
        .find_map(|(unit, scale)| Some((key.strip_suffix(unit)?, unit, scale)))
        .ok_or_else(|| SimulatedWorldError::WrongUnit { key: key.to_owned(), unit: "_um, _urad or _um_per_m" })?;
    let parameter: ErrorParameter = symbol.parse()?;
    let required_unit = match parameter.shape() {
        ErrorShape::Gain => "_um_per_m",
        _ if parameter.component().is_linear() => "_um",
        _ => "_urad",
    };
    if unit != required_unit {
        return Err(SimulatedWorldError::WrongUnit { key: key.to_owned(), unit: required_unit });
    }
    Ok(ErrorTerm { parameter, value: value * scale })
}
