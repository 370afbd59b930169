//! The measurement that a plan and the settings of the method describe.

use super::design::AngleGridDesign;
use super::measured_table_axis::MeasuredTableAxis;
use super::settings::{SelfCalibrationSettings, SpindleMode};
use crate::MethodRefusal;
use crate::identification::KnownErrorMotions;
use machine::Axis;
use machine::record::artefact::{Artefact, Cylinder};
use machine::record::plan::Plan;

/// Plan, settings, and what follows from them: the grid of the touches, the measured axis, the part.
pub struct SelfCalibrationSetup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a SelfCalibrationSettings,
    pub design: AngleGridDesign,
    pub axis: MeasuredTableAxis,
    /// The part of the plan at its position with the measured axis at zero, machine frame.
    pub stated_part: Cylinder,
    /// Heights of the touches in the machine frame, mm.
    pub heights_in_machine_mm: Vec<f64>,
    /// Error motions that are subtracted from the observations.
    pub known_motions: KnownErrorMotions<'a>,
}

/// Position and size of the part: centre with the axis at zero, radius of the ball centres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PartGeometry {
    /// X and Y of the part with the measured axis at zero, machine frame.
    pub centre_mm: [f64; 2],
    /// Radius of the part plus radius of the ball.
    pub contact_radius_mm: f64,
    /// Z of the centre of the stylus ball in contact with the top face, machine frame.
    pub ball_centre_z_at_top_mm: f64,
}

impl<'a> SelfCalibrationSetup<'a> {
    /// The setup without known error motions.
    ///
    /// # Errors
    /// The machine has no axis to measure, the artefact is not an upright cylinder, the settings would fail during the
    /// run, or the design is not well-posed.
    pub fn new(plan: &'a Plan, settings: &'a SelfCalibrationSettings) -> Result<Self, MethodRefusal> {
        let axis = MeasuredTableAxis::new(plan, settings)?;
        let stated_part = axis.part_in_machine_frame(artefact_cylinder(&plan.artefact)?);
        settings.check(&stated_part, plan.probe.ball_radius_mm)?;
        let design = AngleGridDesign::new(settings)?;
        MethodRefusal::require(
            settings.spindle == SpindleMode::Fixed || plan.machine.axes.contains_key(&Axis::S),
            "the spindle cannot be oriented: the machine has no axis S",
            "choose spindle = \"fixed\", or add [axes.S]",
        )?;
        let foot_z_mm = stated_part.foot_mm[2];
        let heights = match settings.heights_mm.as_slice() {
            [] => vec![foot_z_mm + stated_part.height_mm / 2.0],
            heights => heights.iter().map(|height| foot_z_mm + height).collect(),
        };
        Ok(Self {
            plan,
            settings,
            design,
            axis,
            stated_part,
            heights_in_machine_mm: heights,
            known_motions: KnownErrorMotions::default(),
        })
    }

    /// The setup with the error motions that the priors of the plan contain.
    ///
    /// # Errors
    /// The errors of [`KnownErrorMotions::new`].
    pub fn with_known_motions(mut self) -> Result<Self, MethodRefusal> {
        self.known_motions = KnownErrorMotions::new(self.axis.axis, &self.plan.priors)?;
        Ok(self)
    }

    /// The part as the plan states it.
    pub fn nominal_part(&self) -> PartGeometry {
        let Cylinder { foot_mm: centre_mm, radius_mm, height_mm, .. } = self.stated_part;
        let ball = self.plan.probe.ball_radius_mm;
        PartGeometry {
            centre_mm: [centre_mm[0], centre_mm[1]],
            contact_radius_mm: radius_mm + ball,
            ball_centre_z_at_top_mm: centre_mm[2] + height_mm + ball,
        }
    }
}

fn artefact_cylinder(artefact: &Artefact) -> Result<&Cylinder, MethodRefusal> {
    match artefact {
        Artefact::Cylinder(cylinder) => Ok(cylinder),
        Artefact::Balls(_) | Artefact::DatumCylinder(_) | Artefact::None => Err(MethodRefusal::new(
            "this method measures a cylinder, but [artefact] is of another kind",
            "describe the part with kind = \"cylinder\" in [artefact]",
        )),
    }
}
