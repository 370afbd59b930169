//! The truth of a simulated machine: what the daemon is to find out and must never see.

use std::collections::BTreeMap;

use nalgebra::{Vector2, Vector3};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::WorldError;
use super::datum_truth::{DatumTruth, StageTruth};
use super::flank::FormHarmonic;
use super::rotary_motion::RotaryMotion;
use super::sensor_truth::SensorTruth;
use super::warmth::Warmth;
use super::wiring::Wiring;
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorTerm, Shape};
use machine::record::artefact::Balls;

/// The `[simulated]` table of the machine file. Whatever stands here is exactly so; sources that
/// the machine file declares by magnitude only are drawn from `seed`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Truth {
    pub seed: u64,
    /// ISO 230-1 location errors and linear gains, the unit behind the symbol: `EX0C_um`,
    /// `EA0C_urad`, `EXX1_um_per_m`.
    pub errors: BTreeMap<String, f64>,
    /// Error motions of rotary axes, one harmonic each.
    pub error_motion: Vec<ErrorMotion>,
    /// The same, declared by magnitude.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub rotary_motion: Vec<RotaryMotion>,
    /// Form and tilt of a datum cylinder, and the stage that indexes it.
    pub datum_cylinder: DatumTruth,
    pub stage: StageTruth,
    /// True centre of the artefact minus the stated one, table frame X and Y.
    pub centre_offset_mm: [f64; 2],
    /// True mean radius of the artefact minus the stated one.
    pub radius_offset_mm: f64,
    /// Form deviation of the artefact: radius over the angle about its own axis.
    pub form: Vec<FormHarmonic>,
    /// Standard deviation of the artefact's random roughness, drawn from `seed`.
    pub roughness_um: f64,
    /// True stylus centre less the stated one, spindle frame, beside what is drawn.
    pub tool_offset_um: [f64; 3],
    /// Standard deviations of what is drawn for each ball: each coordinate of the true centre less
    /// the stated one, the same of the diameter, and the radius over the directions (an oval).
    pub ball_offset_mm: f64,
    pub ball_diameter_um: f64,
    pub ball_form_um: f64,
    /// What is known of single balls, beside what is drawn.
    pub ball: Vec<BallTruth>,
    /// Balls that come loose.
    pub ball_moves: Vec<BallMove>,
    /// By how much certified lengths are longer than certificate and temperature say.
    pub length_error_um_per_m: f64,
    /// How the table gives way as the part is tilted.
    pub sag: Vec<SagTerm>,
    /// Lost motion of a linear axis when it reverses.
    pub backlash_um: BTreeMap<Axis, f64>,
    /// How motors and probe are connected.
    #[serde(skip_serializing_if = "Wiring::is_right")]
    pub wiring: Wiring,
    /// How late a contact is noticed.
    pub latch: Latch,
    /// The displacement sensors in the spindle.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sensor: Vec<SensorTruth>,
    /// How warm it is where the thermometers sit.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub thermometer: Vec<Warmth>,
    /// What the control does wrong: the simulated control reads it, the world does not.
    #[serde(skip_serializing)]
    pub fault: IgnoredAny,
}

/// `cos·cos(nq) + sin·sin(nq)`, q the angle of the axis; um for EX., EY., EZ., urad for EA., EB., EC.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ErrorMotion {
    /// e.g. `EXC`: motion along X of the axis C.
    pub symbol: String,
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

/// One ball as it is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallTruth {
    pub id: String,
    /// True centre less the stated one, table frame. What a certificate holds goes before it.
    #[serde(default)]
    pub offset_mm: [f64; 3],
    #[serde(default)]
    pub diameter_um: f64,
    /// In place of `ball_form_um`.
    #[serde(default)]
    pub form_um: Option<f64>,
}

/// A ball that stands off by `by_mm` (table frame) from `at_s` on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallMove {
    pub ball: String,
    /// Since the world was made.
    pub at_s: f64,
    pub by_mm: [f64; 3],
}

/// What lies between a contact and the position that is kept for it. The axes move on meanwhile, and
/// brake only then.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Latch {
    /// Always: the probe's filter and radio link, the control's own reaction.
    pub delay_ms: f64,
    /// A PLC looks at the probe once in so long; contact falls anywhere in between.
    pub scan_ms: f64,
}

/// The table's displacement over the angle q of a tilt axis, machine frame, as it is at q = 90°.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SagTerm {
    pub axis: Axis,
    #[serde(default)]
    pub law: SagLaw,
    #[serde(default)]
    pub um: [f64; 3],
    /// Rotation vector, about where the table's origin stands.
    #[serde(default)]
    pub urad: [f64; 3],
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SagLaw {
    /// sin q: a weight whose lever changes sides.
    #[default]
    Sin,
    /// 1 − cos q: the same on both sides.
    OneMinusCos,
}

impl Truth {
    /// Of the artefact as a whole, table frame, mm.
    pub(super) fn centre_offset(&self) -> Vector3<f64> {
        Vector2::from(self.centre_offset_mm).push(0.0)
    }

    /// Refuse what only balls can have.
    pub(super) fn of_a_round_part(&self) -> Result<(), WorldError> {
        let drawn = [
            ("ball_offset_mm", self.ball_offset_mm),
            ("ball_diameter_um", self.ball_diameter_um),
            ("ball_form_um", self.ball_form_um),
            ("length_error_um_per_m", self.length_error_um_per_m),
        ];
        let drawn = drawn.into_iter().filter(|(_, value)| *value != 0.0).map(|(key, _)| key);
        let listed = [("ball", self.ball.is_empty()), ("ball_moves", self.ball_moves.is_empty())];
        let listed = listed.into_iter().filter(|(_, empty)| !empty).map(|(key, _)| key);
        refuse(drawn.chain(listed), "balls")
    }

    /// Refuse what only a round part can have.
    pub(super) fn of_no_form(&self) -> Result<(), WorldError> {
        let form = ("form", !self.form.is_empty());
        let rough = ("roughness_um", self.roughness_um != 0.0);
        let stated = [form, rough].into_iter().filter(|(_, there)| *there).map(|(key, _)| key);
        refuse(stated, "cylinder")
    }

    /// Refuse what only a round part can have, and balls that are not there.
    pub(super) fn of_balls(&self, balls: &Balls) -> Result<(), WorldError> {
        self.of_no_form()?;
        let named = self.ball.iter().map(|ball| &ball.id);
        let mut named = named.chain(self.ball_moves.iter().map(|moved| &moved.ball));
        match named.find(|id| balls.balls.iter().all(|ball| ball.id != **id)) {
            None => Ok(()),
            Some(id) => Err(WorldError::NoBall { id: id.clone() }),
        }
    }

    /// All errors of the machine, in mm, rad and mm/mm.
    pub(super) fn error_terms(&self) -> Result<Vec<ErrorTerm>, WorldError> {
        let mut terms = Vec::new();
        for (key, value) in &self.errors {
            terms.push(read_error(key, *value)?);
        }
        for motion in &self.error_motion {
            let values = [
                ("cos", "um", motion.cos_um),
                ("sin", "um", motion.sin_um),
                ("cos", "urad", motion.cos_urad),
                ("sin", "urad", motion.sin_urad),
            ];
            for (part, unit, value) in values.into_iter().filter(|(_, _, value)| *value != 0.0) {
                let key = format!("{}_{part}{}_{unit}", motion.symbol, motion.harmonic);
                terms.push(read_error(&key, value)?);
            }
        }
        Ok(terms)
    }
}

fn refuse(
    mut keys: impl Iterator<Item = &'static str>,
    belongs: &'static str,
) -> Result<(), WorldError> {
    keys.next().map_or(Ok(()), |key| Err(WorldError::OtherKind { key, belongs }))
}

/// `EX0C_um = 50.0` and the like.
fn read_error(key: &str, value: f64) -> Result<ErrorTerm, WorldError> {
    let units = [("_um_per_m", 1e-6), ("_urad", 1e-6), ("_um", 1e-3)];
    let (symbol, unit, scale) = units
        .into_iter()
        .find_map(|(unit, scale)| key.strip_suffix(unit).map(|symbol| (symbol, unit, scale)))
        .ok_or_else(|| WorldError::Unit { key: key.to_owned(), unit: "_um, _urad or _um_per_m" })?;
    let parameter: ErrorParameter = symbol.parse()?;
    let wanted = match parameter.shape() {
        Shape::Gain => "_um_per_m",
        _ if parameter.component().is_linear() => "_um",
        _ => "_urad",
    };
    if unit != wanted {
        return Err(WorldError::Unit { key: key.to_owned(), unit: wanted });
    }
    Ok(ErrorTerm { parameter, value: value * scale })
}
