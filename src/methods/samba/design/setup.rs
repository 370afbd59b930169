//! Machine, artefact and settings for the design: the possible measurements, and the information that each
//! would give.

use nalgebra::Vector3;

use super::information::{CandidateMeasurement, InformationMatrix, LengthBar};
use crate::MethodRefusal;
use crate::ball_measurement::{MeasurementSetup, describe_position, require_balls, tilts_spindle};
use crate::samba::confounding::{MeasuringConditions, length_directions};
use crate::samba::model::{GeometryModel, length_u_mm};
use crate::samba::parameters;
use crate::samba::settings::{self, SambaSettings};
use machine::frame::unit_vector;
use machine::kinematics::{ErrorParameter, ErrorShape, KinematicChain};
use machine::record::artefact::{Ball, Balls, CertifiedLength};
use machine::record::machine::Machine;
use machine::record::plan::Plan;
use machine::{Axis, Position, frame::Point, frame::SpindleFrame};

/// Required uncertainties of the machine's parameters at a noise of 1 µm (METHODS section 4, G4), in mm, rad,
/// mm/mm. They are the units in which the criteria compare the parameters.
const OFFSET_UNIT_MM: f64 = 0.8e-3;
const ANGLE_UNIT_RAD: f64 = 2e-6;
const GAIN_UNIT: f64 = 2.5e-6;
/// Standard uncertainty of a coordinate of a ball centre if none is declared, mm.
const DEFAULT_U_MM: f64 = 1e-3;

pub struct DesignSetup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a SambaSettings,
    pub balls: &'a Balls,
    pub model: GeometryModel,
    pub tip: Point<SpindleFrame>,
    /// Whether the spindle turns with the design.
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
        let fixed_axes = parameters::fixed_axes(plan, settings, &chain);
        let length_directions = length_directions(set);
        let conditions =
            MeasuringConditions { chain: &chain, fixed_axes: &fixed_axes, length_directions: &length_directions };
        let selected = parameters::select_parameters(&settings.parameters, conditions)?;
        check_fixed_axes(&selected, conditions)?;
        let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
        let model = GeometryModel::from_parts(chain, selected, fixed_axes, length_directions);
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
        let linear = linear.map_err(|error| MethodRefusal {
            reason: format!("ball {} at {}: {error}", ball.id, describe_position(at)),
            remedy: "correct the directions in [axes]".to_owned(),
        })?;
        Ok(at.updated_by(&linear.filter_axes(Axis::is_linear)))
    }

    pub fn candidate_measurement(
        &self,
        indexation: usize,
        at: &Position,
        index: usize,
        ball: &Ball,
    ) -> Result<CandidateMeasurement, MethodRefusal> {
        let zero = vec![0.0; self.model.parameters().len()];
        let centre = Vector3::from(ball.centre_mm);
        let rows = self.model.rows(&self.position_at_ball(at, ball)?, &zero, self.tip.mm, centre);
        let machine = rows
            .error_derivatives
            .iter()
            .zip(self.parameter_units())
            .map(|(column, unit)| *column * unit / self.centre_u_mm());
        let tool = self
            .model
            .free_stylus_coordinates()
            .iter()
            .map(|k| rows.stylus_derivatives.column(*k) * OFFSET_UNIT_MM / self.centre_u_mm());
        Ok(CandidateMeasurement { indexation, ball: index, derivatives: machine.chain(tool).collect() })
    }

    /// Information from the certified lengths alone.
    pub fn length_information(&self) -> InformationMatrix {
        let machine = self.model.parameters().len();
        let bars: Vec<LengthBar> = self.balls.lengths.iter().filter_map(|l| self.length_bar(l)).collect();
        let unit = OFFSET_UNIT_MM / self.centre_u_mm();
        InformationMatrix::new(machine, self.shared_unknown_count(), self.balls.balls.len(), &bars, unit)
    }

    /// Number of unknowns that all measurements share: machine errors and stylus.
    pub fn shared_unknown_count(&self) -> usize {
        self.model.parameters().len() + self.model.free_stylus_coordinates().len()
    }

    /// The balls that a length joins, and its direction.
    pub fn length_ends(&self, length: &CertifiedLength) -> Option<([usize; 2], Vector3<f64>)> {
        let find = |id: &String| self.balls.balls.iter().position(|ball| ball.id == *id);
        let ends = [find(&length.from)?, find(&length.to)?];
        let [from, to] = ends.map(|end| self.balls.balls.get(end));
        let direction = Vector3::from(to?.centre_mm) - Vector3::from(from?.centre_mm);
        Some((ends, unit_vector(direction)?))
    }

    fn length_bar(&self, length: &CertifiedLength) -> Option<LengthBar> {
        let (balls, direction) = self.length_ends(length)?;
        Some(LengthBar { ball_indices: balls, direction, weight: OFFSET_UNIT_MM / length_u_mm(length) })
    }

    /// Standard uncertainty of a coordinate of a ball centre, mm.
    pub fn centre_u_mm(&self) -> f64 {
        self.plan.probe.repeatability_um.map_or(DEFAULT_U_MM, |um| um.max(0.01) * 1e-3)
    }

    /// Units of the machine's parameters.
    fn parameter_units(&self) -> impl Iterator<Item = f64> + '_ {
        self.model.parameters().iter().map(|parameter| match parameter.shape() {
            ErrorShape::Gain => GAIN_UNIT,
            _ if parameter.component().is_linear() => OFFSET_UNIT_MM,
            _ => ANGLE_UNIT_RAD,
        })
    }
}

/// Whether the spindle turns with the design.
///
/// # Errors
/// `spindle = "orient"` is set, but the machine declares no axis S.
fn spindle_turns(machine: &Machine, settings: &SambaSettings) -> Result<bool, MethodRefusal> {
    let is_declared = machine.axes.contains_key(&Axis::S);
    if settings.spindle == settings::Spindle::Orient && !is_declared {
        return Err(MethodRefusal {
            reason: "the spindle cannot be oriented: the machine file declares no axis S".to_owned(),
            remedy: "describe [axes.S], or choose spindle = \"fixed\": then the offset of the spindle \
                 (EX0S, EY0S) is reported together with that of the stylus"
                .to_owned(),
        });
    }
    Ok(is_declared && settings.spindle != settings::Spindle::Fixed)
}

/// Refuses selected errors of an axis that does not move, because they have no effect.
fn check_fixed_axes(selected: &[ErrorParameter], conditions: MeasuringConditions<'_>) -> Result<(), MethodRefusal> {
    let is_fixed = |error: &&ErrorParameter| conditions.fixed_axes.contains(&error.axis());
    let Some(error) = selected.iter().find(is_fixed) else { return Ok(()) };
    let axis = error.axis();
    if tilts_spindle(conditions.chain, axis) {
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
    if !error.component().is_linear() {
        return Ok(());
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
