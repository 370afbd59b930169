//! Steps of a ball measurement, reusable by every method: four touches round the ball and one at its pole, seen
//! along the spindle (paper 4, section 3), or more for a check of form.

use super::access::{Access, Contact, TouchExtent, Unreachable};
use machine::record::artefact::Ball;
use machine::record::machine::Probe;
use machine::record::plan::{Step, StepKind};
use machine::{Axis, Position};

/// Distance by which a search touch goes beyond the ball's position uncertainty, mm, so that contact always occurs.
const BEYOND: f64 = 0.3;

/// Approach to a ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Approach {
    /// Fast, from a distance at which the ball is found within `uncertainty_mm` of its expected position.
    Find { uncertainty_mm: f64, standoff_mm: f64 },
    /// Slow, along the normals of the ball at its found position: from `standoff_mm` before contact to `search_mm`
    /// beyond.
    Slow { standoff_mm: f64, search_mm: f64 },
}

/// One measurement of one ball.
#[derive(Debug, Clone, Copy)]
pub struct BallTask<'a> {
    /// The ball with its expected centre, table frame.
    pub ball: &'a Ball,
    /// Positions of all rotary axes, and of S if the spindle must be oriented.
    pub rotary: &'a Position,
    pub approach: Approach,
    /// Number of touches: 5, or more for a check of form; fewer if some are not free, but at least 4.
    pub touches: usize,
}

impl Approach {
    /// Distances before and beyond the expected contact, mm.
    fn ends(self) -> (f64, f64) {
        match self {
            Self::Find { uncertainty_mm, standoff_mm } => {
                (uncertainty_mm + standoff_mm, uncertainty_mm + BEYOND)
            }
            Self::Slow { standoff_mm, search_mm } => (standoff_mm, search_mm),
        }
    }

    fn stand(self) -> TouchExtent {
        let loose = match self {
            Self::Find { uncertainty_mm, .. } => uncertainty_mm,
            Self::Slow { search_mm, .. } => search_mm,
        };
        let (out, beyond) = self.ends();
        TouchExtent { out, beyond, loose }
    }

    fn feed_mm_min(self, probe: &Probe) -> f64 {
        match self {
            Self::Find { .. } => probe.search_feed_mm_min,
            Self::Slow { .. } => probe.feed_mm_min,
        }
    }
}

impl Access {
    /// Checks whether this ball can be measured. Returns the touches that would be made.
    ///
    /// # Errors
    /// The reason: an obstacle to a touch, an axis out of travel, a tilted spindle.
    pub fn accessible(&self, task: &BallTask<'_>) -> Result<Vec<Contact>, Unreachable> {
        self.contacts(task.ball, task.rotary, task.approach.stand(), task.touches)
    }

    /// Steps of one measurement, numbered from `first`, machine frame. `label` makes the label of a step from the
    /// name of the touch.
    ///
    /// # Errors
    /// As [`Access::accessible`]; a touch is longer than the probe's overtravel.
    pub fn steps(
        &self,
        task: &BallTask<'_>,
        probe: &Probe,
        kind: StepKind,
        (first, stage): (u32, u32),
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, Unreachable> {
        let contacts = self.accessible(task)?;
        self.steps_of(task, contacts, probe, kind, (first, stage), label)
    }

    /// Like [`Access::steps`], but along `directions`: azimuth and elevation, degrees, in the spindle frame without
    /// the rotation of S. Numbers and stage are 0.
    ///
    /// # Errors
    /// The first direction that is not free; a touch is longer than the probe's overtravel.
    pub fn steps_along(
        &self,
        task: &BallTask<'_>,
        directions: &[[f64; 2]],
        probe: &Probe,
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, Unreachable> {
        let BallTask { ball, rotary, approach, .. } = *task;
        let contacts = self.contacts_along(ball, rotary, approach.stand(), directions)?;
        self.steps_of(task, contacts, probe, StepKind::Touch, (0, 0), label)
    }

    fn steps_of(
        &self,
        task: &BallTask<'_>,
        contacts: Vec<Contact>,
        probe: &Probe,
        kind: StepKind,
        (first, stage): (u32, u32),
        label: impl Fn(&str) -> String,
    ) -> Result<Vec<Step>, Unreachable> {
        let (out, beyond) = task.approach.ends();
        let (length, overtravel) = (out + beyond, probe.overtravel_mm);
        if length > overtravel {
            return Err(Unreachable::TooLong { length, overtravel });
        }
        let numbered = (first..).zip(contacts);
        numbered
            .map(|(id, contact)| {
                let place = |far: f64| {
                    let far = self.reach(task.ball) + far;
                    self.position(task.ball, task.rotary, contact.normal, far)
                };
                let (from, to) = (place(out)?, place(-beyond)?);
                Ok(Step {
                    id,
                    stage,
                    kind,
                    label: label(&contact.name),
                    from: from.as_written(),
                    to: to.as_written(),
                    feed_mm_min: task.approach.feed_mm_min(probe),
                    sensors: vec!["probe".to_owned()],
                    normal: contact.normal.into(),
                    scan: None,
                    text: None,
                    mount: None,
                    watch: Vec::new(),
                })
            })
            .collect()
    }

    /// Axis positions with the stylus-ball centre on the ball's centre: the result of a measurement.
    ///
    /// # Errors
    /// The linear axes of the machine do not span space.
    pub fn centre(&self, ball: &Ball, rotary: &Position) -> Result<Position, Unreachable> {
        let centre = self.position(ball, rotary, nalgebra::Vector3::z(), 0.0)?;
        Ok(centre.only(Axis::is_linear))
    }
}
