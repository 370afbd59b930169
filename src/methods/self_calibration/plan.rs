//! From the design to steps: where the machine goes (paper 1, section 2.2).

use glam::DVec3;

use super::design::{Design, Touch};
use super::settings::{Settings, Spindle};
use crate::base::{Axis, Point, Position, Spindle as SpindleFrame, Table};
use crate::kinematics::Chain;
use crate::methods::Refused;
use crate::record::machine::{Artefact, AxisSpec};
use crate::record::plan::{Plan, Step, StepKind};

/// Prefix of the labels of the locating touches; they serve no identification.
pub const LOCATE_LABEL: &str = "locate/";

/// What is known of the part: centre in the table frame at C = 0, radius of the ball centres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    pub centre: [f64; 2],
    /// Part radius + ball radius.
    pub reach: f64,
}

/// Writes steps for one plan.
pub struct Planner<'a> {
    plan: &'a Plan,
    settings: &'a Settings,
    design: Design,
    chain: Chain,
    tip: Point<SpindleFrame>,
    c_axis: &'a AxisSpec,
}

impl<'a> Planner<'a> {
    /// # Errors
    /// Refuses a machine without a C axis on the workpiece side and a design that is not well-posed.
    pub fn new(plan: &'a Plan, settings: &'a Settings) -> Result<Self, Refused> {
        settings.check(&plan.artefact, plan.probe.ball_radius_mm)?;
        let design = Design::new(settings)?;
        let chain = Chain::new(&plan.machine).map_err(|error| Refused {
            why: error.to_string(),
            instead: "correct [machine] and [axes] in the machine file".to_owned(),
        })?;
        let Some(c_axis) = plan
            .machine
            .axes
            .get(&Axis::C)
            .filter(|_| chain.topology().workpiece().contains(&Axis::C))
        else {
            return Err(Refused {
                why: "this method needs a rotary axis C that carries the workpiece".to_owned(),
                instead: "state C on the workpiece side of the topology (w-C-…) and as [axes.C]"
                    .to_owned(),
            });
        };
        if settings.spindle == Spindle::Follow && !plan.machine.axes.contains_key(&Axis::S) {
            return Err(Refused {
                why: "the spindle cannot be oriented: the machine has no axis S".to_owned(),
                instead: "choose spindle = \"fixed\", or describe [axes.S]".to_owned(),
            });
        }
        let tip = Point::from_vec(DVec3::from_array(plan.machine.tool_mm));
        Ok(Self { plan, settings, design, chain, tip, c_axis })
    }

    /// The part as the plan states it.
    pub fn nominal_part(&self) -> Part {
        let Artefact::Cylinder { centre_mm, radius_mm, .. } = self.plan.artefact;
        Part {
            centre: [centre_mm[0], centre_mm[1]],
            reach: radius_mm + self.plan.probe.ball_radius_mm,
        }
    }

    /// Four search touches, wide enough for the stated uncertainty of the part's place.
    pub fn locating_steps(&self) -> Result<Vec<Step>, Refused> {
        let Artefact::Cylinder { uncertainty_mm, .. } = self.plan.artefact;
        let part = self.nominal_part();
        let margin = uncertainty_mm + self.settings.standoff_mm;
        let z = self.heights()[0];
        (0..4u32)
            .map(|quarter| {
                let angle = std::f64::consts::FRAC_PI_2 * f64::from(quarter);
                let ray = Ray { start: part.centre, angle };
                self.step(&StepSpec {
                    id: quarter,
                    stage: 0,
                    kind: StepKind::Touch,
                    label: format!("{LOCATE_LABEL}P{:03}", 90 * quarter),
                    ray,
                    out: part.reach + margin,
                    inward: margin + uncertainty_mm,
                    z,
                    c: 0,
                    feed_mm_min: self.plan.probe.search_feed_mm_min,
                })
            })
            .collect()
    }

    /// The whole cycle at every height, around the part where it really stands.
    pub fn cycle_steps(&self, part: Part) -> Result<Vec<Step>, Refused> {
        let first = self.plan.steps.len();
        let stage = self.plan.steps.last().map_or(0, |step| step.stage + 1);
        let heights = self.heights();
        let touches = self.design.cycle(self.settings.references);
        heights
            .iter()
            .flat_map(|z| touches.iter().map(move |touch| (*z, *touch)))
            .enumerate()
            .map(|(i, (z, touch))| {
                let label = self.label(touch, (heights.len() > 1).then_some(z));
                self.cycle_step((first + i) as u32, stage, label, z, touch, part)
            })
            .collect()
    }

    /// Heights of the touches in the machine frame, mm.
    pub fn heights(&self) -> Vec<f64> {
        let Artefact::Cylinder { centre_mm, height_mm, .. } = self.plan.artefact;
        if self.settings.heights_mm.is_empty() {
            return vec![centre_mm[2] + height_mm / 2.0];
        }
        self.settings.heights_mm.iter().map(|height| centre_mm[2] + height).collect()
    }

    fn label(&self, touch: Touch, z: Option<f64>) -> String {
        let degrees = |index| self.design.angle(index).to_degrees().round();
        let place = if touch.c == 0 && !matches!(touch.test, super::design::Test::One(_)) {
            format!("P{:03}", degrees(touch.phi))
        } else {
            format!("C{:03}", degrees(touch.c))
        };
        let height = z.map_or(String::new(), |z| format!("/Z{z:.0}"));
        format!("{}/{place}{height}", touch.test.name())
    }

    fn cycle_step(
        &self,
        id: u32,
        stage: u32,
        label: String,
        z: f64,
        touch: Touch,
        part: Part,
    ) -> Result<Step, Refused> {
        let angle = self.design.angle(touch.phi);
        let out =
            expected_radius(part, self.design.angle(touch.c), angle).ok_or_else(|| Refused {
                why: format!("at {label} the ray from the axis misses the part"),
                instead: "bring the part nearer to the axis, or correct [artefact] centre_mm"
                    .to_owned(),
            })?;
        let kind = match touch.test {
            super::design::Test::Reference(_) => StepKind::Reference,
            _ => StepKind::Touch,
        };
        self.step(&StepSpec {
            id,
            stage,
            kind,
            label,
            ray: Ray { start: [0.0, 0.0], angle },
            out: out + self.settings.standoff_mm,
            inward: self.settings.standoff_mm + self.settings.search_mm,
            z,
            c: touch.c,
            feed_mm_min: self.plan.probe.feed_mm_min,
        })
    }

    fn step(&self, spec: &StepSpec) -> Result<Step, Refused> {
        let (sin, cos) = spec.ray.angle.sin_cos();
        let mut rotary = Position::new().with(Axis::C, self.command(spec.c)?);
        let still = |axis: &&Axis| !axis.is_linear() && !matches!(axis, Axis::C | Axis::S);
        for axis in self.plan.machine.axes.keys().filter(still) {
            rotary.set(*axis, 0.0);
        }
        // A fixed spindle is not commanded: it keeps the orientation it has.
        if self.settings.spindle == Spindle::Follow {
            rotary.set(Axis::S, spec.ray.angle);
        }
        let place = |distance: f64| {
            let [x, y] = spec.ray.start;
            let target = Point::<Table>::new(x + distance * cos, y + distance * sin, spec.z);
            // The table frame turns with C; the ray does not: solve with C at zero.
            let still = rotary.updated_by(&Position::new().with(Axis::C, 0.0));
            let linear = self.chain.linear_axes_for(target, self.tip, &still, &[]);
            linear.map(|solved| still.updated_by(&solved).only(Axis::is_linear))
        };
        let refused = |error: crate::kinematics::KinematicsError| Refused {
            why: format!("{}: {error}", spec.label),
            instead: "correct [machine] topology".to_owned(),
        };
        let from = place(spec.out).map_err(refused)?;
        let to = place(spec.out - spec.inward).map_err(refused)?;
        Ok(Step {
            id: spec.id,
            stage: spec.stage,
            kind: spec.kind,
            label: spec.label.clone(),
            from: from.updated_by(&rotary).as_written(),
            to: to.updated_by(&rotary).as_written(),
            feed_mm_min: spec.feed_mm_min,
            sensor: "probe".to_owned(),
            normal: [cos, sin, 0.0],
        })
    }

    /// Commanded C of a grid index, rad: its sense, and a turn more or less to stay in the limits.
    fn command(&self, index: usize) -> Result<f64, Refused> {
        let spec = self.c_axis;
        let wanted = self.design.angle(index) * spec.positive.sign();
        let (min, max) = (Axis::C.from_edge(spec.min), Axis::C.from_edge(spec.max));
        let turn = std::f64::consts::TAU;
        // Prefer the turn nearest to zero.
        [0.0, -turn, turn]
            .into_iter()
            .map(|shift| wanted + shift)
            .filter(|c| (min - 1e-9..=max + 1e-9).contains(c))
            .min_by(|a, b| a.abs().total_cmp(&b.abs()))
            .ok_or_else(|| Refused {
                why: format!(
                    "C cannot reach {:.3}° within [{}, {}]",
                    wanted.to_degrees(),
                    spec.min,
                    spec.max
                ),
                instead: "this method needs a full turn of C".to_owned(),
            })
    }
}

/// A radial line in the plane of measurement.
struct Ray {
    start: [f64; 2],
    angle: f64,
}

struct StepSpec {
    id: u32,
    stage: u32,
    kind: StepKind,
    label: String,
    ray: Ray,
    /// Where the touch starts, from the ray's start.
    out: f64,
    /// How far it goes inwards.
    inward: f64,
    z: f64,
    c: usize,
    feed_mm_min: f64,
}

/// Distance from the machine's origin along the ray at `phi` to the ball centre in contact, the
/// table turned by `c` about the nominal axis; `None` if the ray misses the part.
fn expected_radius(part: Part, c: f64, phi: f64) -> Option<f64> {
    let [x, y] = part.centre;
    // The part turns by −c seen in the machine: its centre lies at R(−c)·centre.
    let (sin, cos) = (phi + c).sin_cos();
    let (along, across) = (x * cos + y * sin, -x * sin + y * cos);
    let root = part.reach * part.reach - across * across;
    (root > 0.0).then(|| along + root.sqrt())
}
