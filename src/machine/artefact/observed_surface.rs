//! Where the beam of a displacement sensor meets a datum cylinder: at which section, or on the face, and at which
//! angle. Machine frame, mm.

use nalgebra::Vector3;

use crate::Position;
use crate::frame::unit_vector;
use crate::kinematics::{AxisLine, KinematicChain};
use crate::record::artefact::DatumCylinder;
use crate::record::sensor::{Sensor, SensorMount};

/// Maximum distance between the line of a radial sensor and the axis, mm: with a larger distance, the sensor's
/// angle would change with the radius.
const MAX_BEAM_AXIS_OFFSET_MM: f64 = 0.5;
/// Maximum distance of a sensor from the section that it measures, along the axis, mm.
const MAX_BEAM_SECTION_OFFSET_MM: f64 = 2.0;
/// Minimum cosine of the angle between an axial sensor and the axis (1°).
const MIN_AXIAL_BEAM_AXIS_COSINE: f64 = 0.999_85;
/// Maximum cosine of the angle between a radial sensor and the axis.
const MAX_RADIAL_BEAM_AXIS_COSINE: f64 = 0.02;

/// Surface point that one sensor measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservedSurface {
    /// Index of the cross section in `DatumCylinder::sections`; `None` for the face.
    pub section_index: Option<usize>,
    /// Direction from the axis to the sensor, counter-clockwise from +X, rad.
    pub sensor_angle_rad: f64,
    /// Distance of the measured point on the face from the axis, mm; 0 for a cross section.
    pub face_point_radius_mm: f64,
}

/// Error: the sensor measures no surface of the cylinder.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ObservedSurfaceError {
    #[error("the sensor turns with the table that it must measure")]
    SensorTurnsWithTable,
    #[error("the beam is neither perpendicular to the axis nor directed down at the face")]
    BeamNeitherRadialNorAxial,
    #[error("the beam misses the axis of the table by {offset_mm:.2} mm, or points away from the axis")]
    MissesAxis { offset_mm: f64 },
    #[error("the beam misses the face: it is {radius_mm:.1} mm from the axis")]
    MissesFace { radius_mm: f64 },
    #[error("the beam is {height_mm:.1} mm above the foot of the cylinder; no section is at this height")]
    NoSection { height_mm: f64 },
}

impl ObservedSurfaceError {
    /// What the operator should correct.
    pub fn remedy(&self) -> &'static str {
        match self {
            ObservedSurfaceError::SensorTurnsWithTable => {
                "mount the sensor on the bed or the spindle, and set mount = \"bed\" or \"spindle\""
            }
            Self::BeamNeitherRadialNorAxial => "correct direction of the sensor, or declare the face of the [artefact]",
            Self::MissesAxis { .. } => "correct zero_mm and direction: the beam of a radial sensor must meet the axis",
            Self::MissesFace { .. } => "correct zero_mm of the sensor, or radius_mm of the [artefact] face",
            Self::NoSection { .. } => "correct zero_mm, `at`, or the z_mm of [artefact] sections",
        }
    }
}

/// A datum cylinder on a rotary table that turns about Z, at one position of the machine.
pub struct ObservedCylinder<'a> {
    pub chain: &'a KinematicChain,
    pub position: &'a Position,
    pub cylinder: &'a DatumCylinder,
    /// Axis of the table.
    pub table_axis: &'a AxisLine,
}

impl ObservedCylinder<'_> {
    /// Foot of the cylinder, machine frame, mm.
    pub fn foot_position(&self) -> Vector3<f64> {
        let foot = Vector3::from(self.cylinder.foot_mm);
        self.chain.machine_from_table(self.position, &[]).transform_point(&foot.into()).coords
    }

    /// Surface point that `sensor` measures.
    ///
    /// # Errors
    /// The sensor measures neither the face nor a section, or turns with the table.
    pub fn observed_surface(&self, sensor: &Sensor) -> Result<ObservedSurface, ObservedSurfaceError> {
        let pose = match sensor.mount {
            SensorMount::Spindle => Some(self.chain.machine_from_spindle(self.position, &[])),
            SensorMount::Bed => None,
            SensorMount::Table => return Err(ObservedSurfaceError::SensorTurnsWithTable),
        };
        let [zero, along] = [sensor.zero_mm, sensor.direction].map(Vector3::from);
        let zero = pose.map_or(zero, |pose| pose.transform_point(&zero.into()).coords);
        let along = pose.map_or(along, |pose| pose.transform_vector(&along));
        let from_axis = zero - self.table_axis.point;
        if let Some(face) = self.cylinder.face.filter(|_| along.z < -MIN_AXIAL_BEAM_AXIS_COSINE) {
            let (angle_rad, radius_mm) = (from_axis.y.atan2(from_axis.x), from_axis.xy().norm());
            if radius_mm > face.radius_mm {
                return Err(ObservedSurfaceError::MissesFace { radius_mm });
            }
            return Ok(ObservedSurface {
                section_index: None,
                sensor_angle_rad: angle_rad,
                face_point_radius_mm: radius_mm,
            });
        }
        let across = unit_vector(along).filter(|along| along.z.abs() < MAX_RADIAL_BEAM_AXIS_COSINE);
        let across = across.ok_or(ObservedSurfaceError::BeamNeitherRadialNorAxial)?;
        let offset_mm = (from_axis.x * across.y - from_axis.y * across.x).abs();
        if offset_mm > MAX_BEAM_AXIS_OFFSET_MM || from_axis.dot(&across) > 0.0 {
            return Err(ObservedSurfaceError::MissesAxis { offset_mm });
        }
        let section = Some(self.section_index_at(zero.z - self.foot_position().z)?);
        let angle_rad = (-across.y).atan2(-across.x);
        Ok(ObservedSurface { section_index: section, sensor_angle_rad: angle_rad, face_point_radius_mm: 0.0 })
    }

    /// Index of the cross section nearest to `height_mm` above the foot, within `MAX_BEAM_SECTION_OFFSET_MM`.
    fn section_index_at(&self, height_mm: f64) -> Result<usize, ObservedSurfaceError> {
        let distance_to_section = |section: usize| (self.cylinder.sections[section].z_mm - height_mm).abs();
        let sections = 0..self.cylinder.sections.len();
        let nearest = sections.min_by(|a, b| distance_to_section(*a).total_cmp(&distance_to_section(*b)));
        nearest
            .filter(|section| distance_to_section(*section) <= MAX_BEAM_SECTION_OFFSET_MM)
            .ok_or(ObservedSurfaceError::NoSection { height_mm })
    }
}
