//! Steps of a ball measurement, reusable by every method: four touches around the ball and one at its pole, seen
//! along the spindle (paper 4, section 3), or more for a check of form.

use super::access::{BallAccessError, BallMeasurementRequest, TouchAccess, TouchDirection, TouchExtent};
use machine::record::artefact::Ball;
use machine::record::machine::Probe;
use machine::record::plan::{Step, StepKind};
use machine::{Axis, Position};

impl TouchAccess {
    /// Steps of one measurement, numbered from 0, without stage, machine frame. `label` makes the label of a step from
    /// the name of the touch.
    ///
    /// # Errors
    /// The errors of [`TouchAccess::accessible_touches`]; or a touch is longer than the probe's overtravel.
    pub fn touch_steps(
        &self,
        request: &BallMeasurementRequest<'_>,
        probe: &Probe,
        kind: StepKind,
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, BallAccessError> {
        self.build_one_step_per_contact(request, self.accessible_touches(request)?, probe, kind, label)
    }

    /// Like [`TouchAccess::touch_steps`], but along `directions`: azimuth and elevation, degrees, in the spindle frame
    /// without the rotation of S.
    ///
    /// # Errors
    /// The first direction that is not free; a touch is longer than the probe's overtravel.
    pub fn touch_steps_along(
        &self,
        request: &BallMeasurementRequest<'_>,
        directions: &[[f64; 2]],
        probe: &Probe,
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, BallAccessError> {
        let contacts = self.touches_along_directions(request, directions)?;
        self.build_one_step_per_contact(request, contacts, probe, StepKind::Touch, label)
    }

    fn build_one_step_per_contact(
        &self,
        request: &BallMeasurementRequest<'_>,
        contacts: Vec<TouchDirection>,
        probe: &Probe,
        kind: StepKind,
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, BallAccessError> {
        let TouchExtent { before_mm, beyond_mm, .. } = request.touch_mode.touch_extent();
        let (length, overtravel) = (before_mm + beyond_mm, probe.overtravel_mm);
        if length > overtravel {
            return Err(BallAccessError::SearchTooLong { length, overtravel });
        }
        let contact_mm = self.contact_distance_mm(request.ball);
        (0..)
            .zip(contacts)
            .map(|(id, contact)| {
                let place = |distance_mm: f64| {
                    self.position_beside_ball(request.ball, request.rotary, contact.normal, contact_mm + distance_mm)
                };
                let (from, to) = (place(before_mm)?, place(-beyond_mm)?);
                Ok(Step {
                    id,
                    kind,
                    label: label(&contact.name),
                    from: from.rounded_to_file_resolution(),
                    to: to.rounded_to_file_resolution(),
                    feed_mm_min: request.touch_mode.feed_mm_min(probe),
                    sensors: vec!["probe".to_owned()],
                    normal: contact.normal.into(),
                    ..Step::default()
                })
            })
            .collect()
    }

    /// Positions of X, Y and Z alone with the stylus-ball centre on the ball's centre: the result of a measurement.
    ///
    /// # Errors
    /// The linear axes of the machine do not span space.
    pub fn axis_positions_at_ball_centre(&self, ball: &Ball, rotary: &Position) -> Result<Position, BallAccessError> {
        let centre = self.position_beside_ball(ball, rotary, nalgebra::Vector3::z(), 0.0)?;
        Ok(centre.filter_axes(Axis::is_linear))
    }
}
