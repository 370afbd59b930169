//! Self-calibration of a rotary axis by Tests 1a, 1b, (1c,) 2 and 3 (paper 1: Zimmermann and Ibaraki 2020;
//! corrected and extended as in METHODS section 1). It determines axis position, error motion, radial error of X
//! and Y, and the flank of an uncalibrated round part at the same time.

mod axis_circle;
mod axis_position;
mod design;
mod estimate;
mod fit;
mod forecast;
mod identify;
mod interruptions;
mod model;
mod observe;
mod outputs;
mod paper_system;
mod plan;
mod radial_check;
mod second_order;
mod sense;
mod settings;
mod solved_cycle;
mod sources;
mod table_axis;

#[cfg(test)]
mod tests;

pub use fit::{Fit, LinearisedFit};
pub use identify::FittedCycle;
pub use second_order::SecondOrderCorrection;
pub use settings::SelfCalibrationSettings;

use std::cmp::Ordering;

use self::observe::ObservedAxis;
use self::plan::{PartGeometry, StepPlanner};
use self::table_axis::TableAxis;
use super::identification::KnownMotions;
use super::{IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, PositionSource, RegisteredMethod};
use estimation::circle;
use machine::record::artefact::{Artefact, Cylinder};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::Reading;

pub const NAME: &str = "self-calibration";
const UNCHECKED_TOUCHES_STAGE_NAME: &str = "touches without redundancy, repeated";

pub struct SelfCalibration {
    settings: SelfCalibrationSettings,
}

impl SelfCalibration {
    fn new_stage(&self, plan: &Plan, name: String, repeat: u32, steps: Vec<u32>) -> Stage {
        let id = plan.steps.last().map_or(0, |step| step.stage + 1);
        Stage { id: if repeat == 0 { id } else { id + repeat - 1 }, name, repeat, steps, found: None }
    }

    /// The fit without the estimate, for the benchmark of the trials.
    ///
    /// # Errors
    /// The errors of `identify`.
    pub fn fit_cycle(&self, plan: &Plan, readings: &[Reading]) -> Result<FittedCycle, IdentifyError> {
        let planner = StepPlanner::new(plan, &self.settings)?;
        let (heights, known_motions) = (planner.heights(), KnownMotions::default());
        let axis = ObservedAxis { axis: planner.axis(), heights: &heights, known_motions: &known_motions };
        identify::fit_cycle(plan, &self.settings, &axis, readings)
    }

    fn cycle_stage(
        &self,
        plan: &Plan,
        planner: &StepPlanner<'_>,
        part: PartGeometry,
    ) -> Result<NextStage, MethodRefusal> {
        let new_steps = planner.cycle_steps(part)?;
        let ids = new_steps.iter().map(|step| step.id).collect();
        let mut stage = self.new_stage(plan, "Tests 1a to 3".to_owned(), 0, ids);
        stage.found = self.settings.locate.then(|| self.measured_artefact(plan, planner, part));
        Ok(NextStage::Stage { stage, new_steps })
    }

    /// Steps of touches that no other touch checks. They are repeated.
    fn unchecked_steps(&self, plan: &Plan, planner: &StepPlanner<'_>) -> Result<Vec<u32>, MethodRefusal> {
        let known_motions = KnownMotions::new(planner.axis().axis, &plan.priors)?;
        forecast::unchecked_steps(plan, &self.settings, planner, &known_motions)
            .map_err(|error| MethodRefusal::new(error.to_string(), error.remedy()))
    }

    /// The artefact at its measured position. When the table turns, the artefact may be displaced by twice the
    /// offset of the rotary axis, which is the quantity to be measured. The touches allow for a displacement of
    /// their standoff, and half of that is the position uncertainty.
    fn measured_artefact(&self, plan: &Plan, planner: &StepPlanner<'_>, part: PartGeometry) -> Artefact {
        let stated = planner.stated_part();
        let ball = plan.probe.ball_radius_mm;
        Artefact::Cylinder(planner.axis().part_in_table_frame(&Cylinder {
            centre_mm: [part.centre[0], part.centre[1], stated.centre_mm[2]],
            axis: stated.axis,
            radius_mm: part.contact_radius_mm - ball,
            height_mm: part.top_contact_z_mm - ball - stated.centre_mm[2],
            uncertainty_mm: self.settings.standoff_mm.min(self.settings.search_mm) / 2.0,
        }))
    }
}

impl RegisteredMethod for SelfCalibration {
    type Settings = SelfCalibrationSettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: NAME,
        required_setup: "any clean round part",
        results: "location and error motions of the rotary axis that turns the part (C, or another letter), \
                squareness and scale difference of X and Y, form of the part",
        machine_file: "simulated.toml",
    };

    fn new(settings: SelfCalibrationSettings) -> Self {
        Self { settings }
    }
}

impl Method for SelfCalibration {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next_stage(&self, plan: &Plan, done: &[Stage], source: PositionSource<'_>) -> Result<NextStage, MethodRefusal> {
        let planner = StepPlanner::new(plan, &self.settings)?;
        let located = usize::from(self.settings.locate);
        if self.settings.locate && done.is_empty() {
            // All refusals come before the first move.
            identify::check_well_posed(plan, &self.settings, &planner)?;
            let new_steps = planner.locating_steps()?;
            let ids = new_steps.iter().map(|step| step.id).collect();
            let stage = self.new_stage(plan, "locate the part".to_owned(), 0, ids);
            return Ok(NextStage::Stage { stage, new_steps });
        }
        if done.is_empty() {
            identify::check_well_posed(plan, &self.settings, &planner)?;
        }
        let pass = (done.len() - located) as u32;
        if let Some(first) = done.get(located) {
            let (name, steps) = match pass.cmp(&self.settings.repeats) {
                Ordering::Less => (format!("Tests 1a to 3, pass {}", pass + 1), first.steps.clone()),
                Ordering::Equal => (UNCHECKED_TOUCHES_STAGE_NAME.to_owned(), self.unchecked_steps(plan, &planner)?),
                Ordering::Greater => return Ok(NextStage::Done),
            };
            if steps.is_empty() {
                return Ok(NextStage::Done);
            }
            let mut stage = self.new_stage(plan, name, pass, steps);
            stage.found = first.found.clone();
            return Ok(NextStage::Stage { stage, new_steps: Vec::new() });
        }
        let part = match source {
            PositionSource::Measured(readings) if self.settings.locate => locate_part(plan, &planner, readings)?,
            _ => planner.nominal_part(),
        };
        self.cycle_stage(plan, &planner, part)
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, MethodRefusal> {
        let planner = StepPlanner::new(plan, &self.settings)?;
        let known_motions = KnownMotions::new(planner.axis().axis, &plan.priors)?;
        let lines = forecast::forecast_results(plan, &self.settings, &planner, &known_motions, machine_s);
        lines.map_err(|error| MethodRefusal::new(error.to_string(), error.remedy()))
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), MethodRefusal> {
        let axis = TableAxis::new(plan, &self.settings)?;
        KnownMotions::new(axis.axis, &plan.priors).map(drop)
    }

    fn accepts_probe_map(&self) -> bool {
        true
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let planner = StepPlanner::new(plan, &self.settings)?;
        let known_motions = KnownMotions::new(planner.axis().axis, &plan.priors)?;
        identify::identify(plan, &self.settings, &planner, &known_motions, readings)
    }
}

/// Centre of the part and radius of the ball centres, from the locating touches.
fn locate_part(plan: &Plan, planner: &StepPlanner<'_>, readings: &[Reading]) -> Result<PartGeometry, MethodRefusal> {
    let nominal = planner.nominal_part();
    let refused = |reason: String| MethodRefusal {
        reason,
        remedy: "check that the part of [artefact] is on the table, then start a new run".to_owned(),
    };
    let is_locating = |step: &&Step| step.label.starts_with(plan::LOCATE_LABEL_PREFIX);
    let (tops, flank): (Vec<_>, Vec<_>) = plan
        .steps
        .iter()
        .filter(is_locating)
        .filter_map(|step| readings.iter().find(|r| r.step == step.id).map(|r| (step, r)))
        .map(|(step, reading)| (step, planner.axis().ball_centre(step, reading)))
        .partition(|(step, _)| plan::is_top_touch(step));
    let centres: Vec<[f64; 2]> = flank.iter().map(|(_, centre)| [centre.x, centre.y]).collect();
    let found =
        circle::fit_circle(&centres).map_err(|error| refused(format!("the part could not be located: {error}")))?;
    let uncertainty_mm = planner.stated_part().uncertainty_mm;
    let top = tops.first().map_or(nominal.top_contact_z_mm, |(_, centre)| centre.z);
    let part = PartGeometry { centre: found.centre, contact_radius_mm: found.radius, top_contact_z_mm: top };
    let away = (part.centre[0] - nominal.centre[0]).hypot(part.centre[1] - nominal.centre[1]);
    let (larger, higher) =
        (part.contact_radius_mm - nominal.contact_radius_mm, part.top_contact_z_mm - nominal.top_contact_z_mm);
    if away > uncertainty_mm || larger.abs() > uncertainty_mm || higher.abs() > uncertainty_mm {
        return Err(refused(format!(
            "the located part deviates from [artefact] by {away:.3} mm in position, {larger:.3} mm in \
            radius and {higher:.3} mm in height, more than uncertainty_mm = {uncertainty_mm}"
        )));
    }
    Ok(part)
}
