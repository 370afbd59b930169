//! Positions of the sensors relative to the table's axis, from machine, artefact and sensors as the plan declares
//! them.

use super::checks;
use super::model::{Channel, Component, ProbeLayout, Surface, equal_steps_rad};
use super::settings::Settings;
use crate::Refused;
use machine::artefact::{CylinderOnTable, ObservedSurface};
use machine::kinematics::{Chain, TableAxis};
use machine::record::artefact::{Artefact, DatumCylinder};
use machine::record::plan::Plan;
use machine::record::sensor::Sensor;
use machine::{Axis, Position};

pub struct Setup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a Settings,
    /// The measured axis.
    pub axis: Axis,
    /// Positions of all axes except the measured one at the start of a turn.
    pub at: Position,
    pub layout: ProbeLayout,
    /// Point at which X and Y are given, machine frame, mm.
    pub reference_mm: [f64; 3],
}

impl<'a> Setup<'a> {
    /// # Errors
    /// There is no table axis along Z, the artefact is of another kind, or a sensor does not point at the artefact.
    pub fn new(plan: &'a Plan, settings: &'a Settings) -> Result<Self, Refused> {
        let chain = Chain::new(&plan.machine)?;
        let table = TableAxis::of(&plan.machine, &chain).ok_or_else(Refused::no_table)?;
        let cylinder = datum_cylinder(plan)?;
        let at = stands(plan, settings, &table)?;
        let line = chain.axis_line(table.axis, &at).ok_or_else(Refused::no_table)?;
        let on_table = CylinderOnTable { chain: &chain, at: &at, cylinder, axis: &line };
        let foot = on_table.foot();
        let observed = |sensor: &'a Sensor| {
            let surface = on_table.observed(sensor).map_err(|error| {
                Refused::new(format!("sensor {}: {error}", sensor.name), error.remedy())
            })?;
            Ok((sensor, surface))
        };
        let placed = plan.sensors.iter().map(observed).collect::<Result<Vec<_>, Refused>>()?;
        let mut sections: Vec<usize> =
            placed.iter().filter_map(|(_, surface)| surface.section).collect();
        sections.sort_unstable();
        sections.dedup();
        let channels = placed.iter().map(|(sensor, surface)| channel(sensor, surface, &sections));
        let layout = ProbeLayout {
            channels: channels.collect(),
            section_z_mm: sections.iter().map(|i| foot.z + cylinder.sections[*i].z_mm).collect(),
            reference_z_mm: match sections.as_slice() {
                [only] => foot.z + cylinder.sections[*only].z_mm,
                _ => line.point.z,
            },
            index_angles_rad: equal_steps_rad(settings.indexes),
            axis: table.axis,
            turn: table.turn,
        };
        let at: Position = at.only(|axis| axis != table.axis);
        let reference_mm = [line.point.x, line.point.y, layout.reference_z_mm];
        Ok(Self { plan, settings, axis: table.axis, at, layout, reference_mm })
    }

    /// Checks before motion what the sensors and indexes do not separate.
    ///
    /// # Errors
    /// The first undetermined quantity, with a better layout.
    pub fn check(&self) -> Result<(), Refused> {
        let layout = &self.layout;
        checks::check_surfaces(layout)?;
        checks::check_sensor_angles(layout, &self.settings.exclusions())?;
        let is_radial =
            |c: &Component| matches!(c, Component::X | Component::Y | Component::A | Component::B);
        let motions: Vec<Component> = layout.components().into_iter().filter(is_radial).collect();
        checks::check_orders(layout, &motions, 2..=self.settings.harmonics)
    }
}

fn channel(sensor: &Sensor, surface: &ObservedSurface, sections: &[usize]) -> Channel {
    let number = |section: usize| sections.iter().position(|own| *own == section);
    Channel {
        name: sensor.name.clone(),
        angle_rad: surface.angle_rad,
        surface: match surface.section {
            Some(section) => Surface::Section(number(section).unwrap_or_default()),
            None => Surface::Face { radius_mm: surface.radius_mm },
        },
    }
}

fn datum_cylinder(plan: &Plan) -> Result<&DatumCylinder, Refused> {
    match &plan.artefact {
        Artefact::DatumCylinder(cylinder)
            if cylinder.axis[2] > 0.0
                && cylinder.axis[0].hypot(cylinder.axis[1]) < 0.01 * cylinder.axis[2] =>
        {
            Ok(cylinder)
        }
        Artefact::DatumCylinder(_) => Err(Refused::new(
            "the axis of the datum cylinder is not along Z",
            "state axis = [0.0, 0.0, 1.0] of the [artefact]",
        )),
        _ => Err(Refused::new(
            "this method measures a datum cylinder; [artefact] states another kind",
            "describe it with kind = \"datum_cylinder\"",
        )),
    }
}

/// Positions of the axes with the measured one at zero.
fn stands(plan: &Plan, settings: &Settings, table: &TableAxis) -> Result<Position, Refused> {
    let axis = table.axis;
    Refused::unless(
        settings.at.get(axis).is_none(),
        format!("`at` names {axis}, the axis that is measured"),
        format!("take {axis} out of `at`"),
    )?;
    let linear = plan.machine.axes.keys().filter(|axis| axis.is_linear());
    let missing = linear.into_iter().find(|axis| settings.at.get(**axis).is_none());
    if let Some(axis) = missing {
        let instead = format!(
            "move the machine to where the sensors look at the sections, and state {axis} of the display in \
             [method.{}] at",
            super::NAME
        );
        return Err(Refused::new(format!("`at` does not name {axis}"), instead));
    }
    Ok(table.zero.only(|axis| axis != Axis::S).updated_by(&settings.at))
}
