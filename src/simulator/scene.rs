//! The scene: the machine with its errors, probe and artefact, and the distance between ball and surface. It is
//! exact: the pose with every error, and the nearest point of the true surface.

mod testing;

use std::borrow::Cow;

use nalgebra::Vector3;

use super::SimulatedWorldError;
use super::linear_errors::{LinearAxisRotationErrors, LinearErrors};
use super::machine_pose::MachinePose;
use super::random_draws::{self, ProbeLobing, ThermalDrift};
use super::rotary_errors::RotaryErrors;
use super::sag::TableSag;
use super::sensor_view::{MeasuredObject, SensorView};
use super::surface::ArtefactSurface;
use super::truth::MachineTruth;
use machine::kinematics::{ErrorTerm, KinematicChain};
use machine::record::artefact::Artefact;
use machine::record::machine::{Machine, Probe, StatedAxis};
use machine::{Axis, Position, frame::Pose};

/// The simulated machine with its errors, probe and artefact.
#[derive(Debug, Clone)]
pub(super) struct TrueScene {
    chain: KinematicChain,
    /// True errors that `[simulated]` states (`errors` and `error_motion`), not those of the machine file.
    true_error_terms: Vec<ErrorTerm>,
    linear_errors: LinearErrors,
    angular_errors: LinearAxisRotationErrors,
    /// Drawn error motions; one axis may have several entries.
    rotary_errors: Vec<RotaryErrors>,
    drift: ThermalDrift,
    /// Stylus-ball centre that the machine file states, spindle frame.
    stated_stylus_centre: Vector3<f64>,
    /// True stylus-ball centre, spindle frame.
    true_stylus_centre: Vector3<f64>,
    /// Radius of the stylus ball, true as stated, mm.
    stylus_ball_radius: f64,
    lobing: ProbeLobing,
    pub surface: ArtefactSurface,
    table_sag: TableSag,
    /// Upper bound of the distance of a rotary axis from the machine's origin.
    max_rotary_axis_distance_from_origin_mm: f64,
}

impl TrueScene {
    pub fn new(
        machine: &Machine,
        probe: &Probe,
        artefact: &Artefact,
        truth: &MachineTruth,
    ) -> Result<Self, SimulatedWorldError> {
        let seed = truth.seed;
        let chain = KinematicChain::new(machine)?;
        let errors = truth.error_terms()?;
        errors.iter().try_for_each(|term| chain.check_parameter_axis(term.parameter))?;
        let travel = |axis| machine.axes.get(&axis).map_or(0.0, |s| s.max.abs().max(s.min.abs()));
        let motions = linear_axis_sigmas_and_lengths(machine, |spec| spec.error_motion_um * 1e-3);
        let linear_errors = LinearErrors::draw(seed, motions).tabulated_within(Axis::LINEAR.map(travel));
        let linear_errors = linear_errors.with_squareness_errors(seed, machine.squareness_urad * 1e-6);
        let rotations = linear_axis_sigmas_and_lengths(machine, |spec| spec.angular_motion_urad * 1e-6);
        let stated_stylus = Vector3::from(machine.tool_mm);
        Ok(Self {
            chain,
            true_error_terms: errors,
            linear_errors,
            angular_errors: LinearAxisRotationErrors::draw(seed, rotations),
            rotary_errors: draw_rotary_errors(machine, truth)?,
            drift: ThermalDrift::draw(seed, machine.drift_um_per_h),
            stated_stylus_centre: stated_stylus,
            true_stylus_centre: stated_stylus
                + Vector3::from(truth.tool_offset_um) * 1e-3
                + random_draws::draw_stylus_offset(seed, probe.u_stylus_offset_um * 1e-3),
            stylus_ball_radius: probe.ball_radius_mm,
            lobing: ProbeLobing::draw(seed, probe.lobing_um * 1e-3, &probe.lobing_orders),
            surface: ArtefactSurface::new(artefact, truth)?,
            table_sag: TableSag::new(&truth.sag),
            max_rotary_axis_distance_from_origin_mm: max_rotary_axis_distance_from_origin_mm(machine),
        })
    }

    /// Axes of the machine, including the spindle where it can be oriented.
    pub fn axes(&self) -> impl Iterator<Item = Axis> + '_ {
        self.chain.topology().axes()
    }

    /// Distance between ball and surface (negative: overlap), mm. `axes`: true axis positions, backlash
    /// included; `command`: commanded positions.
    pub fn stylus_clearance(&self, axes: &Position, command: &Position, t_s: f64) -> f64 {
        self.clearance_and_normal(axes, command, t_s).0
    }

    /// Clearance plus pre-travel: the probe triggers where this sum falls to zero.
    pub fn trigger_distance(&self, axes: &Position, command: &Position, t_s: f64) -> f64 {
        let (distance, normal) = self.clearance_and_normal(axes, command, t_s);
        distance + self.lobing.pre_travel_mm(normal)
    }

    /// Upper bound of the distance of the stylus ball from the axis `axis` (its travel per radian), with the linear
    /// axes at `position` and the rotary axes anywhere.
    pub fn max_stylus_distance_from_axis(&self, axis: Axis, position: &Position) -> f64 {
        if axis == Axis::S {
            return self.true_stylus_centre.x.hypot(self.true_stylus_centre.y);
        }
        position.xyz_or_zero().norm() + self.true_stylus_centre.norm() + self.max_rotary_axis_distance_from_origin_mm
    }

    /// Distance between stylus ball and surface, mm (negative: overlap), and outward normal of the surface, spindle
    /// frame.
    fn clearance_and_normal(&self, axes: &Position, command: &Position, t_s: f64) -> (f64, Vector3<f64>) {
        let SensorView { carrier_and_table: pose, radius_growth_mm: growth, .. } =
            self.view_from_spindle(axes, command, t_s);
        let nearest = self.surface.nearest(pose.carrier_to_table_point(self.true_stylus_centre), growth, t_s);
        (nearest.signed_distance - self.stylus_ball_radius, pose.table_to_carrier_direction(nearest.outward_normal))
    }

    /// The scene as seen from the spindle; `axes` and `command` as for [`TrueScene::stylus_clearance`].
    pub fn view_from_spindle(&self, axes: &Position, command: &Position, t_s: f64) -> SensorView<'_> {
        let errors = self.error_terms_at(axes, Some(t_s));
        let spindle = self.chain.machine_from_spindle(axes, &errors);
        let shift = self.linear_errors.deviation_at(command.xyz_or_zero().into());
        self.view_from(spindle, shift, axes, t_s)
    }

    /// The scene as seen from the bed; it has no errors of the linear axes, which act between spindle and bed.
    pub fn view_from_bed(&self, axes: &Position, t_s: f64) -> SensorView<'_> {
        self.view_from(Pose::identity(), Vector3::zeros(), axes, t_s)
    }

    /// The sphere in the spindle, as seen from a sensor on the table.
    pub fn view_from_table(&self, axes: &Position, command: &Position, t_s: f64) -> SensorView<'_> {
        let view = self.view_from_spindle(axes, command, t_s);
        let target = MeasuredObject::SpindleSphere {
            centre: view.carrier_and_table.carrier_to_table_point(self.true_stylus_centre),
            radius: self.stylus_ball_radius,
        };
        let table = view.carrier_and_table.table_pose;
        let pose = MachinePose { table_pose: table, carrier_pose: table, carrier_shift: Vector3::zeros() };
        SensorView { carrier_and_table: pose, measured_object: target, ..view }
    }

    /// The scene as seen from `carrier`, which is displaced by `shift` and by the drift against the table.
    fn view_from(&self, carrier: Pose, shift: Vector3<f64>, axes: &Position, t_s: f64) -> SensorView<'_> {
        let errors = self.error_terms_at(axes, Some(t_s));
        let pose = MachinePose {
            table_pose: self.table_sag.deflected_table_pose(self.chain.machine_from_table(axes, &errors), axes),
            carrier_pose: carrier,
            carrier_shift: shift - self.drift.table_displacement_mm(t_s),
        };
        let target = MeasuredObject::Artefact(&self.surface);
        SensorView {
            carrier_and_table: pose,
            measured_object: target,
            radius_growth_mm: self.drift.artefact_radius_growth_mm(t_s),
            world_time_s: t_s,
        }
    }

    /// Stated errors, error motions of the rotary axes at this position, and rotations of the linear axes.
    /// Without a time: without asynchronous motions.
    fn error_terms_at(&self, axes: &Position, t_s: Option<f64>) -> Cow<'_, [ErrorTerm]> {
        if self.rotary_errors.is_empty() && self.angular_errors.is_empty() {
            return Cow::Borrowed(&self.true_error_terms);
        }
        let drawn = self.rotary_errors.iter().flat_map(|errors| errors.synchronous_errors(axes));
        let at_time = |t_s| self.rotary_errors.iter().flat_map(move |e| e.asynchronous_errors(axes, t_s));
        let asynchronous = t_s.into_iter().flat_map(at_time);
        let angular = self.angular_errors.error_terms_at(axes);
        self.true_error_terms.iter().copied().chain(drawn).chain(asynchronous).chain(angular).collect()
    }
}

/// Of each linear axis: standard deviation of an error, and its correlation length, mm.
fn linear_axis_sigmas_and_lengths(machine: &Machine, sigma: impl Fn(&StatedAxis) -> f64) -> [[f64; 2]; 3] {
    Axis::LINEAR.map(|axis| machine.axes.get(&axis).map_or([0.0, 1.0], |spec| [sigma(spec), spec.error_wavelength_mm]))
}

fn draw_rotary_errors(machine: &Machine, truth: &MachineTruth) -> Result<Vec<RotaryErrors>, SimulatedWorldError> {
    let mut rotary_errors = Vec::new();
    for (axis, spec) in &machine.axes {
        if !axis.is_linear() && spec.error_motion_um != 0.0 {
            let (size_mm, orders) = (spec.error_motion_um * 1e-3, &spec.error_motion_orders);
            rotary_errors.push(RotaryErrors::draw(truth.seed, *axis, size_mm, orders)?);
        }
    }
    for motion in &truth.rotary_motion {
        if !(motion.is_valid() && machine.axes.contains_key(&motion.axis)) {
            return Err(SimulatedWorldError::InvalidNumber);
        }
        rotary_errors.push(RotaryErrors::from_declaration(truth.seed, motion)?);
    }
    Ok(rotary_errors)
}

/// Largest distance of a stated point of a rotary axis from the machine's origin.
fn max_rotary_axis_distance_from_origin_mm(machine: &Machine) -> f64 {
    machine
        .axes
        .iter()
        .filter(|(axis, _)| !axis.is_linear())
        .map(|(_, spec)| Vector3::from(spec.point_mm).norm())
        .fold(0.0, f64::max)
}
