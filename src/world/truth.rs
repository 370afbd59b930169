//! The truth of a simulated machine: what the daemon is to find out and must never see.

use std::collections::BTreeMap;

use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::WorldError;
use crate::base::Axis;
use crate::kinematics::{ErrorParameter, ErrorTerm, Shape};

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
    /// True centre of the artefact minus the stated one, table frame X and Y.
    pub centre_offset_mm: [f64; 2],
    /// True mean radius of the artefact minus the stated one.
    pub radius_offset_mm: f64,
    /// Form deviation of the artefact: radius over the angle about its own axis.
    pub form: Vec<FormHarmonic>,
    /// Standard deviation of the artefact's random roughness, drawn from `seed`.
    pub roughness_um: f64,
    /// Lost motion of a linear axis when it reverses.
    pub backlash_um: BTreeMap<Axis, f64>,
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

/// `cos·cos(nψ) + sin·sin(nψ)`, ψ counter-clockwise about the artefact's axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FormHarmonic {
    pub n: u32,
    #[serde(default)]
    pub cos_um: f64,
    #[serde(default)]
    pub sin_um: f64,
}

impl Truth {
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
