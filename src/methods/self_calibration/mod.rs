//! Self-calibration of a rotary axis by Tests 1a, 1b, (1c,) 2 and 3 (paper 1: Zimmermann and Ibaraki 2020;
//! corrected and extended as in METHODS section 1). It determines axis position, error motion, radial error of X
//! and Y, and the flank of an uncalibrated round part at the same time.

mod axis_circle;
mod axis_position;
mod bend;
mod design;
mod estimate;
mod fit;
mod forecast;
mod gaps;
mod identify;
mod model;
mod observe;
mod outputs;
mod paper;
mod parts;
mod plan;
mod radial_check;
mod sense;
mod settings;
mod sources;
mod table_axis;

#[cfg(test)]
mod tests;

pub use bend::SecondOrderCorrection;
pub use fit::{Fit, LinearisedFit};
pub use identify::Fitted;
pub use settings::Settings;

use std::cmp::Ordering;

use self::observe::ObservedAxis;
use self::plan::{Part, Planner};
use self::table_axis::TableAxis;
use super::identification::KnownMotions;
use super::{Description, IdentifyError, Method, Next, Refused, Registered, Source};
use estimation::circle;
use machine::record::artefact::{Artefact, Cylinder};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::Reading;

pub const NAME: &str = "self-calibration";
const UNCHECKED_TOUCHES_STAGE: &str = "touches that no other checks, once more";

pub struct SelfCalibration {
    settings: Settings,
}

impl SelfCalibration {
    fn stage(&self, plan: &Plan, name: String, repeat: u32, steps: Vec<u32>) -> Stage {
        let id = plan.steps.last().map_or(0, |step| step.stage + 1);
        Stage {
            id: if repeat == 0 { id } else { id + repeat - 1 },
            name,
            repeat,
            steps,
            found: None,
        }
    }

    /// The fit without the estimate, for the benchmark of the trials.
    ///
    /// # Errors
    /// The errors of `identify`.
    pub fn fitted(&self, plan: &Plan, readings: &[Reading]) -> Result<Fitted, IdentifyError> {
        let planner = Planner::new(plan, &self.settings)?;
        let (heights, known) = (planner.heights(), KnownMotions::default());
        let axis = ObservedAxis { axis: planner.axis(), heights: &heights, known: &known };
        identify::fitted(plan, &self.settings, &axis, readings)
    }

    fn cycle(&self, plan: &Plan, planner: &Planner<'_>, part: Part) -> Result<Next, Refused> {
        let new_steps = planner.cycle_steps(part)?;
        let ids = new_steps.iter().map(|step| step.id).collect();
        let mut stage = self.stage(plan, "Tests 1a to 3".to_owned(), 0, ids);
        stage.found = self.settings.locate.then(|| self.found(plan, planner, part));
        Ok(Next::Stage { stage, new_steps })
    }

    /// Steps of touches that no other touch checks. They are repeated.
    fn unchecked(&self, plan: &Plan, planner: &Planner<'_>) -> Result<Vec<u32>, Refused> {
        let known = KnownMotions::new(planner.axis().axis, &plan.priors)?;
        forecast::unchecked(plan, &self.settings, planner, &known)
            .map_err(|error| Refused::new(error.to_string(), error.remedy()))
    }

    /// The artefact at its measured position. When the table turns, the artefact may be displaced by twice the
    /// offset of the rotary axis, which is the quantity to be measured. The touches allow for a displacement of
    /// their standoff, and half of that is the position uncertainty.
    fn found(&self, plan: &Plan, planner: &Planner<'_>, part: Part) -> Artefact {
        let stated = planner.stated();
        let ball = plan.probe.ball_radius_mm;
        Artefact::Cylinder(planner.axis().on_table(&Cylinder {
            centre_mm: [part.centre[0], part.centre[1], stated.centre_mm[2]],
            axis: stated.axis,
            radius_mm: part.reach - ball,
            height_mm: part.top - ball - stated.centre_mm[2],
            uncertainty_mm: self.settings.standoff_mm.min(self.settings.search_mm) / 2.0,
        }))
    }
}

impl Registered for SelfCalibration {
    type Settings = Settings;
    const DESCRIPTION: Description = Description {
        name: NAME,
        needs: "any clean round part",
        finds: "location and error motions of the rotary axis that turns the part (C, or another letter), \
                squareness and scale difference of X and Y, form of the part",
        machine_file: "simulated.toml",
    };

    fn new(settings: Settings) -> Self {
        Self { settings }
    }
}

impl Method for SelfCalibration {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        let planner = Planner::new(plan, &self.settings)?;
        let located = usize::from(self.settings.locate);
        if self.settings.locate && done.is_empty() {
            // All refusals come before the first move.
            identify::check_well_posed(plan, &self.settings, &planner)?;
            let new_steps = planner.locating_steps()?;
            let ids = new_steps.iter().map(|step| step.id).collect();
            let stage = self.stage(plan, "locate the part".to_owned(), 0, ids);
            return Ok(Next::Stage { stage, new_steps });
        }
        if done.is_empty() {
            identify::check_well_posed(plan, &self.settings, &planner)?;
        }
        let pass = (done.len() - located) as u32;
        if let Some(first) = done.get(located) {
            let (name, steps) = match pass.cmp(&self.settings.repeats) {
                Ordering::Less => {
                    (format!("Tests 1a to 3, pass {}", pass + 1), first.steps.clone())
                }
                Ordering::Equal => {
                    (UNCHECKED_TOUCHES_STAGE.to_owned(), self.unchecked(plan, &planner)?)
                }
                Ordering::Greater => return Ok(Next::Done),
            };
            if steps.is_empty() {
                return Ok(Next::Done);
            }
            let mut stage = self.stage(plan, name, pass, steps);
            stage.found = first.found.clone();
            return Ok(Next::Stage { stage, new_steps: Vec::new() });
        }
        let part = match source {
            Source::Measured(readings) if self.settings.locate => {
                located_part(plan, &planner, readings)?
            }
            _ => planner.nominal_part(),
        };
        self.cycle(plan, &planner, part)
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, Refused> {
        let planner = Planner::new(plan, &self.settings)?;
        let known = KnownMotions::new(planner.axis().axis, &plan.priors)?;
        let lines = forecast::forecast(plan, &self.settings, &planner, &known, machine_s);
        lines.map_err(|error| Refused::new(error.to_string(), error.remedy()))
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), Refused> {
        let axis = TableAxis::new(plan, &self.settings)?;
        KnownMotions::new(axis.axis, &plan.priors).map(drop)
    }

    fn takes_probe_map(&self) -> bool {
        true
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let planner = Planner::new(plan, &self.settings)?;
        let known = KnownMotions::new(planner.axis().axis, &plan.priors)?;
        identify::identify(plan, &self.settings, &planner, &known, readings)
    }
}

/// Centre of the part and radius of the ball centres, from the locating touches.
fn located_part(plan: &Plan, planner: &Planner<'_>, readings: &[Reading]) -> Result<Part, Refused> {
    let nominal = planner.nominal_part();
    let refused = |why: String| Refused {
        why,
        instead: "check that the part of [artefact] stands on the table, then start again"
            .to_owned(),
    };
    let is_locating = |step: &&Step| step.label.starts_with(plan::LOCATE_LABEL);
    let (tops, flank): (Vec<_>, Vec<_>) = plan
        .steps
        .iter()
        .filter(is_locating)
        .filter_map(|step| readings.iter().find(|r| r.step == step.id).map(|r| (step, r)))
        .map(|(step, reading)| (step, planner.axis().ball_centre(step, reading)))
        .partition(|(step, _)| plan::touches_top(step));
    let centres: Vec<[f64; 2]> = flank.iter().map(|(_, centre)| [centre.x, centre.y]).collect();
    let found = circle::fit_circle(&centres)
        .map_err(|error| refused(format!("the part could not be located: {error}")))?;
    let uncertainty_mm = planner.stated().uncertainty_mm;
    let top = tops.first().map_or(nominal.top, |(_, centre)| centre.z);
    let part = Part { centre: found.centre, reach: found.radius, top };
    let away = (part.centre[0] - nominal.centre[0]).hypot(part.centre[1] - nominal.centre[1]);
    let (larger, higher) = (part.reach - nominal.reach, part.top - nominal.top);
    if away > uncertainty_mm || larger.abs() > uncertainty_mm || higher.abs() > uncertainty_mm {
        return Err(refused(format!(
            "the part was found {away:.3} mm from its stated place, {larger:.3} mm larger in radius and \
             {higher:.3} mm higher, beyond uncertainty_mm = {uncertainty_mm}"
        )));
    }
    Ok(part)
}
