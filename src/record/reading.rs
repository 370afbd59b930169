//! A reading: what came back from one step.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::base::Position;

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Flag {
    #[default]
    #[serde(rename = "")]
    None,
    Range,
    Saturated,
    Stale,
    Gap,
    Excluded,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    pub step: u32,
    pub repeat: u32,
    /// Axis positions: at the trigger (touch), or with the sample (scan).
    pub position: Position,
    /// Displacement of a scan sample; `None` for a touch.
    pub value_mm: Option<f64>,
    pub sensor: String,
    pub t_s: f64,
    #[serde(default)]
    pub flag: Flag,
    /// Temperatures by sensor name, °C.
    #[serde(default)]
    pub temperatures_c: BTreeMap<String, f64>,
}
