//! Sensor in the spindle, sphere on the table, and positions of the rotary axes.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::parameters::{table_rotary_axes, tilts_table};
use super::settings::{LaserRTestSettings, MeasuringDevice};
use crate::MethodRefusal;
use machine::frame::unit_vector;
use machine::kinematics::KinematicChain;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::Plan;
use machine::record::sensor::{Sensor, SensorKind, SensorMount};
use machine::{Axis, Position};

const DEFAULT_TILT_DEG: [f64; 7] = [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0];
const DEFAULT_TURN_DEG: [f64; 6] = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0];
/// Tolerance of an axis limit, degrees.
const LIMIT_TOLERANCE_DEG: f64 = 1e-9;

/// A rotary axis and its positions in degrees.
pub type RotaryAxisPositions = (Axis, Vec<f64>);

/// A plan with the derived data that this method needs.
pub struct LaserSetup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a LaserRTestSettings,
    pub chain: KinematicChain,
    /// Sensor that measures the sphere. For the touch probe it is a stand-in whose zero point is the stylus centre.
    pub sensor: Sensor,
    pub balls: &'a Balls,
    pub ball: &'a Ball,
}

impl<'a> LaserSetup<'a> {
    /// # Errors
    /// There is no sensor or no sphere, or the kinematics of the machine cannot be built.
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

    pub fn zero_point(&self) -> Vector3<f64> {
        Vector3::from(self.sensor.zero_mm)
    }

    /// Nominal direction of increasing readings, spindle frame.
    pub fn beam_direction(&self) -> Vector3<f64> {
        unit_vector(Vector3::from(self.sensor.direction)).unwrap_or_default()
    }

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
        table * self.chain.linear_jacobian(rotary, &[])
    }

    /// Matrix from a displacement of the spindle relative to the table, machine frame, to X, Y, Z: the inverse of
    /// [`LaserSetup::machine_from_xyz`].
    ///
    /// # Errors
    /// The linear axes do not span space at these positions.
    pub fn xyz_from_machine(&self, rotary: &Position) -> Result<Matrix3<f64>, MethodRefusal> {
        let table = self.chain.machine_from_table(rotary, &[]).rotation;
        let from_table = self.chain.inverse_linear_jacobian(rotary, &[])?;
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

    /// Positions of the axis that tilts the table and of the axis that turns it, zero first. A missing axis has
    /// none.
    ///
    /// # Errors
    /// A configured position is outside the axis' limits, or an axis does not reach zero.
    pub fn rotary_axis_positions(&self) -> Result<[Option<RotaryAxisPositions>; 2], MethodRefusal> {
        let axes = table_rotary_axes(&self.chain);
        let tilt = axes.iter().find(|axis| tilts_table(&self.chain, **axis));
        let turn = axes.iter().rev().find(|axis| Some(*axis) != tilt);
        if tilt.is_none() && turn.is_none() {
            return Err(MethodRefusal {
                reason: format!("the table of {} has no rotary axis", self.chain.topology()),
                remedy: "this method measures rotary axes of the table; correct topology in [machine]".to_owned(),
            });
        }
        let positions_of = |axis: Option<&Axis>, configured: &[f64], default: &[f64], key| {
            axis.map(|axis| {
                self.allowed_positions_deg(*axis, configured, default, key).map(|positions| (*axis, positions))
            })
            .transpose()
        };
        Ok([
            positions_of(tilt, &self.settings.tilt_deg, &DEFAULT_TILT_DEG, "tilt_deg")?,
            positions_of(turn, &self.settings.turn_deg, &DEFAULT_TURN_DEG, "turn_deg")?,
        ])
    }

    fn allowed_positions_deg(
        &self,
        axis: Axis,
        configured: &[f64],
        default: &[f64],
        key: &str,
    ) -> Result<Vec<f64>, MethodRefusal> {
        let Some(spec) = self.plan.machine.axes.get(&axis) else { return Ok(Vec::new()) };
        let is_inside =
            |degrees: &f64| (spec.min - LIMIT_TOLERANCE_DEG..=spec.max + LIMIT_TOLERANCE_DEG).contains(degrees);
        let limits = || format!("outside its limits [{}, {}]", spec.min, spec.max);
        if let Some(outside) = configured.iter().find(|degrees| !is_inside(degrees)) {
            return Err(MethodRefusal {
                reason: format!("{key} contains {axis} {outside}°, {}", limits()),
                remedy: format!(
                    "remove this position from {key}, or correct the limits in \
                                  [axes.{axis}]"
                ),
            });
        }
        if !is_inside(&0.0) {
            return Err(MethodRefusal {
                reason: format!("{axis} 0° is {}", limits()),
                remedy: "correct the limits in [axes]: this method starts with all rotary axes at \
                          zero"
                    .to_owned(),
            });
        }
        let list = if configured.is_empty() { default } else { configured };
        let mut all = vec![0.0];
        all.extend(list.iter().copied().filter(|degrees| is_inside(degrees) && *degrees != 0.0));
        Ok(all)
    }
}

fn find_ball<'a>(plan: &'a Plan, settings: &LaserRTestSettings) -> Result<(&'a Balls, &'a Ball), MethodRefusal> {
    let refused = |why: String| MethodRefusal {
        reason: why,
        remedy: "state one precision sphere as [artefact] kind = \"balls\"; see config/laser.toml".to_owned(),
    };
    let Artefact::Balls(balls) = &plan.artefact else {
        return Err(refused("the artefact is not a sphere".to_owned()));
    };
    let selected = match settings.ball.as_str() {
        "" => balls.balls.first(),
        id => balls.balls.iter().find(|ball| ball.id == id),
    };
    let selected = selected.ok_or_else(|| {
        refused(format!(
            "the artefact has no sphere \
                                                           `{}`",
            settings.ball
        ))
    })?;
    Ok((balls, selected))
}

/// The stylus as a sensor whose reading is always zero.
fn stylus_as_sensor(plan: &Plan) -> Sensor {
    Sensor {
        name: "probe".to_owned(),
        kind: SensorKind::Displacement,
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
    let selected = match settings.sensor.as_str() {
        "" => sensors.iter().find(|sensor| sensor.mount.is_spindle()),
        name => sensors.iter().find(|sensor| sensor.name == name),
    };
    let sensor = selected.ok_or_else(|| {
        let names: Vec<&str> = sensors.iter().map(|sensor| sensor.name.as_str()).collect();
        MethodRefusal {
            reason: match (settings.sensor.as_str(), names.as_slice()) {
                (_, []) => "the machine has no displacement sensor".to_owned(),
                (name, _) => format!(
                    "the machine file has no sensor `{name}`; its sensors are \
                                      {}",
                    names.join(", ")
                ),
            },
            remedy: "describe the sensor in [[sensor]] of the machine file, or measure with the touch \
                      probe: by = \"probe\" in [method.laser-r-test]"
                .to_owned(),
        }
    })?;
    if !sensor.mount.is_spindle() {
        return Err(MethodRefusal {
            reason: format!("sensor `{}` is not in the spindle", sensor.name),
            remedy: "name a sensor in the spindle in [method.laser-r-test] sensor".to_owned(),
        });
    }
    let direction = Vector3::from(sensor.direction);
    if !(direction.norm() - 1.0).abs().is_finite() || (direction.norm() - 1.0).abs() > 0.05 {
        return Err(MethodRefusal {
            reason: format!("direction of sensor `{}` is not a unit vector", sensor.name),
            remedy: "state the direction in which the readings increase, e.g. [0.0, 0.0, -1.0]".to_owned(),
        });
    }
    Ok(sensor)
}
