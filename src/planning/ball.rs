//! Steps of a ball measurement, reusable by every method: four touches around the ball and one at its pole, seen
//! along the spindle (paper 4, section 3), or more for a check of form.

use super::access::{BallAccessError, TouchAccess, TouchDirection, TouchExtent};
use machine::record::artefact::Ball;
use machine::record::machine::Probe;
use machine::record::plan::{Step, StepKind};
use machine::{Axis, Position};

/// Distance by which a search touch goes beyond the ball's position uncertainty, mm, so that contact always occurs.
const SEARCH_OVERRUN_MM: f64 = 0.3;

/// Search or measurement of a ball, with the lengths of its touches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BallTouchMode {
    /// At the search feed, over a length that finds the ball anywhere within `uncertainty_mm` of its expected position.
    Search { uncertainty_mm: f64, standoff_mm: f64 },
    /// At the measuring feed, along the normals of the ball at its found position: from `standoff_mm` before the
    /// expected contact to `search_mm` beyond it.
    Measure { standoff_mm: f64, search_mm: f64 },
}

/// A measurement of one ball to be planned.
#[derive(Debug, Clone, Copy)]
pub struct BallMeasurementRequest<'a> {
    /// The ball with its expected centre, table frame.
    pub ball: &'a Ball,
    /// Positions of all rotary axes, and of S if the spindle must be oriented.
    pub rotary: &'a Position,
    pub touch_mode: BallTouchMode,
    /// Number of touches: 5, or more for a check of form; fewer if some are not free, but at least 4.
    pub touch_count: usize,
}

impl BallTouchMode {
    fn touch_extent(self) -> TouchExtent {
        match self {
            Self::Search { uncertainty_mm, standoff_mm } => TouchExtent {
                before_mm: uncertainty_mm + standoff_mm,
                beyond_mm: uncertainty_mm + SEARCH_OVERRUN_MM,
                max_ball_misplacement_mm: uncertainty_mm,
            },
            Self::Measure { standoff_mm, search_mm } => {
                TouchExtent { before_mm: standoff_mm, beyond_mm: search_mm, max_ball_misplacement_mm: search_mm }
            }
        }
    }

    fn feed_mm_min(self, probe: &Probe) -> f64 {
        match self {
            Self::Search { .. } => probe.search_feed_mm_min,
            Self::Measure { .. } => probe.feed_mm_min,
        }
    }
}

impl TouchAccess {
    /// Checks whether this ball can be measured. Returns the touches that would be made.
    ///
    /// # Errors
    /// The reason: an obstacle to a touch, an axis out of travel, a tilted spindle.
    pub fn accessible_touches(
        &self,
        request: &BallMeasurementRequest<'_>,
    ) -> Result<Vec<TouchDirection>, BallAccessError> {
        self.select_touches(request.ball, request.rotary, request.touch_mode.touch_extent(), request.touch_count)
    }

    /// Steps of one measurement, numbered from `first`, machine frame. `label` makes the label of a step from the
    /// name of the touch.
    ///
    /// # Errors
    /// The errors of [`TouchAccess::accessible_touches`]; or a touch is longer than the probe's overtravel.
    pub fn touch_steps(
        &self,
        request: &BallMeasurementRequest<'_>,
        probe: &Probe,
        kind: StepKind,
        (first, stage): (u32, u32),
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, BallAccessError> {
        let contacts = self.accessible_touches(request)?;
        self.build_one_step_per_contact(request, contacts, probe, kind, (first, stage), label)
    }

    /// Like [`TouchAccess::touch_steps`], but along `directions`: azimuth and elevation, degrees, in the spindle frame
    /// without the rotation of S. Numbers and stage are 0.
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
        let BallMeasurementRequest { ball, rotary, touch_mode: mode, .. } = *request;
        let contacts = self.touches_along_directions(ball, rotary, mode.touch_extent(), directions)?;
        self.build_one_step_per_contact(request, contacts, probe, StepKind::Touch, (0, 0), label)
    }

    fn build_one_step_per_contact(
        &self,
        request: &BallMeasurementRequest<'_>,
        contacts: Vec<TouchDirection>,
        probe: &Probe,
        kind: StepKind,
        (first, stage): (u32, u32),
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, BallAccessError> {
        let TouchExtent { before_mm, beyond_mm, .. } = request.touch_mode.touch_extent();
        let (length, overtravel) = (before_mm + beyond_mm, probe.overtravel_mm);
        if length > overtravel {
            return Err(BallAccessError::SearchTooLong { length, overtravel });
        }
        let contact_mm = self.contact_distance_mm(request.ball);
        let numbered = (first..).zip(contacts);
        numbered
            .map(|(id, contact)| {
                let place = |distance_mm: f64| {
                    self.position_beside_ball(request.ball, request.rotary, contact.normal, contact_mm + distance_mm)
                };
                let (from, to) = (place(before_mm)?, place(-beyond_mm)?);
                Ok(Step {
                    id,
                    stage,
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

    /// Axis positions with the stylus-ball centre on the ball's centre: the result of a measurement.
    ///
    /// # Errors
    /// The linear axes of the machine do not span space.
    pub fn axis_positions_at_ball_centre(&self, ball: &Ball, rotary: &Position) -> Result<Position, BallAccessError> {
        let centre = self.position_beside_ball(ball, rotary, nalgebra::Vector3::z(), 0.0)?;
        Ok(centre.filter_axes(Axis::is_linear))
    }
}
