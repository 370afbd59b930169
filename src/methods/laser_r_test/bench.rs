//! Sensor in the spindle, sphere on the table, and positions of the rotary axes.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::parameters::{of_table, tilts};
use super::settings::{MeasuringDevice, Settings};
use crate::Refused;
use machine::frame::unit_vector;
use machine::kinematics::Chain;
use machine::record::artefact::{Artefact, Ball, Balls};
use machine::record::plan::Plan;
use machine::record::sensor::{Mount, Sensor, SensorKind};
use machine::{Axis, Position};

const TILT_DEG: [f64; 7] = [-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0];
const TURN_DEG: [f64; 6] = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0];
/// Tolerance of an axis limit, degrees.
const SLACK: f64 = 1e-9;

/// A rotary axis and its positions in degrees.
pub type RotaryAxisPositions = (Axis, Vec<f64>);

/// A plan with the derived data that this method needs.
pub struct LaserSetup<'a> {
    pub plan: &'a Plan,
    pub settings: &'a Settings,
    pub chain: Chain,
    /// Sensor that measures the sphere. For the touch probe it is a stand-in whose zero point is the stylus centre.
    pub sensor: Sensor,
    pub balls: &'a Balls,
    pub ball: &'a Ball,
}

impl<'a> LaserSetup<'a> {
    /// # Errors
    /// There is no sensor or no sphere, or the kinematics of the machine cannot be built.
    pub fn new(plan: &'a Plan, settings: &'a Settings) -> Result<Self, Refused> {
        settings.check()?;
        let chain = Chain::new(&plan.machine)?;
        let (balls, ball) = ball(plan, settings)?;
        let sensor = match settings.by {
            MeasuringDevice::Laser => sensor(&plan.sensors, settings)?.clone(),
            MeasuringDevice::Probe => stylus(plan),
        };
        Ok(Self { plan, settings, chain, sensor, balls, ball })
    }

    pub fn zero(&self) -> Vector3<f64> {
        Vector3::from(self.sensor.zero_mm)
    }

    /// Nominal direction of increasing readings, spindle frame.
    pub fn beam(&self) -> Vector3<f64> {
        unit_vector(Vector3::from(self.sensor.direction)).unwrap_or_default()
    }

    pub fn centre(&self) -> Vector3<f64> {
        Vector3::from(self.ball.centre_mm)
    }

    /// Rotation from the spindle frame to the machine frame.
    pub fn spindle(&self, rotary: &Position) -> Rotation3<f64> {
        self.chain.machine_from_spindle(rotary, &[]).rotation
    }

    /// Matrix from X, Y, Z to the displacement of the spindle relative to the table, machine frame.
    pub fn travel(&self, rotary: &Position) -> Matrix3<f64> {
        let table = self.chain.machine_from_table(rotary, &[]).rotation;
        table * self.chain.linear_jacobian(rotary, &[])
    }

    /// Matrix from a displacement of the spindle relative to the table, machine frame, to X, Y, Z: the inverse of
    /// [`LaserSetup::travel`].
    ///
    /// # Errors
    /// The linear axes do not span space at these positions.
    pub fn axes_for(&self, rotary: &Position) -> Result<Matrix3<f64>, Refused> {
        let table = self.chain.machine_from_table(rotary, &[]).rotation;
        let from_table = self.chain.linear_inverse(rotary, &[])?;
        Ok(from_table * table.inverse())
    }

    pub fn touches(&self) -> bool {
        self.settings.by == MeasuringDevice::Probe
    }

    /// Distance from the sphere's centre to the measured point, mm: for a touch, to the stylus centre.
    pub fn radius(&self) -> f64 {
        let stylus = if self.touches() { self.plan.probe.ball_radius_mm } else { 0.0 };
        self.ball.radius_mm + stylus
    }

    /// Incidence limit of the sensor, rad.
    pub fn limit(&self) -> f64 {
        self.sensor.incidence_limit_deg.to_radians()
    }

    /// Position with all rotary axes at zero.
    pub fn at_zero(&self) -> Position {
        let axes = self.chain.topology().axes().filter(|axis| !axis.is_linear());
        let axes = axes.filter(|axis| self.plan.machine.axes.contains_key(axis));
        axes.map(|axis| (axis, 0.0)).collect()
    }

    /// Positions of the axis that tilts the table and of the axis that turns it, zero first. A missing axis has
    /// none.
    ///
    /// # Errors
    /// A configured position is outside the axis' limits, or an axis does not reach zero.
    pub fn positions(&self) -> Result<[Option<RotaryAxisPositions>; 2], Refused> {
        let axes = of_table(&self.chain);
        let tilt = axes.iter().find(|axis| tilts(&self.chain, **axis));
        let turn = axes.iter().rev().find(|axis| Some(*axis) != tilt);
        if tilt.is_none() && turn.is_none() {
            return Err(Refused {
                why: format!("the table of {} has no rotary axis", self.chain.topology()),
                instead:
                    "this method measures rotary axes of the table; correct topology in [machine]"
                        .to_owned(),
            });
        }
        let of = |axis: Option<&Axis>, named: &[f64], otherwise: &[f64], key| {
            axis.map(|axis| self.cut(*axis, named, otherwise, key).map(|at| (*axis, at)))
                .transpose()
        };
        Ok([
            of(tilt, &self.settings.tilt_deg, &TILT_DEG, "tilt_deg")?,
            of(turn, &self.settings.turn_deg, &TURN_DEG, "turn_deg")?,
        ])
    }

    fn cut(
        &self,
        axis: Axis,
        named: &[f64],
        otherwise: &[f64],
        key: &str,
    ) -> Result<Vec<f64>, Refused> {
        let Some(spec) = self.plan.machine.axes.get(&axis) else { return Ok(Vec::new()) };
        let inside = |degrees: &f64| (spec.min - SLACK..=spec.max + SLACK).contains(degrees);
        let limits = || format!("outside its limits [{}, {}]", spec.min, spec.max);
        if let Some(beyond) = named.iter().find(|degrees| !inside(degrees)) {
            return Err(Refused {
                why: format!("{key} names {axis} {beyond}°, {}", limits()),
                instead: format!("take it out of {key}, or correct the limits in [axes.{axis}]"),
            });
        }
        if !inside(&0.0) {
            return Err(Refused {
                why: format!("{axis} 0° lies {}", limits()),
                instead: "this method begins with all rotary axes at zero".to_owned(),
            });
        }
        let list = if named.is_empty() { otherwise } else { named };
        let mut all = vec![0.0];
        all.extend(list.iter().copied().filter(|degrees| inside(degrees) && *degrees != 0.0));
        Ok(all)
    }
}

fn ball<'a>(plan: &'a Plan, settings: &Settings) -> Result<(&'a Balls, &'a Ball), Refused> {
    let refused = |why: String| Refused {
        why,
        instead: "state one precision sphere as [artefact] kind = \"balls\"; see config/laser.toml"
            .to_owned(),
    };
    let Artefact::Balls(balls) = &plan.artefact else {
        return Err(refused("the artefact is no sphere".to_owned()));
    };
    let found = match settings.ball.as_str() {
        "" => balls.balls.first(),
        id => balls.balls.iter().find(|ball| ball.id == id),
    };
    let found = found.ok_or_else(|| refused(format!("there is no sphere `{}`", settings.ball)))?;
    Ok((balls, found))
}

/// The stylus as a sensor whose reading is always zero.
fn stylus(plan: &Plan) -> Sensor {
    Sensor {
        name: "probe".to_owned(),
        kind: SensorKind::Displacement,
        mount: Mount::Spindle,
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
pub fn sensor<'a>(sensors: &'a [Sensor], settings: &Settings) -> Result<&'a Sensor, Refused> {
    let found = match settings.sensor.as_str() {
        "" => sensors.iter().find(|sensor| sensor.mount.is_spindle()),
        name => sensors.iter().find(|sensor| sensor.name == name),
    };
    let sensor = found.ok_or_else(|| {
        let names: Vec<&str> = sensors.iter().map(|sensor| sensor.name.as_str()).collect();
        Refused {
            why: match (settings.sensor.as_str(), names.as_slice()) {
                (_, []) => "the machine has no displacement sensor".to_owned(),
                (name, _) => format!("there is no sensor `{name}`; there are {}", names.join(", ")),
            },
            instead:
                "describe the sensor in [[sensor]] of the machine file, or measure with the touch \
                      probe: by = \"probe\" in [method.laser-r-test]"
                    .to_owned(),
        }
    })?;
    if !sensor.mount.is_spindle() {
        return Err(Refused {
            why: format!("sensor `{}` is not in the spindle", sensor.name),
            instead: "name a sensor in the spindle in [method.laser-r-test] sensor".to_owned(),
        });
    }
    let direction = Vector3::from(sensor.direction);
    if !(direction.norm() - 1.0).abs().is_finite() || (direction.norm() - 1.0).abs() > 0.05 {
        return Err(Refused {
            why: format!("direction of sensor `{}` is no unit vector", sensor.name),
            instead: "state the direction in which its readings grow, e.g. [0.0, 0.0, -1.0]"
                .to_owned(),
        });
    }
    Ok(sensor)
}
