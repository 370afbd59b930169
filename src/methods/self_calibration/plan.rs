//! From the design to steps with machine positions (paper 1, section 2.2).

use nalgebra::Vector3;

use super::design::{AngleGridTouch, CalibrationTest};
use super::measured_table_axis::MeasuredTableAxis;
use super::settings::SpindleMode;
use super::setup::{PartGeometry, SelfCalibrationSetup};
use crate::MethodRefusal;
use machine::record::plan::{Step, StepKind};
use machine::{Axis, Position};

/// Prefix of the labels of the locating touches, which are not used for identification.
pub const LOCATE_LABEL_PREFIX: &str = "locate/";

/// Whether the step touches the top face. Its reading does not depend on the measured axis and is not an observation.
pub fn is_top_touch(step: &Step) -> bool {
    step.normal[2] > 0.5
}

impl SelfCalibrationSetup<'_> {
    /// Search touches, one on the top of the part (if the settings require it) and four around it, as long as the
    /// stated position uncertainty requires. The first three confirm the position of the machine. The steps are not
    /// numbered yet.
    pub fn locating_steps(&self) -> Result<Vec<Step>, MethodRefusal> {
        let uncertainty_mm = self.stated_part.uncertainty_mm;
        let part = self.nominal_part();
        let margin = uncertainty_mm + self.settings.standoff_mm;
        let parameters = |place: String| TouchParameters {
            kind: StepKind::Touch,
            label: format!("{LOCATE_LABEL_PREFIX}{place}"),
            standoff_mm: margin,
            travel_mm: margin + uncertainty_mm,
            c_index: 0,
            feed_mm_min: self.plan.probe.search_feed_mm_min,
        };
        let z = self.heights_in_machine_mm[0];
        let top = || self.touch_step(parameters("Z".to_owned()), self.top_contact_position(part), Vector3::z());
        let top = self.settings.touches_top().then(top);
        let round = (0..4u32).map(|quarter| {
            let angle = std::f64::consts::FRAC_PI_2 * f64::from(quarter);
            let normal = Vector3::new(angle.cos(), angle.sin(), 0.0);
            let centre = Vector3::new(part.centre_mm[0], part.centre_mm[1], z);
            let place = format!("P{:03}", 90 * quarter);
            self.touch_step(parameters(place), centre + part.contact_radius_mm * normal, normal)
        });
        top.into_iter().chain(round).collect()
    }

    /// Position of the ball centre on the top face, machine frame with the measured axis at zero, mm.
    fn top_contact_position(&self, part: PartGeometry) -> Vector3<f64> {
        let [x, y] = self.settings.z_reference_at_mm;
        Vector3::new(part.centre_mm[0] + x, part.centre_mm[1] + y, part.ball_centre_z_at_top_mm)
    }

    /// All touches after locating, around the part at its measured position: the whole cycle at one height after the
    /// other. With `z_reference`, a touch of the top face follows each round of references. The steps are not numbered
    /// yet.
    pub fn steps_after_locating(&self, part: PartGeometry) -> Result<Vec<Step>, MethodRefusal> {
        let touches = self.design.cycle_touches(self.settings.references);
        let mut steps = Vec::new();
        for z in &self.heights_in_machine_mm {
            let suffix = if self.heights_in_machine_mm.len() > 1 { format!("/Z{z:.0}") } else { String::new() };
            for (i, touch) in touches.iter().enumerate() {
                let label = format!("{}{suffix}", self.touch_label(*touch));
                steps.push(self.flank_touch_step(self.grid_touch_parameters(label, *touch), *z, *touch, part)?);
                let next = touches.get(i + 1).map(|next| next.test);
                if touch.test.is_reference() && next != Some(touch.test) && self.settings.z_reference {
                    let parameters = self.grid_touch_parameters(format!("{}/Z{suffix}", touch.test.name()), *touch);
                    steps.push(self.touch_step(parameters, self.top_contact_position(part), Vector3::z())?);
                }
            }
        }
        Ok(steps)
    }

    fn touch_label(&self, touch: AngleGridTouch) -> String {
        let degrees = |index| self.design.grid_angle_rad(index).to_degrees().round();
        let place = if touch.c_index == 0 && !matches!(touch.test, CalibrationTest::Test1(_)) {
            format!("P{:03}", degrees(touch.phi_index))
        } else {
            format!("{}{:03}", self.axis.axis, degrees(touch.c_index))
        };
        format!("{}/{place}", touch.test.name())
    }

    fn grid_touch_parameters(&self, label: String, touch: AngleGridTouch) -> TouchParameters {
        let kind = if touch.test.is_reference() { StepKind::Reference } else { StepKind::Touch };
        TouchParameters {
            kind,
            label,
            standoff_mm: self.settings.standoff_mm,
            travel_mm: self.settings.standoff_mm + self.settings.search_mm,
            c_index: touch.c_index,
            feed_mm_min: self.plan.probe.feed_mm_min,
        }
    }

    /// A touch of the flank along its ray through the stated axis.
    fn flank_touch_step(
        &self,
        parameters: TouchParameters,
        z: f64,
        touch: AngleGridTouch,
        part: PartGeometry,
    ) -> Result<Step, MethodRefusal> {
        let angle = self.design.grid_angle_rad(touch.phi_index);
        let axis = self.axis.axis_point_at_height(z);
        let from_axis = [part.centre_mm[0] - axis.x, part.centre_mm[1] - axis.y];
        let off_axis = PartGeometry { centre_mm: from_axis, ..part };
        let turned = self.design.grid_angle_rad(touch.c_index);
        let distance = expected_contact_distance_mm(off_axis, turned, angle).ok_or_else(|| {
            MethodRefusal::new(
                format!("at {} a touch along the ray from the axis would miss the part", parameters.label),
                format!(
                    "move the part closer to the axis, or correct [artefact] centre_mm or [axes.{}] point_mm, \
                both in machine coordinates",
                    self.axis.axis
                ),
            )
        })?;
        let normal = Vector3::new(angle.cos(), angle.sin(), 0.0);
        self.touch_step(parameters, axis + distance * normal, normal)
    }

    /// A touch against `normal`, with the ball centre at `contact` at the expected contact: machine frame, with the
    /// axis at zero.
    fn touch_step(
        &self,
        parameters: TouchParameters,
        contact: Vector3<f64>,
        normal: Vector3<f64>,
    ) -> Result<Step, MethodRefusal> {
        let TouchParameters { kind, label, standoff_mm, travel_mm, c_index, feed_mm_min } = parameters;
        let mut orientation = Position::new();
        // A fixed spindle is not commanded and keeps its orientation.
        if self.settings.spindle == SpindleMode::Follow {
            let turn = normal.y.atan2(normal.x).rem_euclid(std::f64::consts::TAU);
            orientation.set(Axis::S, turn);
        }
        let rotary = self.axis.rotary_position_with_axis_at_zero.updated_by(&orientation);
        let rotary = rotary.with(self.axis.axis, self.axis_command_rad(c_index)?);
        // The table turns with the axis, but the ray does not.
        let position = |out: f64| match self.axis.solve_linear_axes(contact + out * normal, &orientation) {
            Ok(linear) => Ok(linear.updated_by(&rotary).rounded_to_file_resolution()),
            Err(error) => Err(MethodRefusal::new(format!("{label}: {error}"), "correct [machine] topology")),
        };
        let (from, to) = (position(standoff_mm)?, position(standoff_mm - travel_mm)?);
        Ok(Step { kind, feed_mm_min, ..Step::probe_touch(label, from, to, normal.into()) })
    }

    /// Command of the axis for a grid index, rad: with the sense of the axis, and of the equivalent angles within the
    /// limits the one nearest to zero. Error: no equivalent angle is within the limits.
    fn axis_command_rad(&self, index: usize) -> Result<f64, MethodRefusal> {
        let MeasuredTableAxis { axis, stated_axis, clockwise_sign: sense, .. } = &self.axis;
        let commanded_rad = self.design.grid_angle_rad(index) * sense;
        let (min, max) = (axis.to_mm_or_rad(stated_axis.min), axis.to_mm_or_rad(stated_axis.max));
        let turn = std::f64::consts::TAU;
        // Prefer the turn nearest to zero.
        [0.0, -turn, turn]
            .into_iter()
            .map(|shift| commanded_rad + shift)
            .filter(|at| (min - 1e-9..=max + 1e-9).contains(at))
            .min_by(|a, b| a.abs().total_cmp(&b.abs()))
            .ok_or_else(|| {
                MethodRefusal::new(
                    format!(
                        "{axis} cannot reach {:.3}° within [{}, {}]",
                        commanded_rad.to_degrees(),
                        stated_axis.min,
                        stated_axis.max
                    ),
                    format!("this method requires a full revolution of {axis}; correct the limits in [axes]"),
                )
            })
    }
}

/// Kind, label, distances, table angle and feed of a touch, without its contact point and normal.
struct TouchParameters {
    kind: StepKind,
    label: String,
    /// Distance of the start of the touch from the expected contact, outwards.
    standoff_mm: f64,
    /// Length of the touch.
    travel_mm: f64,
    /// Index of the table angle.
    c_index: usize,
    feed_mm_min: f64,
}

/// Distance from the stated axis along the ray at `phi` to the ball centre in contact, with the table turned by
/// `c`. `None` if the ball on this ray does not touch the part. The part's centre is relative to the axis.
fn expected_contact_distance_mm(part: PartGeometry, c: f64, phi: f64) -> Option<f64> {
    let [x, y] = part.centre_mm;
    // In the machine frame the part turns by −c: its centre is at R(−c)·centre.
    let (sin, cos) = (phi + c).sin_cos();
    let (along, across) = (x * cos + y * sin, -x * sin + y * cos);
    let root = part.contact_radius_mm * part.contact_radius_mm - across * across;
    (root > 0.0).then(|| along + root.sqrt())
}
