//! Machine, artefact and settings for the design: the possible measurements, and the information that each
//! would give.

use nalgebra::Vector3;

use super::information::{Bar, CandidateMeasurement, Information};
use crate::Refused;
use crate::ball_measurement::{MeasurementSetup, balls, describe_position, tilts_spindle};
use crate::samba::model::{Model, length_u_mm};
use crate::samba::parameters;
use crate::samba::separable::{Way, directions};
use crate::samba::settings::{self, Settings};
use machine::frame::unit_vector;
use machine::kinematics::{Chain, ErrorParameter, Shape};
use machine::record::artefact::{Ball, Balls, Length};
use machine::record::machine::Machine;
use machine::record::plan::Plan;
use machine::{Axis, Position, frame::Point, frame::Spindle};

/// Required uncertainties of the machine's parameters at a noise of 1 µm (METHODS section 4, G4), in mm, rad,
/// mm/mm. They are the units in which the criteria compare the parameters.
const OFFSET: f64 = 0.8e-3;
const ANGLE: f64 = 2e-6;
const GAIN: f64 = 2.5e-6;
/// Standard uncertainty of a coordinate of a ball centre if none is declared, mm.
const USUAL_U: f64 = 1e-3;

pub struct DesignSetup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a Settings,
    pub balls: &'a Balls,
    pub model: Model,
    pub tip: Point<Spindle>,
    /// Whether the spindle turns with the design.
    pub oriented: bool,
}

impl<'a> DesignSetup<'a> {
    /// # Errors
    /// Settings, artefact or machine do not allow a measurement; the text states the reason.
    pub fn new(plan: &'a Plan, settings: &'a Settings) -> Result<Self, Refused> {
        let set = balls(crate::samba::NAME, &plan.artefact)?;
        settings.check()?;
        let chain = Chain::new(&plan.machine)?;
        let oriented = oriented(&plan.machine, settings)?;
        let stands = parameters::standing(plan, settings, &chain);
        let lengths = directions(set);
        let way = Way { chain: &chain, stands: &stands, lengths: &lengths };
        let chosen = parameters::chosen(&settings.parameters, way)?;
        check_standing(&chosen, way)?;
        let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
        let model = Model::of(chain, chosen, stands, lengths);
        Ok(Self { plan, settings, balls: set, model, tip, oriented })
    }

    /// Measurement setup of the balls.
    pub fn measurement(&self) -> MeasurementSetup<'a> {
        let Self { plan, settings, balls, .. } = *self;
        MeasurementSetup { method: crate::samba::NAME, plan, balls, touch: settings.touch() }
    }

    /// Axis positions with the tip at the stated centre of the ball.
    pub fn on_ball(&self, at: &Position, ball: &Ball) -> Result<Position, Refused> {
        let centre = Point::from_vec(Vector3::from(ball.centre_mm));
        let linear = self.model.chain().linear_axes_for(centre, self.tip, at, &[]);
        let linear = linear.map_err(|error| Refused {
            why: format!("ball {} at {}: {error}", ball.id, describe_position(at)),
            instead: "correct the directions in [axes]".to_owned(),
        })?;
        Ok(at.updated_by(&linear.only(Axis::is_linear)))
    }

    pub fn sight(
        &self,
        (indexation, at): (usize, &Position),
        (ball, of): (usize, &Ball),
    ) -> Result<CandidateMeasurement, Refused> {
        let zero = vec![0.0; self.model.parameters().len()];
        let centre = Vector3::from(of.centre_mm);
        let rows = self.model.rows(&self.on_ball(at, of)?, &zero, self.tip.mm, centre);
        let machine = rows
            .machine
            .iter()
            .zip(self.units())
            .map(|(column, unit)| *column * unit / self.u_mm());
        let tool = self.model.stylus().iter().map(|k| rows.tool.column(*k) * OFFSET / self.u_mm());
        Ok(CandidateMeasurement { indexation, ball, columns: machine.chain(tool).collect() })
    }

    /// Information from the certified lengths alone.
    pub fn nothing(&self) -> Information {
        let machine = self.model.parameters().len();
        let bars: Vec<Bar> = self.balls.lengths.iter().filter_map(|l| self.bar(l)).collect();
        let unit = OFFSET / self.u_mm();
        Information::new(machine, self.shared(), self.balls.balls.len(), &bars, unit)
    }

    /// Number of unknowns that all measurements share: machine errors and stylus.
    pub fn shared(&self) -> usize {
        self.model.parameters().len() + self.model.stylus().len()
    }

    /// The balls that a length joins, and its direction.
    pub fn ends(&self, length: &Length) -> Option<([usize; 2], Vector3<f64>)> {
        let find = |id: &String| self.balls.balls.iter().position(|ball| ball.id == *id);
        let ends = [find(&length.from)?, find(&length.to)?];
        let [from, to] = ends.map(|end| self.balls.balls.get(end));
        let way = Vector3::from(to?.centre_mm) - Vector3::from(from?.centre_mm);
        Some((ends, unit_vector(way)?))
    }

    fn bar(&self, length: &Length) -> Option<Bar> {
        let (balls, direction) = self.ends(length)?;
        Some(Bar { balls, direction, weight: OFFSET / length_u_mm(length) })
    }

    /// Standard uncertainty of a coordinate of a ball centre, mm.
    pub fn u_mm(&self) -> f64 {
        self.plan.probe.repeatability_um.map_or(USUAL_U, |um| um.max(0.01) * 1e-3)
    }

    /// Units of the machine's parameters.
    fn units(&self) -> impl Iterator<Item = f64> + '_ {
        self.model.parameters().iter().map(|parameter| match parameter.shape() {
            Shape::Gain => GAIN,
            _ if parameter.component().is_linear() => OFFSET,
            _ => ANGLE,
        })
    }
}

/// Whether the spindle turns with the design.
///
/// # Errors
/// `spindle = "orient"` is set, but the machine declares no axis S.
fn oriented(machine: &Machine, settings: &Settings) -> Result<bool, Refused> {
    let is_declared = machine.axes.contains_key(&Axis::S);
    if settings.spindle == settings::Spindle::Orient && !is_declared {
        return Err(Refused {
            why: "the spindle cannot be oriented: the machine file declares no axis S".to_owned(),
            instead:
                "describe [axes.S], or choose spindle = \"fixed\": then the offset of the spindle \
                      (EX0S, EY0S) is told together with that of the stylus"
                    .to_owned(),
        });
    }
    Ok(is_declared && settings.spindle != settings::Spindle::Fixed)
}

/// Refuses selected errors of an axis that does not move, because they have no effect.
fn check_standing(chosen: &[ErrorParameter], way: Way<'_>) -> Result<(), Refused> {
    let standing = |error: &&ErrorParameter| way.stands.contains(&error.axis());
    let Some(error) = chosen.iter().find(standing) else { return Ok(()) };
    let axis = error.axis();
    if tilts_spindle(way.chain, axis) {
        return Err(Refused {
            why: format!(
                "{error} was asked for, but the spindle must stand upright: balls are touched from \
                 above only; {axis} other than 0 cannot be planned yet, and at 0 its errors are \
                 inseparable from the stylus"
            ),
            instead: format!(
                "take the errors of {axis} out of parameters: the estimate lists what it leaves out"
            ),
        });
    }
    if !error.component().is_linear() {
        return Ok(());
    }
    let coordinate = error.component().letter().to_lowercase();
    Err(Refused {
        why: format!(
            "{error} was asked for, but the spindle is not oriented: {error} and the stylus \
             offset t_{coordinate} are inseparable, only {error} + t_{coordinate} is seen"
        ),
        instead: format!(
            "declare [axes.S] and choose spindle = \"orient\", or take {error} out of parameters: \
             then it stands in t_{coordinate}"
        ),
    })
}
