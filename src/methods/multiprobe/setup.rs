//! Positions of the sensors relative to the table's axis, from machine, artefact and sensors as the plan declares
//! them.

use super::layout_checks;
use super::model::{MeasuredSurface, MotionOrForm, ProbeLayout, SensorChannel, equal_index_angles_rad};
use super::settings::MultiprobeSettings;
use crate::MethodRefusal;
use machine::artefact::{ObservedCylinder, ObservedSurface};
use machine::kinematics::{KinematicChain, ZParallelTableAxis};
use machine::record::artefact::{Artefact, DatumCylinder};
use machine::record::plan::Plan;
use machine::record::sensor::Sensor;
use machine::{Axis, Position};

pub struct MultiprobeSetup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a MultiprobeSettings,
    /// The measured axis: of the rotary axes of the table that are along Z, the one nearest to the workpiece.
    pub measured_axis: Axis,
    /// Positions of all axes except the measured one and the spindle during a turn.
    pub other_axis_positions: Position,
    pub layout: ProbeLayout,
    /// Point at which X and Y are given, machine frame, mm.
    pub reference_point_mm: [f64; 3],
}

impl<'a> MultiprobeSetup<'a> {
    /// # Errors
    /// There is no table axis along Z, the artefact is of another kind, `at` lacks a linear axis or contains the
    /// measured axis, or a sensor does not point at the artefact.
    pub fn new(plan: &'a Plan, settings: &'a MultiprobeSettings) -> Result<Self, MethodRefusal> {
        let chain = KinematicChain::new(&plan.machine)?;
        let table =
            ZParallelTableAxis::of_machine(&plan.machine, &chain).ok_or_else(MethodRefusal::missing_rotary_table)?;
        let cylinder = find_datum_cylinder(plan)?;
        let at = position_with_measured_axis_at_zero(plan, settings, &table)?;
        let line = chain.axis_line(table.axis, &at).ok_or_else(MethodRefusal::missing_rotary_table)?;
        let on_table = ObservedCylinder { chain: &chain, position: &at, cylinder, table_axis: &line };
        let foot = on_table.foot_position();
        let observed = |sensor: &'a Sensor| {
            let surface = on_table
                .observed_surface(sensor)
                .map_err(|error| MethodRefusal::new(format!("sensor {}: {error}", sensor.name), error.remedy()))?;
            Ok((sensor, surface))
        };
        let surfaces = plan.sensors.iter().map(observed).collect::<Result<Vec<_>, MethodRefusal>>()?;
        let mut sections: Vec<usize> = surfaces.iter().filter_map(|(_, surface)| surface.section_index).collect();
        sections.sort_unstable();
        sections.dedup();
        let channels = surfaces.iter().map(|(sensor, surface)| sensor_channel(sensor, surface, &sections));
        let layout = ProbeLayout {
            channels: channels.collect(),
            section_z_mm: sections.iter().map(|i| foot.z + cylinder.sections[*i].z_mm).collect(),
            reference_z_mm: match sections.as_slice() {
                [section] => foot.z + cylinder.sections[*section].z_mm,
                _ => line.point.z,
            },
            index_angles_rad: equal_index_angles_rad(settings.indexes),
            measured_axis: table.axis,
            turn_sign: table.turn_sign,
        };
        let start_position = at.filter_axes(|axis| axis != table.axis);
        let reference_mm = [line.point.x, line.point.y, layout.reference_z_mm];
        Ok(Self {
            plan,
            settings,
            measured_axis: table.axis,
            other_axis_positions: start_position,
            layout,
            reference_point_mm: reference_mm,
        })
    }

    /// Checks before motion that the sensors and indexes separate the radial and tilt motions from the form of the
    /// artefact. Harmonics of the axial motion may remain undetermined.
    ///
    /// # Errors
    /// The first undetermined quantity, with a better layout.
    pub fn check_separability(&self) -> Result<(), MethodRefusal> {
        let layout = &self.layout;
        layout_checks::check_surfaces(layout)?;
        layout_checks::check_no_coinciding_sensors(layout, &self.settings.obstructed_ranges())?;
        let is_radial =
            |c: &MotionOrForm| matches!(c, MotionOrForm::X | MotionOrForm::Y | MotionOrForm::A | MotionOrForm::B);
        let motions: Vec<MotionOrForm> = layout.components().into_iter().filter(is_radial).collect();
        layout_checks::check_harmonic_orders(layout, &motions, 2..=self.settings.harmonics)
    }
}

/// `sections`: declared indices of the measured sections; the channel gets the position in this list.
fn sensor_channel(sensor: &Sensor, surface: &ObservedSurface, sections: &[usize]) -> SensorChannel {
    let number = |section: usize| sections.iter().position(|own| *own == section);
    SensorChannel {
        name: sensor.name.clone(),
        angle_rad: surface.sensor_angle_rad,
        surface: match surface.section_index {
            Some(section) => MeasuredSurface::Section(number(section).unwrap_or_default()),
            None => MeasuredSurface::Face { radius_mm: surface.face_point_radius_mm },
        },
    }
}

/// Error: another kind of artefact, or an axis of the cylinder that deviates from +Z by a slope of 0.01 or more.
fn find_datum_cylinder(plan: &Plan) -> Result<&DatumCylinder, MethodRefusal> {
    match &plan.artefact {
        Artefact::DatumCylinder(cylinder)
            if cylinder.axis[2] > 0.0 && cylinder.axis[0].hypot(cylinder.axis[1]) < 0.01 * cylinder.axis[2] =>
        {
            Ok(cylinder)
        }
        Artefact::DatumCylinder(_) => Err(MethodRefusal::new(
            "the axis of the datum cylinder is not along Z",
            "state axis = [0.0, 0.0, 1.0] in [artefact]",
        )),
        _ => Err(MethodRefusal::new(
            "this method measures a datum cylinder; [artefact] states another kind",
            "describe the artefact with kind = \"datum_cylinder\"",
        )),
    }
}

/// Positions of `at`, with the measured axis and all rotary axes that `at` does not contain at zero, without the
/// spindle.
fn position_with_measured_axis_at_zero(
    plan: &Plan,
    settings: &MultiprobeSettings,
    table: &ZParallelTableAxis,
) -> Result<Position, MethodRefusal> {
    let axis = table.axis;
    MethodRefusal::require(
        settings.linear_axis_positions.get(axis).is_none(),
        format!("`at` contains {axis}, the measured axis"),
        format!("remove {axis} from `at`"),
    )?;
    let is_missing = |axis: &&Axis| axis.is_linear() && settings.linear_axis_positions.get(**axis).is_none();
    if let Some(axis) = plan.machine.axes.keys().find(is_missing) {
        let instead = format!(
            "move the machine until the sensors point at the sections, and state the displayed \
             {axis} in [method.{}] at",
            super::METHOD_NAME
        );
        return Err(MethodRefusal::new(format!("`at` does not contain {axis}"), instead));
    }
    Ok(table
        .position_with_rotary_axes_at_zero
        .filter_axes(|axis| axis != Axis::S)
        .updated_by(&settings.linear_axis_positions))
}
