//! The sensor nest on the table and the sphere in the spindle, from machine and sensors as the plan declares them.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::settings::RTestSettings;
use crate::MethodRefusal;
use machine::frame::{Point, SpindleFrame, TableFrame};
use machine::kinematics::{KinematicChain, ZParallelTableAxis};
use machine::record::plan::Plan;
use machine::record::sensor::{Sensor, SensorMount};
use machine::{Axis, Position};

/// Largest distance between the centre of the nest and the axis, mm: the sphere does not follow a nest that moves
/// around the axis.
const MAX_NEST_AXIS_DISTANCE_MM: f64 = 0.5;
/// Minimum determinant of the directions of three sensors, scaled for more sensors. The determinant is 1 for
/// orthogonal directions.
const MIN_DIRECTION_DETERMINANT: f64 = 0.1;
/// Largest distance between the line of a sensor and the common point, mm.
const MAX_SENSOR_LINE_DISTANCE_MM: f64 = 0.5;

pub struct SensorNest<'a> {
    pub plan: &'a Plan,
    pub settings: &'a RTestSettings,
    pub chain: KinematicChain,
    /// The measured axis.
    pub measured_axis: Axis,
    pub sensors: Vec<&'a Sensor>,
    /// Positions of all axes except the spindle with the sphere in the nest and the measured axis at zero.
    pub origin: Position,
    /// Centre of the sphere at the origin, relative to a point of the nominal axis, machine frame, mm. Only X and Y
    /// are used.
    pub sphere_offset_from_axis_mm: Vector3<f64>,
}

impl<'a> SensorNest<'a> {
    /// # Errors
    /// There is no table axis along Z, there are fewer than three sensors, a sensor is not on the table, or the lines
    /// of the sensors are coplanar or do not meet in one point on the axis.
    pub fn new(plan: &'a Plan, settings: &'a RTestSettings) -> Result<Self, MethodRefusal> {
        let chain = KinematicChain::new(&plan.machine)?;
        let table =
            ZParallelTableAxis::of_machine(&plan.machine, &chain).ok_or_else(MethodRefusal::missing_rotary_table)?;
        let sensors: Vec<&Sensor> = plan.sensors.iter().collect();
        let centre = nest_centre(&sensors, plan.probe.ball_radius_mm)?;
        let tip = Point::<SpindleFrame>::from_vec(Vector3::from(plan.machine.tool_mm));
        let xyz = chain.solve_linear_axes(
            Point::<TableFrame>::from_vec(centre),
            tip,
            &table.position_with_rotary_axes_at_zero,
            &[],
        )?;
        let origin = table.position_with_rotary_axes_at_zero.filter_axes(|axis| axis != Axis::S).updated_by(&xyz);
        let line = chain.axis_line(table.axis, &origin).ok_or_else(MethodRefusal::missing_rotary_table)?;
        let sphere = chain.machine_from_spindle(&origin, &[]).transform_point(&tip.mm.into());
        let sphere_offset_from_axis_mm = sphere.coords - line.point;
        MethodRefusal::require(
            sphere_offset_from_axis_mm.xy().norm() <= MAX_NEST_AXIS_DISTANCE_MM,
            format!(
                "the centre of the sensor nest is {:.2} mm off the axis of {}",
                sphere_offset_from_axis_mm.xy().norm(),
                table.axis
            ),
            "mount the nest in the centre of the table, and correct zero_mm of its sensors",
        )?;
        Ok(Self { plan, settings, chain, measured_axis: table.axis, sensors, origin, sphere_offset_from_axis_mm })
    }

    fn sphere_centre_in_spindle(&self) -> Point<SpindleFrame> {
        Point::from_vec(Vector3::from(self.plan.machine.tool_mm))
    }

    /// Displacement of the sphere's centre from the origin at these axis positions, table frame, mm.
    pub fn sphere_displacement_at(&self, at: &Position) -> Vector3<f64> {
        let tip = self.sphere_centre_in_spindle();
        self.chain.tip_in_table(at, tip, &[]).mm - self.chain.tip_in_table(&self.origin, tip, &[]).mm
    }

    /// Rotation from the table frame to the machine frame with the measured axis at `angle`, rad.
    pub fn machine_from_table(&self, angle: f64) -> Rotation3<f64> {
        let at = self.origin.clone().with(self.measured_axis, angle);
        self.chain.machine_from_table(&at, &[]).rotation
    }

    /// Centre of the sphere with the axes at `origin`, machine frame, mm.
    pub fn sphere_position(&self) -> Vector3<f64> {
        self.chain
            .machine_from_spindle(&self.origin, &[])
            .transform_point(&self.sphere_centre_in_spindle().mm.into())
            .coords
    }

    /// Angle of a stop, rad.
    pub fn stop_angle_rad(&self, stop: usize) -> f64 {
        stop as f64 * std::f64::consts::TAU / self.settings.positions as f64
    }

    /// Index of the stop nearest to `angle`, rad; 360° is stop 0.
    pub fn stop_index(&self, angle: f64) -> usize {
        let positions = self.settings.positions as f64;
        let number = (angle / std::f64::consts::TAU * positions).round();
        number.rem_euclid(positions) as usize
    }
}

/// Common point of all sensor directions, where the sphere is at the zero of each sensor: table frame, mm.
fn nest_centre(sensors: &[&Sensor], radius_mm: f64) -> Result<Vector3<f64>, MethodRefusal> {
    MethodRefusal::require(
        sensors.len() >= 3,
        format!("{} sensors do not measure the displacement of the sphere in X, Y and Z", sensors.len()),
        "describe three [[sensor]] with mount = \"table\"",
    )?;
    if let Some(sensor) = sensors.iter().find(|sensor| sensor.mount != SensorMount::Table) {
        return Err(MethodRefusal::new(
            format!("sensor {} does not turn with the table", sensor.name),
            "state mount = \"table\", or name the sensors of the nest in [method.r-test] sensors",
        ));
    }
    let directions = || sensors.iter().map(|sensor| Vector3::from(sensor.direction));
    let normal: Matrix3<f64> = directions().map(|along| along * along.transpose()).sum();
    let scale = sensors.len() as f64 / 3.0;
    let is_spatial = normal.determinant().sqrt() > MIN_DIRECTION_DETERMINANT * scale.powf(1.5);
    let inverse = normal.try_inverse().filter(|_| is_spatial).ok_or_else(|| {
        MethodRefusal::new(
            "the directions of the sensors are coplanar",
            "correct the directions: they must not lie in one plane; right angles are best",
        )
    })?;
    let along = |sensor: &&Sensor| {
        let direction = Vector3::from(sensor.direction);
        direction * direction.dot(&(Vector3::from(sensor.zero_mm) + direction * radius_mm))
    };
    let centre = inverse * sensors.iter().map(along).sum::<Vector3<f64>>();
    let is_missed = |sensor: &&&Sensor| {
        let direction = Vector3::from(sensor.direction);
        (centre - Vector3::from(sensor.zero_mm)).cross(&direction).norm() > MAX_SENSOR_LINE_DISTANCE_MM
    };
    match sensors.iter().find(is_missed) {
        None => Ok(centre),
        Some(sensor) => Err(MethodRefusal::new(
            format!("the line of sensor {} misses the centre of the sphere", sensor.name),
            "correct zero_mm and direction of the sensor: all lines must meet in one point",
        )),
    }
}
