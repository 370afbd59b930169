//! The measurement setup of a method: plan, balls, and the settings of the touches.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::touch_order::TouchOrder;
use crate::Refused;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::Plan;
use machine::{Axis, Position};
use planning::{Access, Approach, BallTask};

/// When fast touches search for a ball before it is measured slowly.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Find {
    /// Once; afterwards the expected position follows from the nominal machine.
    Once,
    /// At every indexation, as in paper 4, section 3.
    #[default]
    Every,
}

/// One rotary position and the balls measured there, as indices of the artefact's balls.
#[derive(Debug, Clone, PartialEq)]
pub struct Visit {
    pub at: Position,
    pub balls: Vec<usize>,
    /// Order of the touches of a ball in a slow measurement, by ball; the default order if absent.
    pub around: BTreeMap<usize, TouchOrder>,
}

impl Visit {
    pub fn new(at: Position, balls: Vec<usize>) -> Self {
        Self { at, balls, around: BTreeMap::new() }
    }
}

/// Touch settings of each ball measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TouchSettings {
    pub find: Find,
    /// Number of touches of one measurement: 5, or more for a form check.
    pub touches: usize,
    /// Whether one ball is measured again at the start, the middle and the end.
    pub has_references: bool,
    /// Duration for which one ball is watched before the run, s; 0: no watch.
    pub watch_s: f64,
    /// Clearance before the expected contact of a slow touch, mm.
    pub standoff_mm: f64,
    /// Maximum travel of a slow touch beyond the expected contact, mm.
    pub search_mm: f64,
    /// Maximum form of one measurement (largest minus smallest residual of its sphere), mm; beyond it the run
    /// is held.
    pub form_limit_mm: f64,
    /// Maximum difference from the stated diameter, including pre-travel, mm; beyond it the run is held.
    pub diameter_limit_mm: f64,
}

const MOST_WATCH_S: f64 = 7200.0;

impl TouchSettings {
    /// # Errors
    /// A setting would make the run fail.
    pub fn check(&self) -> Result<(), Refused> {
        Refused::unless(
            self.standoff_mm > 0.0 && self.search_mm > 0.0 && self.search_mm.is_finite(),
            "standoff_mm and search_mm must be greater than 0",
            "leave them out, or choose about 0.5 and 1.0",
        )?;
        Refused::unless(
            (5..=100).contains(&self.touches),
            format!("{} touches do not tell a ball from its dents", self.touches),
            "choose touches = 5, or 15 for a form check",
        )?;
        Refused::unless(
            (0.0..=MOST_WATCH_S).contains(&self.watch_s),
            "a ball is watched for 0 to 120 minutes",
            "choose watch_min = 10, or 0 to begin at once",
        )?;
        Refused::unless(
            self.form_limit_mm > 0.0 && self.diameter_limit_mm > 0.0,
            "form_limit_um and diameter_limit_um must be greater than 0",
            "leave them out, or choose about 15 and 30",
        )
    }
}

impl TouchSettings {
    /// Maximum distance of a ball from the position where it was found, mm: half of the standoff of a slow
    /// touch, or of its search distance if that is smaller.
    pub fn found_within_mm(&self) -> f64 {
        self.standoff_mm.min(self.search_mm) / 2.0
    }
}

#[derive(Debug, Clone, Copy)]
pub struct MeasurementSetup<'a> {
    /// Name of the method, for the table `[method.NAME]` in messages.
    pub method: &'static str,
    pub plan: &'a Plan,
    pub balls: &'a Balls,
    pub touch: TouchSettings,
}

impl<'a> MeasurementSetup<'a> {
    /// The same setup for an extended plan.
    pub fn with<'b>(&self, plan: &'b Plan) -> MeasurementSetup<'b>
    where
        'a: 'b,
    {
        MeasurementSetup { plan, ..*self }
    }

    /// Free space around the artefact at its assumed position.
    ///
    /// # Errors
    /// The machine has no kinematics.
    pub fn access(&self, artefact: &Artefact) -> Result<Access, Refused> {
        Ok(Access::new(self.plan, artefact)?)
    }

    /// Task of one measurement of a ball.
    pub fn task<'t>(
        &self,
        ball: &'t Ball,
        rotary: &'t Position,
        approach: Approach,
    ) -> BallTask<'t> {
        BallTask { ball, rotary, approach, touches: self.touch.touches }
    }

    /// Fast approach to a ball whose position has this uncertainty.
    pub fn search(&self, uncertainty_mm: f64) -> Approach {
        Approach::Find { uncertainty_mm, standoff_mm: self.touch.standoff_mm }
    }
}

/// Text of a rotary position in degrees: `B30 C90 S0`.
pub fn describe_position(at: &Position) -> String {
    let degree = |axis: Axis, value: f64| (axis.to_edge(value) * 1e3).round() / 1e3;
    let words: Vec<String> =
        at.iter().map(|(axis, value)| format!("{axis}{}", degree(axis, value) + 0.0)).collect();
    words.join(" ")
}
