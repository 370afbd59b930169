//! Sensor in the spindle, sphere on the table, and positions of the rotary axes.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::parameter_selection::table_rotary_axes;
use super::settings::{LaserRTestSettings, MeasuringDevice};
use crate::MethodRefusal;
use crate::ball_measurement::tilts_table;
use machine::frame::unit_vector;
use machine::kinematics::KinematicChain;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::Plan;
use machine::record::sensor::{MeasuredQuantity, Sensor, SensorMount};
use machine::{Axis, Position};

const DEFAULT_TILT_DEG: [f64; 7] = [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0];
const DEFAULT_TURN_DEG: [f64; 6] = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0];
/// Tolerance of an axis limit, degrees.
const AXIS_LIMIT_TOLERANCE_DEG: f64 = 1e-9;

/// A plan with the sensor, the sphere and the kinematic chain that this method uses.
pub struct LaserSetup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a LaserRTestSettings,
    pub chain: KinematicChain,
    /// Sensor that measures the sphere. For the touch probe it is a stand-in whose zero point is the stylus centre.
    pub sensor: Sensor,
    pub balls: &'a Balls,
    /// The sphere to be measured.
    pub ball: &'a Ball,
}

impl<'a> LaserSetup<'a> {
    /// # Errors
    /// A setting is invalid, there is no sensor or no sphere, or the kinematics of the machine cannot be built.
    pub fn new(plan: &'a Plan, settings: &'a LaserRTestSettings) -> Result<Self, MethodRefusal> {
        settings.check()?;
        let chain = KinematicChain::new(&plan.machine)?;
        let (balls, ball) = find_ball(plan, settings)?;
        let sensor = match settings.by {
            MeasuringDevice::Laser => select_sensor(&plan.sensors, settings)?.clone(),
            MeasuringDevice::Probe => stylus_as_sensor(plan),
        };
        Ok(Self { plan, settings, chain, sensor, balls, ball })
    }

    /// Stated zero point of the sensor, spindle frame, mm.
    pub fn zero_point(&self) -> Vector3<f64> {
        Vector3::from(self.sensor.zero_mm)
    }

    /// Nominal direction of increasing readings, spindle frame.
    pub fn beam_direction(&self) -> Vector3<f64> {
        unit_vector(Vector3::from(self.sensor.direction)).unwrap_or_default()
    }

    /// Stated centre of the sphere, table frame, mm.
    pub fn ball_centre(&self) -> Vector3<f64> {
        Vector3::from(self.ball.centre_mm)
    }

    /// Rotation from the spindle frame to the machine frame.
    pub fn machine_from_spindle(&self, rotary: &Position) -> Rotation3<f64> {
        self.chain.machine_from_spindle(rotary, &[]).rotation
    }

    /// Matrix from X, Y, Z to the displacement of the spindle relative to the table, machine frame.
    pub fn machine_from_xyz(&self, rotary: &Position) -> Matrix3<f64> {
        let table = self.chain.machine_from_table(rotary, &[]).rotation;
        table * self.chain.linear_axes_jacobian(rotary, &[])
    }

    /// Matrix from a displacement of the spindle relative to the table, machine frame, to X, Y, Z: the inverse of
    /// [`LaserSetup::machine_from_xyz`].
    ///
    /// # Errors
    /// The linear axes do not span space at these positions.
    pub fn xyz_from_machine(&self, rotary: &Position) -> Result<Matrix3<f64>, MethodRefusal> {
        let table = self.chain.machine_from_table(rotary, &[]).rotation;
        let from_table = self.chain.inverse_linear_axes_jacobian(rotary, &[])?;
        Ok(from_table * table.inverse())
    }

    pub fn uses_touch_probe(&self) -> bool {
        self.settings.by == MeasuringDevice::Probe
    }

    /// Distance from the sphere's centre to the measured point, mm: for a touch, to the stylus centre.
    pub fn measuring_radius_mm(&self) -> f64 {
        let stylus = if self.uses_touch_probe() { self.plan.probe.ball_radius_mm } else { 0.0 };
        self.ball.radius_mm + stylus
    }

    /// Incidence limit of the sensor, rad.
    pub fn incidence_limit_rad(&self) -> f64 {
        self.sensor.incidence_limit_deg.to_radians()
    }

    /// Position with all rotary axes at zero.
    pub fn rotary_at_zero(&self) -> Position {
        let axes = self.chain.topology().axes().filter(|axis| !axis.is_linear());
        let axes = axes.filter(|axis| self.plan.machine.axes.contains_key(axis));
        axes.map(|axis| (axis, 0.0)).collect()
    }

    /// Positions of the axis that tilts the table and of the axis that turns it, except 0. The list of a missing axis
    /// is empty.
    ///
    /// # Errors
    /// The table has no rotary axis, a configured position is outside the axis' limits, or an axis does not reach zero.
    pub fn nonzero_tilt_and_turn_positions(&self) -> Result<[Vec<Position>; 2], MethodRefusal> {
        let axes = table_rotary_axes(&self.chain);
        let tilt = axes.iter().find(|axis| tilts_table(&self.chain, **axis));
        let turn = axes.iter().rev().find(|axis| Some(*axis) != tilt);
        MethodRefusal::require(
            tilt.is_some() || turn.is_some(),
            format!("the table of {} has no rotary axis", self.chain.topology()),
            "this method measures rotary axes of the table; correct topology in [machine]",
        )?;
        let settings = self.settings;
        Ok([
            self.nonzero_positions_within_limits(tilt, &settings.tilt_deg, &DEFAULT_TILT_DEG, "tilt_deg")?,
            self.nonzero_positions_within_limits(turn, &settings.turn_deg, &DEFAULT_TURN_DEG, "turn_deg")?,
        ])
    }

    fn nonzero_positions_within_limits(
        &self,
        axis: Option<&Axis>,
        configured_deg: &[f64],
        default_deg: &[f64],
        key: &str,
    ) -> Result<Vec<Position>, MethodRefusal> {
        let Some((axis, spec)) = axis.and_then(|axis| self.plan.machine.axes.get_key_value(axis)) else {
            return Ok(Vec::new());
        };
        let is_inside = |degrees: &f64| {
            (spec.min - AXIS_LIMIT_TOLERANCE_DEG..=spec.max + AXIS_LIMIT_TOLERANCE_DEG).contains(degrees)
        };
        let limits = format!("outside its limits [{}, {}]", spec.min, spec.max);
        if let Some(outside) = configured_deg.iter().find(|degrees| !is_inside(degrees)) {
            return Err(MethodRefusal::new(
                format!("{key} contains {axis} {outside}°, {limits}"),
                format!("remove this position from {key}, or correct the limits in [axes.{axis}]"),
            ));
        }
        MethodRefusal::require(
            is_inside(&0.0),
            format!("{axis} 0° is {limits}"),
            "correct the limits in [axes]: this method starts with all rotary axes at zero",
        )?;
        let positions_deg = if configured_deg.is_empty() { default_deg } else { configured_deg };
        let allowed = positions_deg.iter().filter(|degrees| is_inside(degrees) && **degrees != 0.0);
        Ok(allowed.map(|degrees| Position::new().with(*axis, axis.to_mm_or_rad(*degrees))).collect())
    }
}

fn find_ball<'a>(plan: &'a Plan, settings: &LaserRTestSettings) -> Result<(&'a Balls, &'a Ball), MethodRefusal> {
    let refusal = |reason: &str| {
        MethodRefusal::new(reason, "state one precision sphere as [artefact] kind = \"balls\"; see config/laser.toml")
    };
    let Artefact::Balls(balls) = &plan.artefact else { return Err(refusal("the artefact is not a sphere")) };
    let id = &settings.ball;
    let ball = balls.balls.iter().find(|ball| id.is_empty() || ball.id == *id);
    Ok((balls, ball.ok_or_else(|| refusal(&format!("the artefact has no sphere `{id}`")))?))
}

/// The stylus as a sensor whose reading is always zero; its noise is the declared repeatability of a touch.
fn stylus_as_sensor(plan: &Plan) -> Sensor {
    Sensor {
        name: "probe".to_owned(),
        measured_quantity: MeasuredQuantity::Displacement,
        mount: SensorMount::Spindle,
        zero_mm: plan.machine.tool_mm,
        direction: [0.0, 0.0, -1.0],
        range_mm: [-1.0, 1.0],
        stand_off_mm: 0.0,
        body_radius_mm: 0.0,
        body_length_mm: 0.0,
        noise_um: plan.probe.repeatability_um,
        linearity_um: 0.0,
        incidence_um: 0.0,
        incidence_limit_deg: 180.0,
    }
}

/// Selects the sensor that the settings name, or the first one in the spindle.
///
/// # Errors
/// There is no sensor, none with that name, or its direction is zero.
pub fn select_sensor<'a>(sensors: &'a [Sensor], settings: &LaserRTestSettings) -> Result<&'a Sensor, MethodRefusal> {
    let name = settings.sensor.as_str();
    let is_selected = |sensor: &&Sensor| if name.is_empty() { sensor.mount.is_spindle() } else { sensor.name == name };
    let sensor = sensors.iter().find(is_selected).ok_or_else(|| {
        let names: Vec<&str> = sensors.iter().map(|sensor| sensor.name.as_str()).collect();
        MethodRefusal::new(
            match names.as_slice() {
                [] => "the machine has no displacement sensor".to_owned(),
                names => format!("the machine file has no sensor `{name}`; its sensors are {}", names.join(", ")),
            },
            "describe the sensor in [[sensor]] of the machine file, or measure with the touch probe: by = \"probe\" in \
             [method.laser-r-test]",
        )
    })?;
    MethodRefusal::require(
        sensor.mount.is_spindle(),
        format!("sensor `{}` is not in the spindle", sensor.name),
        "name a sensor in the spindle in [method.laser-r-test] sensor",
    )?;
    MethodRefusal::require(
        (Vector3::from(sensor.direction).norm() - 1.0).abs() <= 0.05,
        format!("direction of sensor `{}` is not a unit vector", sensor.name),
        "state the direction in which the readings increase, e.g. [0.0, 0.0, -1.0]",
    )?;
    Ok(sensor)
}
