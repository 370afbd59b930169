//! Machine, artefact and settings for the design: the possible measurements, and the information that each
//! would give.

use nalgebra::Vector3;

use super::machine_information::{CandidateMeasurement, LengthBar, MachineInformation, REQUIRED_OFFSET_U_MM};
use crate::MethodRefusal;
use crate::ball_measurement::{
    MeasurementSetup, ball_index, describe_rotary_axes_in_degrees, require_balls, tilts_spindle,
};
use crate::samba::geometry_model::{GeometryModel, length_u_mm};
use crate::samba::settings::{SambaSettings, SpindleOrientMode};
use machine::frame::unit_vector;
use machine::kinematics::{ErrorParameter, ErrorShape, KinematicChain};
use machine::record::artefact::{Ball, Balls};
use machine::record::machine::Machine;
use machine::record::plan::Plan;
use machine::{Axis, Position, frame::Point, frame::SpindleFrame};

/// Required uncertainty of an angular parameter of the machine at a noise of 1 µm (METHODS section 4, G4), rad. The
/// optimality criteria compare the parameters in units of this value, [`REQUIRED_GAIN_U`] and
/// [`REQUIRED_OFFSET_U_MM`].
const REQUIRED_ANGLE_U_RAD: f64 = 2e-6;
/// Required uncertainty of a gain at a noise of 1 µm, mm/mm.
const REQUIRED_GAIN_U: f64 = 2.5e-6;
/// Standard uncertainty of a coordinate of a ball centre if none is declared, mm.
const DEFAULT_CENTRE_STD_U_MM: f64 = 1e-3;

pub struct DesignSetup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a SambaSettings,
    pub balls: &'a Balls,
    pub model: GeometryModel,
    /// Stated stylus tip.
    pub tip: Point<SpindleFrame>,
    /// Whether the design turns the spindle: axis S is declared and `spindle` is not `fixed`.
    pub is_spindle_oriented: bool,
}

impl<'a> DesignSetup<'a> {
    /// # Errors
    /// Settings, artefact or machine do not allow a measurement; the text states the reason.
    pub fn new(plan: &'a Plan, settings: &'a SambaSettings) -> Result<Self, MethodRefusal> {
        let set = require_balls(crate::samba::METHOD_NAME, &plan.artefact)?;
        settings.check()?;
        let chain = KinematicChain::new(&plan.machine)?;
        let is_spindle_oriented = spindle_turns(&plan.machine, settings)?;
        let model = GeometryModel::for_plan(chain, plan, settings, set)?;
        check_errors_of_fixed_axes(&model)?;
        let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
        Ok(Self { plan, settings, balls: set, model, tip, is_spindle_oriented })
    }

    /// Measurement setup of the balls.
    pub fn measurement_setup(&self) -> MeasurementSetup<'a> {
        let Self { plan, settings, balls, .. } = *self;
        MeasurementSetup { method: crate::samba::METHOD_NAME, plan, balls, touch_settings: settings.touch_settings() }
    }

    /// Axis positions with the tip at the stated centre of the ball.
    pub fn position_at_ball(&self, at: &Position, ball: &Ball) -> Result<Position, MethodRefusal> {
        let centre = Point::from_vec(Vector3::from(ball.centre_mm));
        let linear = self.model.chain().solve_linear_axes(centre, self.tip, at, &[]);
        let linear = linear.map_err(|error| {
            let reason = format!("ball {} at {}: {error}", ball.id, describe_rotary_axes_in_degrees(at));
            MethodRefusal::new(reason, "correct the directions in [axes]")
        })?;
        Ok(at.updated_by(&linear.filter_axes(Axis::is_linear)))
    }

    /// The measurement of the ball at this indexation, with its derivatives scaled for the optimality criteria.
    pub fn candidate_measurement(
        &self,
        indexation: usize,
        at: &Position,
        ball_index: usize,
        ball: &Ball,
    ) -> Result<CandidateMeasurement, MethodRefusal> {
        let derivatives = self.model.nominal_tip_derivatives(&self.position_at_ball(at, ball)?, self.tip);
        let units = self.parameter_units().chain(std::iter::repeat(REQUIRED_OFFSET_U_MM));
        let scaled = derivatives.iter().zip(units).map(|(column, unit)| *column * unit / self.centre_u_mm());
        Ok(CandidateMeasurement { indexation_index: indexation, ball_index, scaled_derivatives: scaled.collect() })
    }

    /// Information from the certified lengths alone.
    pub fn length_information(&self) -> MachineInformation {
        let (machine, shared) = (self.model.parameters().len(), self.model.shared_unknown_count());
        let bars: Vec<LengthBar> = self.length_bars().collect();
        MachineInformation::new(machine, shared, self.balls.balls.len(), &bars, self.centre_u_mm())
    }

    /// The certified lengths between balls of the artefact.
    pub fn length_bars(&self) -> impl Iterator<Item = LengthBar> + '_ {
        self.balls.lengths.iter().filter_map(|length| {
            let ball_indices = [ball_index(self.balls, &length.from)?, ball_index(self.balls, &length.to)?];
            let [from, to] = ball_indices.map(|ball| Vector3::from(self.balls.balls[ball].centre_mm));
            Some(LengthBar { ball_indices, direction: unit_vector(to - from)?, u_mm: length_u_mm(length) })
        })
    }

    /// Standard uncertainty of a coordinate of a ball centre, mm: the declared repeatability of the probe, at least
    /// 0.01 µm, or 1 µm if none is declared.
    pub fn centre_u_mm(&self) -> f64 {
        self.plan.probe.repeatability_um.map_or(DEFAULT_CENTRE_STD_U_MM, |um| um.max(0.01) * 1e-3)
    }

    /// Required uncertainty of each machine parameter, used as its unit.
    fn parameter_units(&self) -> impl Iterator<Item = f64> + '_ {
        self.model.parameters().iter().map(|parameter| match parameter.shape() {
            ErrorShape::Gain => REQUIRED_GAIN_U,
            _ if parameter.component().is_linear() => REQUIRED_OFFSET_U_MM,
            _ => REQUIRED_ANGLE_U_RAD,
        })
    }
}

/// Whether the spindle turns with the design.
///
/// # Errors
/// `spindle = "orient"` is set, but the machine declares no axis S.
fn spindle_turns(machine: &Machine, settings: &SambaSettings) -> Result<bool, MethodRefusal> {
    let is_declared = machine.axes.contains_key(&Axis::S);
    MethodRefusal::require(
        is_declared || settings.spindle != SpindleOrientMode::Orient,
        "the spindle cannot be oriented: the machine file declares no axis S",
        "describe [axes.S], or choose spindle = \"fixed\": then the offset of the spindle (EX0S, EY0S) is \
        reported together with that of the stylus",
    )?;
    Ok(is_declared && settings.spindle != SpindleOrientMode::Fixed)
}

/// Refuses selected errors of axes that do not move: all errors of an axis that tilts the spindle, and offsets of any
/// other axis. Angular errors of other axes are accepted.
fn check_errors_of_fixed_axes(model: &GeometryModel) -> Result<(), MethodRefusal> {
    let is_refused = |error: &&ErrorParameter| {
        model.measuring_conditions().fixed_axes.contains(&error.axis())
            && (tilts_spindle(model.chain(), error.axis()) || error.component().is_linear())
    };
    let Some(error) = model.parameters().iter().find(is_refused) else { return Ok(()) };
    let axis = error.axis();
    if tilts_spindle(model.chain(), axis) {
        return Err(MethodRefusal {
            reason: format!(
                "{error} was requested, but the spindle must be upright: balls are touched from \
                 above only; {axis} other than 0 is not supported, and at 0 the errors of {axis} \
                 are inseparable from the stylus"
            ),
            remedy: format!(
                "remove the errors of {axis} from parameters: the estimate lists the errors that \
                 it does not include"
            ),
        });
    }
    let coordinate = error.component().letter().to_lowercase();
    Err(MethodRefusal {
        reason: format!(
            "{error} was requested, but the spindle is not oriented: {error} and the stylus offset \
             t_{coordinate} are inseparable, only {error} + t_{coordinate} is measured"
        ),
        remedy: format!(
            "declare [axes.S] and choose spindle = \"orient\", or remove {error} from parameters: \
             then {error} is part of t_{coordinate}"
        ),
    })
}
