//! Machine, ball and orientations of the spindle.

use nalgebra::Vector3;

use super::settings::ProbeQualificationSettings;
use crate::identification::azimuth_dependence::DEFAULT_LOBING_ORDERS;
use crate::{IdentifyError, MethodRefusal, ObjectPositionSource, readings_of_last_repeat};
use machine::kinematics::KinematicChain;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::{Plan, Step};
use machine::record::reading::Reading;
use machine::{Axis, Position};
use planning::evaluate_ball;

/// Prefix of the label of a search touch.
pub const SEARCH_LABEL_PREFIX: &str = "find";

pub struct QualificationSetup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a ProbeQualificationSettings,
    pub chain: KinematicChain,
    /// The balls of the artefact at their stated positions.
    pub balls: &'a Balls,
    /// All rotary axes except the spindle at zero, or as near to zero as their limits allow.
    pub rotary_nearest_zero: Position,
}

const DEFAULT_SPINDLE_ORIENTATIONS_DEG: [f64; 4] = [0.0, 90.0, 180.0, 270.0];

impl<'a> QualificationSetup<'a> {
    /// # Errors
    /// The machine has no kinematics, the artefact has no balls, or the settings do not describe a possible
    /// measurement.
    pub fn new(plan: &'a Plan, settings: &'a ProbeQualificationSettings) -> Result<Self, MethodRefusal> {
        settings.check()?;
        let Artefact::Balls(balls) = &plan.artefact else {
            return Err(MethodRefusal::new(
                "this method measures a precision sphere, but [artefact] has no balls",
                "describe the sphere with kind = \"balls\" in [artefact]",
            ));
        };
        let rotary = plan.machine.rotary_zero_position();
        let setup =
            Self { plan, settings, chain: KinematicChain::new(&plan.machine)?, balls, rotary_nearest_zero: rotary };
        settings.check_azimuths(setup.highest_order())?;
        settings.check_touch_length(plan.probe.u_stylus_offset_um * 1e-3)?;
        let (slow, fast) = (plan.probe.feed_mm_min, setup.fast_feed_mm_min());
        MethodRefusal::require(
            fast > slow && fast <= plan.probe.search_feed_mm_min,
            format!("the fast feed of {fast} mm/min is not between the measuring feed and the search feed"),
            "remove fast_feed_mm_min, and set search_feed_mm_min of [probe] above feed_mm_min",
        )?;
        let is_axis = plan.machine.axes.contains_key(&Axis::S);
        let is_asked = settings.spindle_deg.as_ref().is_some_and(|degrees| degrees.len() > 1);
        MethodRefusal::require(
            is_axis || !is_asked,
            "spindle_deg is set, but the spindle is not an axis of this machine",
            "remove spindle_deg, or add [axes.S]",
        )?;
        Ok(setup)
    }

    /// Highest order of the map: the largest of the setting `orders`, the declared lobing orders and the default
    /// ones.
    pub fn highest_order(&self) -> u32 {
        let declared = self.plan.probe.lobing_orders.iter().chain(&DEFAULT_LOBING_ORDERS);
        declared.copied().fold(self.settings.orders, u32::max)
    }

    pub fn fast_feed_mm_min(&self) -> f64 {
        self.settings.fast_feed_mm_min.unwrap_or(self.plan.probe.search_feed_mm_min)
    }

    /// Orientations of the spindle, degrees: the setting, or the default ones within the limits of S. Only 0 if the
    /// spindle is not an axis.
    pub fn spindle_orientations_deg(&self) -> Vec<f64> {
        let Some(spec) = self.plan.machine.axes.get(&Axis::S) else { return vec![0.0] };
        let named = self.settings.spindle_deg.clone().filter(|degrees| !degrees.is_empty());
        let within = |degrees: &f64| (spec.min..=spec.max).contains(degrees);
        let usual: Vec<f64> = DEFAULT_SPINDLE_ORIENTATIONS_DEG.into_iter().filter(within).collect();
        named.unwrap_or(if usual.is_empty() { vec![spec.position_nearest_zero()] } else { usual })
    }

    /// Index of the spindle orientation that is nearest to these positions.
    pub fn nearest_spindle_orientation_index(&self, at: &Position) -> usize {
        let degrees = Axis::S.to_mm_or_deg(at.get_or_zero(Axis::S));
        let off = |orientation: &f64| (orientation - degrees).abs();
        let all = self.spindle_orientations_deg().into_iter().enumerate();
        all.min_by(|(_, a), (_, b)| off(a).total_cmp(&off(b))).map_or(0, |(number, _)| number)
    }

    /// Positions of all rotary axes, with the spindle in the orientation number `orientation_index`, from 0.
    pub fn rotary_positions(&self, orientation_index: usize) -> Position {
        let degrees = self.spindle_orientations_deg().get(orientation_index).copied().unwrap_or(0.0);
        match self.plan.machine.axes.contains_key(&Axis::S) {
            true => self.rotary_nearest_zero.clone().with(Axis::S, Axis::S.to_mm_or_rad(degrees)),
            false => self.rotary_nearest_zero.clone(),
        }
    }

    /// The ball that the plan's measuring steps touch.
    ///
    /// # Errors
    /// The plan has no measuring steps yet.
    pub fn measured_ball(&self) -> Result<&Ball, IdentifyError> {
        let measured = self.plan.steps.iter().find_map(|step| {
            let id = step.label.split('/').nth(1)?;
            let is_measured = !step.label.starts_with(SEARCH_LABEL_PREFIX);
            self.balls.balls.iter().find(|ball| is_measured && ball.id == id)
        });
        let none = || IdentifyError::IdentificationFailed("the plan has no touch of a ball".to_owned());
        measured.ok_or_else(none)
    }

    /// The balls at their measured positions; nominal positions if nothing is measured. The uncertainty of the
    /// positions is set to half of the smaller of `standoff_mm` and `search_mm`.
    ///
    /// # Errors
    /// Touches are missing or do not fit a sphere.
    pub fn measured_balls(&self, source: ObjectPositionSource<'_>) -> Result<Balls, MethodRefusal> {
        let uncertainty_mm = self.settings.standoff_mm.min(self.settings.search_mm) / 2.0;
        let mut balls = Balls { uncertainty_mm, ..self.balls.clone() };
        if let ObjectPositionSource::Measured(readings) = source {
            for ball in &mut balls.balls {
                ball.centre_mm = self.measured_centre(&ball.id, readings)?.into();
            }
        }
        Ok(balls)
    }

    /// Centre of a ball from its search touches, table frame, mm.
    fn measured_centre(&self, id: &str, readings: &[Reading]) -> Result<Vector3<f64>, MethodRefusal> {
        let refusal = |reason: String| MethodRefusal::new(reason, "start a new run");
        let of_ball = |step: &&Step| {
            let mut parts = step.label.split('/');
            parts.next() == Some(SEARCH_LABEL_PREFIX) && parts.next() == Some(id)
        };
        let mut touches = Vec::new();
        for step in self.plan.steps.iter().filter(of_ball) {
            let latest = readings_of_last_repeat(step, readings).map_err(|error| refusal(error.to_string()))?;
            touches.extend(latest.first().map(|reading| step.from.updated_by(&reading.position)));
        }
        let measured = evaluate_ball(id, &touches, &self.plan.machine, &self.plan.probe);
        Ok(measured.map_err(|error| refusal(error.to_string()))?.centre_in_table_mm)
    }
}
