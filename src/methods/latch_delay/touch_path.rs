//! Touches of the plan. All touches are at one position of the part and in one direction.
//!
//! All touches are as long as a search for the part. They take a few seconds longer than touches near the found
//! position, but each is proven against the part at every possible position: one contact determines the position of
//! the part along the touch, not across it.

use nalgebra::Vector3;

use super::feeds::TouchFeeds;
use super::settings::LatchDelaySettings;
use crate::MethodRefusal;
use machine::artefact::max_misplacement_mm;
use machine::frame::unit_vector;
use machine::kinematics::KinematicChain;
use machine::record::artefact::{Artefact, Balls, Cylinder};
use machine::record::plan::{Plan, Step, StepKind};
use machine::{Axis, Position, frame::Point};
use planning::{BallMeasurementRequest, BallTouchMode, TouchAccess};

/// Label of the first touch, which is not used for identification.
pub const SEARCH_STEP_LABEL: &str = "search";
/// Clearance at the start of a touch in addition to position uncertainty and feed margin, mm.
const STANDOFF_MM: f64 = 0.5;
/// Distance at the end of a touch in addition to position uncertainty and feed margin, mm.
const OVERRUN_MM: f64 = 0.3;
/// Minimum cosine of the angle between the part's axis and +Z of the table frame: one degree.
const MIN_COSINE_TO_TABLE_Z: f64 = 0.99985;
/// Number of touches of one ball among which the touch nearest to the preferred direction is selected.
const CANDIDATE_TOUCHES_PER_BALL: usize = 5;

/// Start, end and normal of a touch.
#[derive(Debug, Clone, PartialEq)]
pub struct TouchEndsAndNormal {
    /// Axis positions at the start, before the first possible contact.
    pub from: Position,
    /// Axis positions at the end, beyond the last possible contact.
    pub to: Position,
    /// Outward unit normal of the surface at the contact, machine frame.
    pub normal: [f64; 3],
}

/// Length of a touch, mm, for a part whose position is uncertain by ±`uncertainty_mm` and a feed that needs
/// `margin_mm` before the first and beyond the last possible contact.
pub fn touch_length_mm(uncertainty_mm: f64, margin_mm: f64) -> f64 {
    2.0 * (uncertainty_mm + margin_mm) + STANDOFF_MM + OVERRUN_MM
}

impl TouchEndsAndNormal {
    /// Touch of the flank of a cylinder, or of the first accessible ball.
    ///
    /// # Errors
    /// The artefact is neither a cylinder nor balls, the cylinder is not upright, the axes reach no position, or no
    /// touch of a ball is free of collision. A touch of a cylinder is not checked for collision here.
    pub fn from_plan(plan: &Plan, settings: &LatchDelaySettings, feeds: &TouchFeeds) -> Result<Self, MethodRefusal> {
        let half_travel_mm = max_misplacement_mm(&plan.artefact) + feeds.fast_touch_margin_mm;
        match &plan.artefact {
            Artefact::Cylinder(part) => flank_touch(plan, settings, part, half_travel_mm),
            Artefact::Balls(balls) => ball_touch(plan, settings, balls, half_travel_mm),
            Artefact::DatumCylinder(_) => Err(MethodRefusal::new(
                "this method touches the artefact; a datum cylinder is not touched",
                "describe the part with kind = \"cylinder\"",
            )),
            Artefact::None => Err(MethodRefusal::new(
                "this method touches the artefact; [artefact] states that there is none",
                "describe a part with kind = \"cylinder\", or balls with kind = \"balls\"",
            )),
        }
    }

    fn touch_step(&self, kind: StepKind, label: String, feed_mm_min: f64) -> Step {
        let touch = Step::probe_touch(label, self.from.clone(), self.to.clone(), self.normal);
        Step { kind, feed_mm_min, ..touch }
    }

    /// The search touch.
    pub fn search_step(&self, feed_mm_min: f64) -> Step {
        self.touch_step(StepKind::Touch, SEARCH_STEP_LABEL.to_owned(), feed_mm_min)
    }

    /// Touches in the order slow, fast, fast, slow and so on, so that a uniform drift affects both feeds alike. The
    /// slow ones are references: after an interruption they show whether the part has moved.
    pub fn alternating_steps(&self, feeds: &TouchFeeds, touches_per_feed: u32) -> Vec<Step> {
        let slow = (StepKind::Reference, feeds.measuring_feed_mm_min);
        let fast = (StepKind::Touch, feeds.fast_feed_mm_min);
        let pairs = (0..touches_per_feed).flat_map(|pair| {
            let both = if pair % 2 == 0 { [slow, fast] } else { [fast, slow] };
            both.map(|(kind, feed)| self.touch_step(kind, format!("F{feed}/{:02}", pair + 1), feed))
        });
        pairs.collect()
    }
}

/// Unit vector in the XY plane at this angle from X towards Y.
fn horizontal_direction(degrees: f64) -> Vector3<f64> {
    let (sin, cos) = degrees.to_radians().sin_cos();
    Vector3::new(cos, sin, 0.0)
}

/// Touch of an upright cylinder at half the height of its flank, from `direction_deg` or the first of four directions
/// that is within the travel.
fn flank_touch(
    plan: &Plan,
    settings: &LatchDelaySettings,
    part: &Cylinder,
    half_travel_mm: f64,
) -> Result<TouchEndsAndNormal, MethodRefusal> {
    let axis = Vector3::from(part.axis);
    MethodRefusal::require(
        axis.z > MIN_COSINE_TO_TABLE_Z * axis.norm(),
        "the part is not upright: axis in [artefact] is not [0, 0, 1]",
        "mount the part upright: this method touches the flank of an upright round part",
    )?;
    let directions = match settings.direction_deg {
        Some(degrees) => vec![degrees],
        None => vec![0.0, 90.0, 180.0, 270.0],
    };
    let mut unreachable = None;
    for degrees in directions {
        let path = flank_touch_from_direction(plan, part, horizontal_direction(degrees), half_travel_mm)?;
        match axis_out_of_travel(plan, &path) {
            None => return Ok(path),
            Some(axis) => unreachable = unreachable.or(Some(axis)),
        }
    }
    Err(MethodRefusal::new(
        match unreachable {
            Some(axis) => format!("{axis} does not reach the flank of the part"),
            None => "no direction to touch the part is left".to_owned(),
        },
        "mount the part nearer to the middle of the travel, choose another direction_deg, \
                  or correct centre_mm in [artefact] and tool_mm",
    ))
}

/// `towards`: horizontal direction from the part to the probe, machine frame. The travel limits are not checked.
fn flank_touch_from_direction(
    plan: &Plan,
    part: &Cylinder,
    towards: Vector3<f64>,
    half_travel_mm: f64,
) -> Result<TouchEndsAndNormal, MethodRefusal> {
    let chain = KinematicChain::new(&plan.machine)?;
    let rotary = plan.machine.rotary_zero_position();
    let table = chain.machine_from_table(&rotary, &[]).rotation;
    let axis = unit_vector(Vector3::from(part.axis)).unwrap_or_default();
    let towards = table.inverse() * towards;
    let level = towards - axis * towards.dot(&axis);
    let outward = unit_vector(level).unwrap_or_default();
    let middle = Vector3::from(part.foot_mm) + axis * part.height_mm / 2.0;
    let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
    let position = |clearance_mm: f64| {
        let reach = part.radius_mm + plan.probe.ball_radius_mm + clearance_mm;
        let linear = chain.solve_linear_axes(Point::from_vec(middle + reach * outward), tip, &rotary, &[]);
        linear.map(|linear| rotary.updated_by(&linear.filter_axes(Axis::is_linear)).rounded_to_file_resolution())
    };
    Ok(TouchEndsAndNormal {
        from: position(half_travel_mm + STANDOFF_MM)?,
        to: position(-half_travel_mm - OVERRUN_MM)?,
        normal: (table * outward).into(),
    })
}

/// First linear axis whose travel does not contain both ends of the touch. `None`: all contain them.
fn axis_out_of_travel(plan: &Plan, path: &TouchEndsAndNormal) -> Option<Axis> {
    let ends = path.from.iter().chain(path.to.iter());
    let is_outside = |(axis, value): &(Axis, f64)| {
        let spec = plan.machine.axes.get(axis);
        !spec.is_some_and(|spec| (spec.min..=spec.max).contains(&axis.to_mm_or_deg(*value)))
    };
    ends.filter(|(axis, _)| axis.is_linear()).find(is_outside).map(|(axis, _)| axis)
}

/// Touch of the first ball that can be measured, from the free direction that is nearest to `direction_deg`, by default
/// from above.
fn ball_touch(
    plan: &Plan,
    settings: &LatchDelaySettings,
    balls: &Balls,
    half_travel_mm: f64,
) -> Result<TouchEndsAndNormal, MethodRefusal> {
    let access = TouchAccess::new(plan, &plan.artefact)?;
    let preferred = settings.direction_deg.map_or(Vector3::z(), horizontal_direction);
    let (rotary, mut first_reason) = (plan.machine.rotary_zero_position(), None);
    for ball in &balls.balls {
        let mode = BallTouchMode::Search { uncertainty_mm: half_travel_mm, standoff_mm: STANDOFF_MM };
        let request =
            BallMeasurementRequest { ball, rotary: &rotary, touch_mode: mode, touch_count: CANDIDATE_TOUCHES_PER_BALL };
        let steps = access.touch_steps(&request, &plan.probe, StepKind::Touch, str::to_owned);
        match steps {
            Ok(steps) => {
                let along = |step: &Step| Vector3::from(step.normal).dot(&preferred);
                let best = steps.into_iter().max_by(|a, b| along(a).total_cmp(&along(b)));
                if let Some(Step { from, to, normal, .. }) = best {
                    return Ok(TouchEndsAndNormal { from, to, normal });
                }
            }
            Err(why) => first_reason = first_reason.or(Some(format!("ball {}: {why}", ball.id))),
        }
    }
    Err(MethodRefusal::new(
        format!(
            "no ball can be touched with all rotary axes at zero; {}",
            first_reason.unwrap_or_else(|| "the artefact has no balls".to_owned())
        ),
        "mount the balls so that one of them is accessible, or correct \
                  [artefact]",
    ))
}
