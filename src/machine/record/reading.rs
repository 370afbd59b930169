//! A reading: the result of one step.

use std::collections::BTreeMap;
use std::str::FromStr;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::plan::Step;
use crate::Position;

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ReadingFlag {
    #[default]
    #[serde(rename = "")]
    None,
    /// The sensor reports no distance: the surface is out of its range, or gives no echo.
    Range,
    /// The sensor reports a saturated signal.
    Saturated,
    /// The value repeats an earlier reading, because the sensor gave no new value.
    Stale,
    /// Samples are missing, before this sample or at this angle.
    Gap,
    /// Excluded from the identification by the operator.
    Excluded,
}

impl ReadingFlag {
    pub const ALL: [ReadingFlag; 6] =
        [Self::None, Self::Range, Self::Saturated, Self::Stale, Self::Gap, Self::Excluded];

    /// The flag as written in files; empty for none.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Range => "range",
            Self::Saturated => "saturated",
            Self::Stale => "stale",
            Self::Gap => "gap",
            Self::Excluded => "excluded",
        }
    }
}

impl FromStr for ReadingFlag {
    type Err = UnknownReadingFlag;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|flag| flag.as_str() == text).ok_or_else(|| UnknownReadingFlag(text.to_owned()))
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown flag `{0}`; the flags are range, saturated, stale, gap and excluded, or nothing")]
pub struct UnknownReadingFlag(pub String);

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Id of the step.
    pub step: u32,
    /// Pass of the reading, coded as in [`Stage::repeat`](super::plan::Stage::repeat).
    pub repeat: u32,
    /// Axis positions: at the trigger (touch), or with the sample (scan).
    pub position: Position,
    /// Displacement of a scan sample; `None` for a touch.
    pub value_mm: Option<f64>,
    pub sensor: String,
    /// Time of the reading on the clock of the run, s.
    pub t_s: f64,
    #[serde(default)]
    pub flag: ReadingFlag,
    #[serde(default)]
    pub temperatures_c: Temperatures,
}

impl Reading {
    /// A reading at the time `t_s` as if the touch made contact at its start point.
    pub fn at_touch_start(step: &Step, t_s: f64) -> Self {
        Self {
            step: step.id,
            repeat: 0,
            position: step.from.clone(),
            value_mm: None,
            sensor: step.first_sensor().to_owned(),
            t_s,
            flag: ReadingFlag::None,
            temperatures_c: Temperatures::default(),
        }
    }
}

/// Temperature, °C, by the name of the thermometer; a thermometer without a value is not contained. All samples of
/// a scan share one map, because there may be a million of them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "BTreeMap<String, f64>", into = "BTreeMap<String, f64>")]
pub struct Temperatures(Option<Arc<BTreeMap<String, f64>>>);

impl Temperatures {
    pub fn get(&self, name: &str) -> Option<f64> {
        self.0.as_ref()?.get(name).copied()
    }

    /// Names and temperatures, °C, in the order of the names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, f64)> {
        self.0.iter().flat_map(|all| all.iter()).map(|(name, celsius)| (name.as_str(), *celsius))
    }
}

impl From<BTreeMap<String, f64>> for Temperatures {
    fn from(all: BTreeMap<String, f64>) -> Self {
        Self((!all.is_empty()).then(|| Arc::new(all)))
    }
}

impl From<Temperatures> for BTreeMap<String, f64> {
    fn from(Temperatures(all): Temperatures) -> Self {
        all.map(Arc::unwrap_or_clone).unwrap_or_default()
    }
}
