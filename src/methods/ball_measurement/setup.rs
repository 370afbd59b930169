//! The measurement setup of a method: plan, balls, and the settings of the touches.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::touch_order::TouchOrder;
use crate::MethodRefusal;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::{Plan, Step, StepKind};
use machine::{Axis, Position};
use planning::{BallAccessError, BallMeasurementRequest, BallTouchMode, TouchAccess};

/// When fast touches search for a ball before it is measured slowly.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SearchMode {
    /// Once for each ball; afterwards the expected position follows from the nominal machine.
    Once,
    /// At every indexation, as in paper 4, section 3.
    #[default]
    Every,
}

/// One rotary position and the balls measured there, as indices of the artefact's balls.
#[derive(Debug, Clone, PartialEq)]
pub struct BallVisit {
    /// Positions of all rotary axes, and of S if the spindle is oriented, rad.
    pub rotary_position: Position,
    /// In the order of the path. A slow measurement that directly follows a search at the visit takes the balls
    /// in reverse order.
    pub ball_indices: Vec<usize>,
    /// Order of the touches in a slow measurement, by index of the ball; the default order if absent.
    pub slow_touch_orders_by_ball_index: BTreeMap<usize, TouchOrder>,
}

impl BallVisit {
    pub fn new(at: Position, balls: Vec<usize>) -> Self {
        Self { rotary_position: at, ball_indices: balls, slow_touch_orders_by_ball_index: BTreeMap::new() }
    }
}

/// Touch settings of each ball measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TouchSettings {
    pub search_mode: SearchMode,
    /// Number of touches of one measurement: 5, or more for a form check; fewer are planned where touches are not
    /// free.
    pub touch_count: usize,
    /// Whether one ball is measured again at the start, the middle and the end.
    pub has_references: bool,
    /// Minimum duration of the rest check before the run, in which one ball is measured repeatedly, s; 0: no check.
    pub min_rest_check_s: f64,
    /// Clearance before the expected contact of a slow touch, mm. A search touch adds the position uncertainty of the
    /// ball.
    pub standoff_mm: f64,
    /// Maximum travel of a slow touch beyond the expected contact, mm; the travel of a search touch follows from the
    /// position uncertainty of the ball.
    pub search_mm: f64,
    /// Maximum form of one measurement with slow touches (largest minus smallest residual of its sphere), mm; beyond
    /// it the ball is measured again, and the run is held if the repeat exceeds the limit too.
    pub form_hold_limit_mm: f64,
    /// Maximum difference between measured and stated diameter with slow touches, pre-travel included, mm; beyond it
    /// the ball is measured again, and the run is held if the repeat exceeds the limit too.
    pub diameter_deviation_hold_limit_mm: f64,
}

/// Largest accepted value of `min_rest_check_s`.
const MAX_MIN_REST_CHECK_S: f64 = 7200.0;
pub const UNREACHABLE_BALL_REMEDY: &str = "remove the position from tilt_deg and turn_deg, or place the ball elsewhere";

impl TouchSettings {
    /// # Errors
    /// A setting would make the run fail.
    pub fn check(&self) -> Result<(), MethodRefusal> {
        MethodRefusal::require(
            self.standoff_mm > 0.0 && self.search_mm > 0.0 && self.search_mm.is_finite(),
            "standoff_mm and search_mm must be greater than 0",
            "remove both settings, or choose about 0.5 and 1.0",
        )?;
        MethodRefusal::require(
            (5..=100).contains(&self.touch_count),
            format!("touches = {}: a ball requires 5 to 100 touches", self.touch_count),
            "choose touches = 5, or 15 for a form check",
        )?;
        MethodRefusal::require(
            (0.0..=MAX_MIN_REST_CHECK_S).contains(&self.min_rest_check_s),
            "watch_min must be 0 to 120",
            "choose watch_min = 10, or 0 to start without a rest check",
        )?;
        MethodRefusal::require(
            self.form_hold_limit_mm > 0.0 && self.diameter_deviation_hold_limit_mm > 0.0,
            "form_limit_um and diameter_limit_um must be greater than 0",
            "remove both settings, or choose about 15 and 30",
        )
    }

    /// Maximum assumed distance of a ball from its found position, mm: half of the standoff or of the search distance
    /// of a slow touch, whichever is smaller.
    pub fn found_position_tolerance_mm(&self) -> f64 {
        self.standoff_mm.min(self.search_mm) / 2.0
    }
}

/// Inputs for planning and evaluating the ball measurements of a run.
#[derive(Debug, Clone, Copy)]
pub struct MeasurementSetup<'a> {
    /// Name of the method, for the table `[method.NAME]` in messages.
    pub method: &'static str,
    /// The plan with the steps of all stages planned so far.
    pub plan: &'a Plan,
    /// The balls of the artefact at their stated positions.
    pub balls: &'a Balls,
    pub touch_settings: TouchSettings,
}

impl MeasurementSetup<'_> {
    /// Check of the accessible touches of the artefact at its assumed position.
    ///
    /// # Errors
    /// The machine has no kinematics.
    pub fn touch_access(&self, artefact: &Artefact) -> Result<TouchAccess, MethodRefusal> {
        Ok(TouchAccess::new(self.plan, artefact)?)
    }

    /// Request for one measurement of a ball.
    pub fn ball_measurement_request<'t>(
        &self,
        ball: &'t Ball,
        rotary: &'t Position,
        mode: BallTouchMode,
    ) -> BallMeasurementRequest<'t> {
        BallMeasurementRequest { ball, rotary, touch_mode: mode, touch_count: self.touch_settings.touch_count }
    }

    /// Steps of one measurement of a ball: the touches in their order around the ball, the pole last. `label`: step
    /// label from the name of a touch.
    ///
    /// # Errors
    /// The ball cannot be touched, or its position is too uncertain for a search.
    pub fn ball_steps(
        &self,
        access: &TouchAccess,
        request: &BallMeasurementRequest<'_>,
        kind: StepKind,
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, MethodRefusal> {
        access.touch_steps(request, &self.plan.probe, kind, label).map_err(|reason| {
            let remedy = match reason {
                BallAccessError::SearchTooLong { .. } => format!(
                    "lower uncertainty_mm of [artefact] ({} mm): place the artefact closer to centre_mm, or \
                    measure the position by hand and correct centre_mm",
                    self.balls.uncertainty_mm
                ),
                _ => UNREACHABLE_BALL_REMEDY.to_owned(),
            };
            let position = describe_rotary_axes_in_degrees(request.rotary);
            MethodRefusal::new(format!("ball {} at {position}: {reason}", request.ball.id), remedy)
        })
    }

    /// Slow touches of a ball at its found position.
    pub fn slow_touch_mode(&self) -> BallTouchMode {
        let TouchSettings { standoff_mm, search_mm, .. } = self.touch_settings;
        BallTouchMode::Measure { standoff_mm, search_mm }
    }

    /// Fast touches of a ball whose position has this uncertainty.
    pub fn search_touch_mode(&self, uncertainty_mm: f64) -> BallTouchMode {
        BallTouchMode::Search { uncertainty_mm, standoff_mm: self.touch_settings.standoff_mm }
    }
}

/// Text of a rotary position in degrees: `B30 C90 S0`.
pub fn describe_rotary_axes_in_degrees(at: &Position) -> String {
    let degree = |axis: Axis, value: f64| (axis.to_mm_or_deg(value) * 1e3).round() / 1e3;
    let parts: Vec<String> = at.iter().map(|(axis, value)| format!("{axis}{}", degree(axis, value) + 0.0)).collect();
    parts.join(" ")
}
