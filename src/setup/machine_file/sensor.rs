//! `[[sensor]]`, and the registry of the sensor interfaces.

use std::sync::Arc;

use serde::Deserialize;

use devices::sensors::{SensorConfig, SharedPort, can, modbus, serial};
use machine::record::sensor::{self, MeasuredQuantity, SensorMount};

use super::document::TomlDocument;
use super::error::MachineFileError;
use crate::setup::simulated::SimulatedSensorConfig;

/// A sensor as `[[sensor]]` states it.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "SensorKeys")]
pub struct SensorEntry {
    pub sensor: sensor::Sensor,
    /// Configured sample rate, samples per second; `None`: `trued check` does not compare the rate.
    pub sample_rate_hz: Option<f64>,
    pub connection: SensorConnection,
}

#[derive(Debug, Clone)]
pub enum SensorConnection {
    /// A sensor that measures the simulated machine of `[simulated]`.
    Simulated(SimulatedSensorConfig),
    Real(Arc<dyn SensorConfig>),
}

impl SensorConnection {
    /// `None` for a simulated sensor.
    fn real(&self) -> Option<&dyn SensorConfig> {
        match self {
            Self::Simulated(_) => None,
            Self::Real(real) => Some(real.as_ref()),
        }
    }

    /// Port that other sensors may use too; `None` without one.
    fn shared_port(&self) -> Option<SharedPort> {
        self.real()?.shared_port()
    }

    /// Number of counts after which the encoder count in the samples restarts at 0; `None`: the samples have no
    /// count.
    pub fn encoder_wrap_count(&self) -> Option<u64> {
        self.real()?.encoder_modulus()
    }

    /// Address of the sensor (port, host or bus), for display; `simulated` for a simulated sensor.
    pub fn describe_address(&self) -> String {
        self.real().map_or_else(|| "simulated".to_owned(), SensorConfig::describe_address)
    }
}

/// Checks that sensors on one port agree on its settings.
pub fn check_shared_port_settings(document: &TomlDocument, sensors: &[SensorEntry]) -> Result<(), MachineFileError> {
    let ports: Vec<_> = sensors.iter().map(|entry| entry.connection.shared_port()).collect();
    for (index, own) in ports.iter().enumerate() {
        let earlier = sensors.iter().zip(&ports).take(index);
        let mut conflicts =
            earlier.filter_map(|(entry, port)| own.as_ref()?.describe_conflict(&entry.sensor.name, port.as_ref()?));
        if let (Some(why), Some(entry)) = (conflicts.next(), sensors.get(index)) {
            let why = format!("`{}` {why}", entry.sensor.name);
            return Err(document.entry_error("sensor", index, why));
        }
    }
    Ok(())
}

/// Keys of [`sensor::Sensor`], and one table for each interface. A new interface is a line here and in
/// [`SensorKeys::take_connection`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorKeys {
    name: String,
    #[serde(default, rename = "kind")]
    measured_quantity: MeasuredQuantity,
    #[serde(default)]
    mount: SensorMount,
    /// Zero point of the beam, in the frame of the mount.
    zero_mm: [f64; 3],
    /// Unit vector along which the reading increases, away from the sensor, in the frame of the mount.
    direction: [f64; 3],
    /// Valid range of the readings: minimum and maximum.
    range_mm: [f64; 2],
    /// Distance from the zero point back to the front face of the sensor.
    #[serde(default)]
    stand_off_mm: f64,
    /// Radius of the sensor's body, a cylinder from the front face back; 0: not declared, and therefore not checked.
    #[serde(default)]
    body_radius_mm: f64,
    /// Length of the sensor's body from the front face back.
    #[serde(default)]
    body_length_mm: f64,
    /// Standard deviation of one sample; `None`: evaluated from the residuals alone.
    noise_um: Option<f64>,
    /// Configured sample rate, samples per second.
    rate_hz: Option<f64>,
    /// Standard deviation of the linearity error over the range.
    #[serde(default)]
    linearity_um: f64,
    /// Standard deviation of the error at a surface inclined by 45°.
    #[serde(default)]
    incidence_um: f64,
    /// Maximum angle between beam and surface normal; samples at a greater angle are not used.
    #[serde(default = "sensor::default_incidence_limit_deg")]
    incidence_limit_deg: f64,
    can: Option<can::CanConfig>,
    serial: Option<serial::SerialConfig>,
    modbus: Option<modbus::ModbusSensorConfig>,
    simulated: Option<SimulatedSensorConfig>,
}

/// Maximum deviation of a direction's length from 1.
const UNIT_VECTOR_TOLERANCE: f64 = 1e-6;

impl SensorKeys {
    /// Takes the configuration of the sensor's interface out of the keys.
    ///
    /// # Errors
    /// The entry has none of the tables, or several.
    fn take_connection(&mut self) -> Result<SensorConnection, String> {
        let mut connections = Vec::new();
        connections.extend(self.can.take().map(|can| SensorConnection::Real(Arc::new(can))));
        connections.extend(self.serial.take().map(|serial| SensorConnection::Real(Arc::new(serial))));
        connections.extend(self.modbus.take().map(|modbus| SensorConnection::Real(Arc::new(modbus))));
        connections.extend(self.simulated.take().map(SensorConnection::Simulated));
        match connections.pop() {
            Some(connection) if connections.is_empty() => Ok(connection),
            _ => Err(format!(
                "`{}` requires exactly one of the sections [sensor.can], [sensor.serial], [sensor.modbus] \
                and [sensor.simulated] for its connection",
                self.name
            )),
        }
    }
}

impl TryFrom<SensorKeys> for SensorEntry {
    type Error = String;

    fn try_from(mut keys: SensorKeys) -> Result<Self, String> {
        let connection = keys.take_connection()?;
        let sensor = sensor::Sensor {
            name: keys.name,
            measured_quantity: keys.measured_quantity,
            mount: keys.mount,
            zero_mm: keys.zero_mm,
            direction: keys.direction,
            range_mm: keys.range_mm,
            stand_off_mm: keys.stand_off_mm,
            body_radius_mm: keys.body_radius_mm,
            body_length_mm: keys.body_length_mm,
            noise_um: keys.noise_um,
            linearity_um: keys.linearity_um,
            incidence_um: keys.incidence_um,
            incidence_limit_deg: keys.incidence_limit_deg,
        };
        check_sensor_name_direction_range_and_sizes(&sensor)?;
        if let Some(hz) = keys.rate_hz.filter(|hz| !(0.001..=1e6).contains(hz)) {
            return Err(format!("`rate_hz` is {hz}; it must be between 0.001 and 1000000 samples per second"));
        }
        Ok(Self { sensor, sample_rate_hz: keys.rate_hz, connection })
    }
}

fn check_sensor_name_direction_range_and_sizes(sensor: &sensor::Sensor) -> Result<(), String> {
    if sensor.name.is_empty() || sensor.name == "probe" {
        return Err("`name` must not be empty, and must not be `probe`, the name of the touch probe".to_owned());
    }
    let square: f64 = sensor.direction.iter().map(|part| part * part).sum();
    if (square.sqrt() - 1.0).abs() > UNIT_VECTOR_TOLERANCE {
        return Err(format!(
            "`direction` has the length {}; it must be a unit vector, such as [0.0, 0.0, -1.0] for a sensor \
            that measures downwards",
            square.sqrt()
        ));
    }
    let [least, greatest] = sensor.range_mm;
    if least >= greatest {
        return Err("`range_mm` must be [minimum, maximum] with the minimum below the maximum".to_owned());
    }
    let sizes = [
        ("stand_off_mm", sensor.stand_off_mm),
        ("body_radius_mm", sensor.body_radius_mm),
        ("body_length_mm", sensor.body_length_mm),
        ("noise_um", sensor.noise_um.unwrap_or_default()),
        ("linearity_um", sensor.linearity_um),
        ("incidence_um", sensor.incidence_um),
    ];
    if let Some((key, _)) = sizes.iter().find(|(_, size)| *size < 0.0) {
        return Err(format!("`{key}` must not be negative"));
    }
    if !(0.0..90.0).contains(&sensor.incidence_limit_deg) || sensor.incidence_limit_deg == 0.0 {
        return Err("`incidence_limit_deg` must be between 0 and 90".to_owned());
    }
    Ok(())
}
