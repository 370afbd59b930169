//! Where the sensors are about the table's axis, from machine, artefact and sensors as the plan declares
//! them.

use nalgebra::Vector3;

use super::checks;
use super::model::{Channel, Component, ProbeLayout, Surface, TableSense, equal_steps_rad};
use super::settings::Settings;
use crate::Refused;
use machine::frame::unit_vector;
use machine::kinematics::{Chain, TableAxis};
use machine::record::artefact::{Artefact, DatumCylinder};
use machine::record::plan::Plan;
use machine::record::sensor::{Mount, Sensor};
use machine::{Axis, Position};

/// A radial sensor looks past the axis by this at most, mm: farther off its angle changes with the radius.
const MAX_OFF_AXIS_MM: f64 = 0.5;
/// A sensor measures a section from which it is this far at most, mm.
const MAX_OFF_SECTION_MM: f64 = 2.0;
/// Cosine of 1°: as exactly a sensor looks along or across the axis.
const MIN_COSINE: f64 = 0.999_85;

pub struct Setup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a Settings,
    /// The measured axis.
    pub axis: Axis,
    /// All axes at the start of a turn from zero, the measured one left out.
    pub at: Position,
    pub sensors: Vec<&'a Sensor>,
    pub layout: ProbeLayout,
}

impl<'a> Setup<'a> {
    /// # Errors
    /// No table axis along Z; an artefact of another kind; a sensor that does not look at it.
    pub fn new(plan: &'a Plan, settings: &'a Settings) -> Result<Self, Refused> {
        let chain = Chain::new(&plan.machine)?;
        let table = TableAxis::of(&plan.machine, &chain).ok_or_else(no_table)?;
        let cylinder = datum_cylinder(plan)?;
        let at = stands(plan, settings, &table)?;
        let line = chain.axis_line(table.axis, &at).ok_or_else(no_table)?;
        let foot = Vector3::from(cylinder.centre_mm);
        let foot = chain.machine_from_table(&at, &[]).transform_point(&foot.into()).coords;
        let view = View { chain: &chain, at: &at, cylinder, axis_point: line.point, foot };
        let mut placed: Vec<(&Sensor, Seen)> = Vec::new();
        for sensor in &plan.sensors {
            placed.push((sensor, view.seen_by(sensor)?));
        }
        let mut sections: Vec<usize> = placed.iter().filter_map(|(_, seen)| seen.section).collect();
        sections.sort_unstable();
        sections.dedup();
        let channels = placed.iter().map(|(sensor, seen)| seen.channel(sensor, &sections));
        let layout = ProbeLayout {
            channels: channels.collect(),
            section_z_mm: sections.iter().map(|i| foot.z + cylinder.sections[*i].z_mm).collect(),
            reference_z_mm: match sections.as_slice() {
                [only] => foot.z + cylinder.sections[*only].z_mm,
                _ => line.point.z,
            },
            index_angles_rad: equal_steps_rad(settings.indexes),
            sense: if table.turn > 0.0 {
                TableSense::CounterClockwise
            } else {
                TableSense::Clockwise
            },
        };
        let at: Position = at.only(|axis| axis != table.axis);
        Ok(Self {
            plan,
            settings,
            axis: table.axis,
            at,
            sensors: plan.sensors.iter().collect(),
            layout,
        })
    }

    /// What the sensors and indexes do not separate, before anything moves.
    ///
    /// # Errors
    /// The first thing that is lost, with a better layout.
    pub fn check(&self) -> Result<(), Refused> {
        let layout = &self.layout;
        checks::check_surfaces(layout, &layout.all_rows())?;
        checks::check_sensor_angles(layout)?;
        let is_radial =
            |c: &Component| matches!(c, Component::X | Component::Y | Component::A | Component::B);
        let motions: Vec<Component> = layout.components().into_iter().filter(is_radial).collect();
        checks::check_orders(layout, &motions, 2..=self.settings.harmonics)
    }
}

/// Machine frame, mm.
struct View<'a> {
    chain: &'a Chain,
    at: &'a Position,
    cylinder: &'a DatumCylinder,
    /// A point of the table's axis, and the foot of the cylinder.
    axis_point: Vector3<f64>,
    foot: Vector3<f64>,
}

/// What one sensor looks at.
struct Seen {
    /// `None`: the face.
    section: Option<usize>,
    angle_rad: f64,
    /// From the axis to where it looks at the face.
    radius_mm: f64,
}

impl Seen {
    fn channel(&self, sensor: &Sensor, sections: &[usize]) -> Channel {
        let number = |section: usize| sections.iter().position(|own| *own == section);
        let surface = match self.section {
            Some(section) => Surface::Section(number(section).unwrap_or_default()),
            None => Surface::Face { radius_mm: self.radius_mm },
        };
        Channel { name: sensor.name.clone(), surface, angle_rad: self.angle_rad }
    }
}

impl View<'_> {
    fn seen_by(&self, sensor: &Sensor) -> Result<Seen, Refused> {
        let refuse = |why: String, instead: &str| {
            Err(Refused {
                why: format!("sensor {}: {why}", sensor.name),
                instead: instead.to_owned(),
            })
        };
        let pose = match sensor.mount {
            Mount::Spindle => Some(self.chain.machine_from_spindle(self.at, &[])),
            Mount::Bed => None,
            Mount::Table => {
                return refuse(
                    "it turns with the table that it is to measure".to_owned(),
                    "mount it on the bed or the spindle, and state mount = \"bed\" or \"spindle\"",
                );
            }
        };
        let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
        let zero = pose.map_or(zero, |pose| pose.transform_point(&zero.into()).coords);
        let along = pose.map_or(along, |pose| pose.transform_vector(&along));
        let from_axis = zero - self.axis_point;
        if along.z < -MIN_COSINE && self.cylinder.face.is_some() {
            let angle_rad = from_axis.y.atan2(from_axis.x);
            return Ok(Seen { section: None, angle_rad, radius_mm: from_axis.xy().norm() });
        }
        let Some(across) = unit_vector(along).filter(|along| along.z.abs() < 0.02) else {
            return refuse(
                "it looks neither across the axis nor down on the face".to_owned(),
                "correct its direction, or state the face of the [artefact]",
            );
        };
        let past_mm = (from_axis.x * across.y - from_axis.y * across.x).abs();
        if past_mm > MAX_OFF_AXIS_MM || from_axis.dot(&across) > 0.0 {
            return refuse(
                format!("it looks past the table's axis by {past_mm:.2} mm, or away from it"),
                "correct zero_mm and direction: a radial sensor looks at the axis",
            );
        }
        let height = zero.z - self.foot.z;
        let off = |section: usize| (self.cylinder.sections[section].z_mm - height).abs();
        let sections = 0..self.cylinder.sections.len();
        let nearest = sections.min_by(|a, b| off(*a).total_cmp(&off(*b)));
        match nearest.filter(|section| off(*section) <= MAX_OFF_SECTION_MM) {
            Some(section) => {
                let angle_rad = (-across.y).atan2(-across.x);
                Ok(Seen { section: Some(section), angle_rad, radius_mm: 0.0 })
            }
            None => refuse(
                format!("it is {height:.1} mm above the foot of the cylinder, where no section is"),
                "correct zero_mm, `at`, or the z_mm of [artefact] sections",
            ),
        }
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
        Artefact::DatumCylinder(_) => Err(Refused {
            why: "the axis of the datum cylinder is not along Z".to_owned(),
            instead: "state axis = [0.0, 0.0, 1.0] of the [artefact]".to_owned(),
        }),
        _ => Err(Refused {
            why: "this method measures a datum cylinder; [artefact] states another kind".to_owned(),
            instead: "describe it with kind = \"datum_cylinder\"".to_owned(),
        }),
    }
}

/// Where the axes are, the measured one at zero.
fn stands(plan: &Plan, settings: &Settings, table: &TableAxis) -> Result<Position, Refused> {
    let stray = settings.at.iter().find(|(axis, _)| *axis == table.axis);
    let linear = plan.machine.axes.keys().filter(|axis| axis.is_linear());
    let missing = linear.into_iter().find(|axis| settings.at.get(**axis).is_none());
    match (stray, missing) {
        (Some((axis, _)), _) => Err(Refused {
            why: format!("`at` names {axis}, the axis that is measured"),
            instead: format!("take {axis} out of `at`"),
        }),
        (None, Some(axis)) => Err(Refused {
            why: format!("`at` does not name {axis}"),
            instead: format!(
                "move the machine to where the sensors look at the sections, and state {axis} of the \
                 display in [method.{}] at",
                super::NAME
            ),
        }),
        (None, None) => {
            let zero = table.zero.only(|axis| axis != Axis::S);
            Ok(zero.updated_by(&settings.at))
        }
    }
}

fn no_table() -> Refused {
    Refused {
        why: "no rotary axis that carries the workpiece is along Z with all others at zero"
            .to_owned(),
        instead: "state it on the workpiece side of the topology (w-C-…) and as [axes.C]"
            .to_owned(),
    }
}
