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
mod measured_table_axis;
mod model;
mod observe;
mod outputs;
mod paper_system;
mod plan;
mod radial_error_check;
mod rotation_sense;
mod second_order_correction;
mod settings;
mod setup;
mod sources;
mod symbol_names;

#[cfg(test)]
mod tests;

pub use fit::{FitWithSensitivity, SelfCalibrationFit};
pub use identify::FittedRun;
pub use second_order_correction::SecondOrderCorrection;
pub use settings::SelfCalibrationSettings;

use std::cmp::Ordering;

use self::measured_table_axis::MeasuredTableAxis;
use self::setup::{PartGeometry, SelfCalibrationSetup};
use super::identification::KnownErrorMotions;
use super::{
    IdentifyError, Method, MethodDescription, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod,
};
use estimation::circle;
use machine::record::artefact::{Artefact, Cylinder};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::Reading;

pub const METHOD_NAME: &str = "self-calibration";
const UNCHECKED_TOUCHES_STAGE_NAME: &str = "touches without redundancy, repeated";

pub struct SelfCalibration {
    settings: SelfCalibrationSettings,
}

impl SelfCalibration {
    /// The fit of all readings of the run, without the estimate and without the known error motions of the priors, for
    /// the benchmark of the trials.
    ///
    /// # Errors
    /// The errors of `identify`.
    pub fn fit_without_estimate(&self, plan: &Plan, readings: &[Reading]) -> Result<FittedRun, IdentifyError> {
        identify::fit_readings(&SelfCalibrationSetup::new(plan, &self.settings)?, readings)
    }

    /// The artefact at its measured position. When the table turns, the artefact may be displaced by twice the
    /// offset of the rotary axis, which is the quantity to be measured. The touches tolerate a displacement of the
    /// smaller of standoff_mm and search_mm. Half of this value is stated as the position uncertainty.
    fn measured_artefact(&self, setup: &SelfCalibrationSetup<'_>, part: PartGeometry) -> Artefact {
        let stated = &setup.stated_part;
        let ball = setup.plan.probe.ball_radius_mm;
        Artefact::Cylinder(setup.axis.part_in_table_frame(&Cylinder {
            foot_mm: [part.centre_mm[0], part.centre_mm[1], stated.foot_mm[2]],
            axis: stated.axis,
            radius_mm: part.contact_radius_mm - ball,
            height_mm: part.ball_centre_z_at_top_mm - ball - stated.foot_mm[2],
            uncertainty_mm: self.settings.standoff_mm.min(self.settings.search_mm) / 2.0,
        }))
    }
}

impl RegisteredMethod for SelfCalibration {
    type Settings = SelfCalibrationSettings;
    const DESCRIPTION: MethodDescription = MethodDescription {
        name: METHOD_NAME,
        required_setup: "any clean round part",
        results: "location and error motions of the rotary axis that turns the part (C, or another letter), \
                squareness and scale difference of X and Y, form of the part",
        default_machine_file: "simulated.toml",
        source: "N. Zimmermann, S. Ibaraki: Self-calibration of rotary axis and linear axes error motions by an \
                automated on-machine probing test cycle. Int. J. Adv. Manuf. Technol. 107 (2020) 2107–2120",
        symbol_names: symbol_names::SYMBOL_NAMES,
        has_cycle_passes: true,
    };

    fn new(settings: SelfCalibrationSettings) -> Self {
        Self { settings }
    }
}

impl Method for SelfCalibration {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        let setup = SelfCalibrationSetup::new(plan, &self.settings)?;
        if done.is_empty() {
            // All refusals come before the first move.
            identify::check_well_posed(&setup)?;
            if self.settings.locate {
                return Ok(NextStage::from_new_steps(plan, done, "locate the part", setup.locating_steps()?));
            }
        }
        let located = usize::from(self.settings.locate);
        let Some(first) = done.get(located) else {
            let part = match source {
                ObjectPositionSource::Measured(readings) if self.settings.locate => locate_part(&setup, readings)?,
                _ => setup.nominal_part(),
            };
            let mut next = NextStage::from_new_steps(plan, done, "Tests 1a to 3", setup.steps_after_locating(part)?);
            if let NextStage::Stage { stage, .. } = &mut next {
                stage.found = self.settings.locate.then(|| self.measured_artefact(&setup, part));
            }
            return Ok(next);
        };
        let pass = (done.len() - located) as u32;
        let (name, steps) = match pass.cmp(&self.settings.repeats) {
            Ordering::Less => (format!("Tests 1a to 3, pass {}", pass + 1), first.steps.clone()),
            Ordering::Equal => {
                let steps = forecast::unchecked_step_ids(&setup.with_known_motions()?).map_err(refusal_from_error)?;
                (UNCHECKED_TOUCHES_STAGE_NAME.to_owned(), steps)
            }
            Ordering::Greater => return Ok(NextStage::NoFurtherStage),
        };
        if steps.is_empty() {
            return Ok(NextStage::NoFurtherStage);
        }
        let id = done.last().map_or(0, |stage| stage.id + 1);
        let stage = Stage { id, name, repeat: pass, steps, found: first.found.clone() };
        Ok(NextStage::Stage { stage, new_steps: Vec::new() })
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, MethodRefusal> {
        let setup = SelfCalibrationSetup::new(plan, &self.settings)?.with_known_motions()?;
        forecast::forecast_results(&setup, machine_s).map_err(refusal_from_error)
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), MethodRefusal> {
        let axis = MeasuredTableAxis::new(plan, &self.settings)?;
        KnownErrorMotions::new(axis.axis, &plan.priors).map(drop)
    }

    fn accepts_probe_map(&self) -> bool {
        true
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let setup = SelfCalibrationSetup::new(plan, &self.settings)?.with_known_motions()?;
        Ok(estimate::build_estimate(&identify::solve_readings(&setup, readings, true)?))
    }
}

fn refusal_from_error(error: IdentifyError) -> MethodRefusal {
    MethodRefusal::new(error.to_string(), error.remedy())
}

/// Centre of the part and radius of the ball centres, from the locating touches. Error: no circle fits, or the part
/// deviates from the stated one by more than `uncertainty_mm` in position, radius or height.
fn locate_part(setup: &SelfCalibrationSetup<'_>, readings: &[Reading]) -> Result<PartGeometry, MethodRefusal> {
    let nominal = setup.nominal_part();
    let remedy = "check that the part of [artefact] is on the table, then start a new run";
    let steps = setup.plan.steps.iter().filter(|step| step.label.starts_with(plan::LOCATE_LABEL_PREFIX));
    let (tops, flank): (Vec<_>, Vec<_>) = steps
        .filter_map(|step| readings.iter().find(|r| r.step == step.id).map(|r| (step, r)))
        .map(|(step, reading)| (step, setup.axis.ball_centre(step, reading)))
        .partition(|(step, _)| plan::is_top_touch(step));
    let centres: Vec<[f64; 2]> = flank.iter().map(|(_, centre)| [centre.x, centre.y]).collect();
    let found = circle::fit_circle(&centres)
        .map_err(|error| MethodRefusal::new(format!("the part could not be located: {error}"), remedy))?;
    let uncertainty_mm = setup.stated_part.uncertainty_mm;
    let top = tops.first().map_or(nominal.ball_centre_z_at_top_mm, |(_, centre)| centre.z);
    let part = PartGeometry { centre_mm: found.centre, contact_radius_mm: found.radius, ball_centre_z_at_top_mm: top };
    let away = (part.centre_mm[0] - nominal.centre_mm[0]).hypot(part.centre_mm[1] - nominal.centre_mm[1]);
    let (larger, higher) = (
        part.contact_radius_mm - nominal.contact_radius_mm,
        part.ball_centre_z_at_top_mm - nominal.ball_centre_z_at_top_mm,
    );
    let is_outside = away > uncertainty_mm || larger.abs() > uncertainty_mm || higher.abs() > uncertainty_mm;
    MethodRefusal::require(
        !is_outside,
        format!(
            "the located part deviates from [artefact] by {away:.3} mm in position, {larger:.3} mm in \
            radius and {higher:.3} mm in height, more than uncertainty_mm = {uncertainty_mm}"
        ),
        remedy,
    )?;
    Ok(part)
}
