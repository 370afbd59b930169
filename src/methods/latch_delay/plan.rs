//! Touches of the plan: one position, always in the same direction.
//!
//! All touches are as long as a search for the part. They take a few seconds longer than touches near the found
//! position, but each is proven against the part at every possible position: one contact determines the position of
//! the part along the touch, not across it.

use nalgebra::Vector3;

use super::feeds::Feeds;
use super::settings::Settings;
use crate::Refused;
use machine::artefact::uncertainty_mm;
use machine::frame::unit_vector;
use machine::kinematics::Chain;
use machine::record::artefact::{Artefact, Balls, Cylinder};
use machine::record::plan::{Plan, Step, StepKind};
use machine::{Axis, Position, frame::Point};
use planning::{Access, Approach, BallTask};

/// Label of the first touch, which is not used for identification.
pub const SEARCH: &str = "search";
/// Clearance before the first possible contact, and distance beyond the last one, mm.
const STANDOFF_MM: f64 = 0.5;
const BEYOND_MM: f64 = 0.3;
/// Minimum cosine of the tilt of the part's axis: one degree.
const UPRIGHT: f64 = 0.99985;
/// Number of touches of one ball that are considered.
const TOUCHES_PER_BALL: usize = 5;

/// The touch of a plan, without number and feed.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    pub from: Position,
    pub to: Position,
    pub normal: [f64; 3],
}

/// Length of a touch, mm, for a part whose position is uncertain by `uncertainty_mm` and a feed that needs
/// `room_mm`.
pub fn length_mm(uncertainty_mm: f64, room_mm: f64) -> f64 {
    2.0 * (uncertainty_mm + room_mm) + STANDOFF_MM + BEYOND_MM
}

impl Place {
    /// # Errors
    /// The axes reach no position, or none is free of collision.
    pub fn choose(plan: &Plan, settings: &Settings, feeds: &Feeds) -> Result<Self, Refused> {
        let within_mm = uncertainty_mm(&plan.artefact) + feeds.room_mm;
        match &plan.artefact {
            Artefact::Cylinder(part) => on_flank(plan, settings, part, within_mm),
            Artefact::Balls(balls) => on_ball(plan, settings, balls, within_mm),
            Artefact::DatumCylinder(_) => Err(Refused {
                why: "this method touches the artefact; a datum cylinder is not touched".to_owned(),
                instead: "describe the part with kind = \"cylinder\"".to_owned(),
            }),
            Artefact::None => Err(Refused {
                why: "this method touches the artefact; [artefact] states that there is none"
                    .to_owned(),
                instead: "describe a part with kind = \"cylinder\", or balls with kind = \"balls\""
                    .to_owned(),
            }),
        }
    }

    fn step(&self, (id, stage): (u32, u32), kind: StepKind, label: String, feed: f64) -> Step {
        Step {
            id,
            stage,
            kind,
            label,
            from: self.from.clone(),
            to: self.to.clone(),
            feed_mm_min: feed,
            sensors: vec!["probe".to_owned()],
            normal: self.normal,
            scan: None,
            text: None,
            mount: None,
            watch: Vec::new(),
        }
    }

    /// The search touch.
    pub fn search(&self, feed_mm_min: f64) -> Step {
        self.step((0, 0), StepKind::Touch, SEARCH.to_owned(), feed_mm_min)
    }

    /// Touches in the order slow, fast, fast, slow and so on, so that a uniform drift affects both feeds alike. The
    /// slow ones are references: after an interruption they show whether the part has moved.
    pub fn alternating(&self, feeds: &Feeds, touches: u32) -> Vec<Step> {
        let slow = (StepKind::Reference, feeds.measuring_mm_min);
        let fast = (StepKind::Touch, feeds.fast_mm_min);
        let pairs = (0..touches).flat_map(|pair| {
            let both = if pair % 2 == 0 { [slow, fast] } else { [fast, slow] };
            both.map(|(kind, feed)| (pair + 1, kind, feed))
        });
        let numbered = (1..).zip(pairs);
        numbered
            .map(|(id, (number, kind, feed))| {
                self.step((id, 1), kind, format!("F{feed}/{number:02}"), feed)
            })
            .collect()
    }
}

fn towards(degrees: f64) -> Vector3<f64> {
    let (sin, cos) = degrees.to_radians().sin_cos();
    Vector3::new(cos, sin, 0.0)
}

/// Touch of a cylinder at half the height of its flank.
fn on_flank(
    plan: &Plan,
    settings: &Settings,
    part: &Cylinder,
    within_mm: f64,
) -> Result<Place, Refused> {
    let axis = Vector3::from(part.axis);
    if axis.z <= UPRIGHT * axis.norm() {
        return Err(Refused {
            why: "the part does not stand upright: [artefact] axis is not [0, 0, 1]".to_owned(),
            instead: "this method touches the flank of an upright round part".to_owned(),
        });
    }
    let directions = match settings.direction_deg {
        Some(degrees) => vec![degrees],
        None => vec![0.0, 90.0, 180.0, 270.0],
    };
    let mut beyond = None;
    for degrees in directions {
        let place = flank_at(plan, part, towards(degrees), within_mm)?;
        match out_of_travel(plan, &place) {
            None => return Ok(place),
            Some(axis) => beyond = beyond.or(Some(axis)),
        }
    }
    Err(Refused {
        why: match beyond {
            Some(axis) => format!("{axis} does not reach the flank of the part"),
            None => "no direction is left to touch the part from".to_owned(),
        },
        instead: "bring the part nearer to the middle, name another direction_deg, or correct [artefact] \
                  centre_mm and tool_mm"
            .to_owned(),
    })
}

fn flank_at(
    plan: &Plan,
    part: &Cylinder,
    towards: Vector3<f64>,
    within_mm: f64,
) -> Result<Place, Refused> {
    let chain = Chain::new(&plan.machine)?;
    let rotary = plan.machine.rotary_at_zero();
    let table = chain.machine_from_table(&rotary, &[]).rotation;
    let axis = unit_vector(Vector3::from(part.axis)).unwrap_or_default();
    let towards = table.inverse() * towards;
    let level = towards - axis * towards.dot(&axis);
    let outward = unit_vector(level).unwrap_or_default();
    let middle = Vector3::from(part.centre_mm) + axis * part.height_mm / 2.0;
    let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
    let at = |out: f64| {
        let reach = part.radius_mm + plan.probe.ball_radius_mm + out;
        let linear =
            chain.linear_axes_for(Point::from_vec(middle + reach * outward), tip, &rotary, &[]);
        linear.map(|linear| rotary.updated_by(&linear.only(Axis::is_linear)).as_written())
    };
    Ok(Place {
        from: at(within_mm + STANDOFF_MM)?,
        to: at(-within_mm - BEYOND_MM)?,
        normal: (table * outward).into(),
    })
}

fn out_of_travel(plan: &Plan, place: &Place) -> Option<Axis> {
    let ends = place.from.iter().chain(place.to.iter());
    let outside = |(axis, value): &(Axis, f64)| {
        let spec = plan.machine.axes.get(axis);
        !spec.is_some_and(|spec| (spec.min..=spec.max).contains(&axis.to_edge(*value)))
    };
    ends.filter(|(axis, _)| axis.is_linear()).find(outside).map(|(axis, _)| axis)
}

/// Touch of the first ball that can be measured, from a free direction.
fn on_ball(
    plan: &Plan,
    settings: &Settings,
    balls: &Balls,
    within_mm: f64,
) -> Result<Place, Refused> {
    let access = Access::new(plan, &plan.artefact)?;
    let wanted = settings.direction_deg.map_or(Vector3::z(), towards);
    let (rotary, mut why_not) = (plan.machine.rotary_at_zero(), None);
    for ball in &balls.balls {
        let approach = Approach::Find { uncertainty_mm: within_mm, standoff_mm: STANDOFF_MM };
        let task = BallTask { ball, rotary: &rotary, approach, touches: TOUCHES_PER_BALL };
        let steps = access.steps(&task, &plan.probe, StepKind::Touch, (0, 0), str::to_owned);
        match steps {
            Ok(steps) => {
                let along = |step: &Step| Vector3::from(step.normal).dot(&wanted);
                let best = steps.into_iter().max_by(|a, b| along(a).total_cmp(&along(b)));
                if let Some(Step { from, to, normal, .. }) = best {
                    return Ok(Place { from, to, normal });
                }
            }
            Err(why) => why_not = why_not.or(Some(format!("ball {}: {why}", ball.id))),
        }
    }
    Err(Refused {
        why: format!(
            "no ball can be touched with all rotary axes at zero; {}",
            why_not.unwrap_or_else(|| "there is none".to_owned())
        ),
        instead: "set the balls up where one of them is free, or correct [artefact]".to_owned(),
    })
}
