//! Displacement sensors for planted mistakes. Frames, lines and registers follow a data sheet that is used only
//! here.

use std::sync::Arc;
use std::time::Duration;

use devices::sensors::{OpenSensorFuture, SensorConfig, can};
use link::can::{CanError, CanEvent, CanFrame, CanId, CanReceiver};
use link::{Clock, SharedPorts};
use machine::record::sensor;
use simulator::SensorOutput;
use simulator::sensor_devices::modbus::{SampleTiming, serve_on_tcp};
use tokio::io::AsyncWriteExt as _;
use tokio::sync::mpsc;
use trued::commissioning::{CheckSummary, NoOperator};
use trued::setup::machine_file::SensorConnection;
use trued::setup::{MachineFile, ReopenableMachine};

use super::simulated_machine_checks::{changed_machine_toml, check_with_operator, runtime};

const DECLARED_NOISE_UM: f64 = 0.5;
pub const RATE_HZ: f64 = 1000.0;
const COUNTS_PER_MM: f64 = 1e5;

/// The built-in machine with a laser that has these connection keys.
pub fn machine_file_with_sensor(connection: &str) -> MachineFile {
    let text = format!(
        "{}\n[[sensor]]\nname = \"laser\"\nzero_mm = [0.0, 0.0, -150.0]\ndirection = [0.0, 0.0, -1.0]\n\
         range_mm = [-10.0, 10.0]\nnoise_um = {DECLARED_NOISE_UM:?}\n{connection}",
        changed_machine_toml(&[])
    );
    MachineFile::parse("machine.toml", text).unwrap()
}

/// Checks without an operator: nothing moves.
pub async fn run_check_without_operator(file: &MachineFile) -> CheckSummary {
    check_with_operator(file, &ReopenableMachine::new(file).unwrap(), &mut NoOperator).await
}

/// Counts of a sample at `mm`, with 0.3 µm of noise.
pub fn noisy_distance_counts(number: u64, mm: f64) -> i32 {
    (mm * COUNTS_PER_MM) as i32 + (number * 37 % 101) as i32 - 50
}

// CAN: counter (2 bytes), distance in 10 nm (3 bytes), status (1 byte); most significant byte first.

const CAN_LAYOUT_KEYS: &str = r#"
interface = "can0"
id = 0x181
order = "big"
length = 6
value = { byte = 2, width = 24, signed = true, scale_mm = 1e-5 }
counter = { byte = 0, width = 16 }
status = [{ byte = 5, bit = 0, means = "no-echo" }]
"#;

pub fn can_frame(number: u64, rate_hz: f64, counter: u64, distance: i32) -> CanFrame {
    let [.., high, low] = counter.to_be_bytes();
    let [_, first, second, third] = distance.to_be_bytes();
    let data = [high, low, first, second, third, 0];
    let t_s = number as f64 / rate_hz;
    CanFrame::new(t_s, CanId::new(0x181, false).unwrap(), &data)
}

/// A bus in this process, and the machine file's description of the sensor's frames.
#[derive(Debug)]
struct CanTestSensor {
    layout_keys: String,
    open_receiver: fn() -> Result<CanReceiver, CanError>,
}

impl SensorConfig for CanTestSensor {
    fn describe_address(&self) -> String {
        "frames 181 on CAN interface can0".to_owned()
    }

    fn open_sensor<'a>(
        &'a self,
        sensor: &'a sensor::Sensor,
        clock: Arc<dyn Clock>,
        _: &'a SharedPorts,
    ) -> OpenSensorFuture<'a> {
        Box::pin(async move {
            let config: can::CanConfig = toml::from_str(&self.layout_keys).unwrap();
            Ok(config.spawn_sensor((self.open_receiver)()?, sensor, clock, None))
        })
    }
}

pub fn check_on_can(
    layout_changes: &[(&str, &str)],
    open_receiver: fn() -> Result<CanReceiver, CanError>,
) -> CheckSummary {
    let change = |text: String, (old, new): &(&str, &str)| {
        assert!(text.contains(old), "{old}");
        text.replacen(old, new, 1)
    };
    let sheet = layout_changes.iter().fold(CAN_LAYOUT_KEYS.to_owned(), change);
    let mut file = machine_file_with_sensor(&format!("rate_hz = {RATE_HZ:?}\n[sensor.simulated]\n"));
    file.sensors[0].connection = SensorConnection::Real(Arc::new(CanTestSensor { layout_keys: sheet, open_receiver }));
    runtime().block_on(run_check_without_operator(&file))
}

/// A receiver of these frames, numbered from 0, which come as fast as they are read.
pub fn receiver_of_frames(frame: fn(u64) -> CanFrame) -> Result<CanReceiver, CanError> {
    let mut number = 0;
    let next = move || {
        number += 1;
        Some(frame(number - 1))
    };
    Ok(CanReceiver::from_generator("can0", next))
}

pub fn sound_frame(number: u64) -> CanFrame {
    can_frame(number, RATE_HZ, number, noisy_distance_counts(number, 1.2345))
}

pub fn frame_near_zero(number: u64) -> CanFrame {
    can_frame(number, RATE_HZ, number, noisy_distance_counts(number, 0.1))
}

pub fn open_sound_bus() -> Result<CanReceiver, CanError> {
    receiver_of_frames(sound_frame)
}

/// A bus with exactly these events.
pub fn receiver_of_events(events: Vec<CanEvent>) -> Result<CanReceiver, CanError> {
    let (say, heard) = mpsc::channel(8);
    for heard in events {
        say.try_send(heard).unwrap();
    }
    // The bus must stay open.
    std::mem::forget(say);
    Ok(CanReceiver::from_events("can0", heard))
}

// A serial line: `M0,` the distance in mm and a counter of four digits.

pub const TEXT_LINE_KEYS: &str = "[sensor.serial.line]\nend = \"\\r\\n\"\nseparator = \",\"\ncolumns = 3\n\
                    value = { column = 2, scale_mm = 1.0 }\ncounter = { column = 3, round = 10000 }\n";
pub const BYTE_FRAME_KEYS: &str = "[sensor.serial.frame]\nsync = [0xAA, 0x55]\nlength = 5\norder = \"big\"\n\
                     value = { byte = 0, width = 24, signed = true, scale_mm = 1e-5 }\n\
                     counter = { byte = 3, width = 16 }\n";

pub fn text_line(number: u64) -> Vec<u8> {
    let mm = f64::from(noisy_distance_counts(number, 1.2345)) / COUNTS_PER_MM;
    format!("M0,{mm:+09.5},{:04}\r\n", number % 10_000).into_bytes()
}

pub fn byte_frame(number: u64) -> Vec<u8> {
    let [_, first, second, third] = noisy_distance_counts(number, 1.2345).to_be_bytes();
    let [.., high, low] = number.to_be_bytes();
    vec![0xAA, 0x55, first, second, third, high, low]
}

/// Period of the lines and frames on the serial line.
const SAMPLE_PERIOD: Duration = Duration::from_millis(2);

/// A device on a pseudo-terminal that sends this data without requests, and its description in a machine file.
pub fn check_on_serial_line(keys: &str, message_of_sample: impl Fn(u64) -> Vec<u8>) -> CheckSummary {
    runtime().block_on(async {
        let mut pty = link::create_pty().unwrap();
        let at = format!("[sensor.serial]\nserial = \"{}\"\nbaud = 9600\ntimeout_s = 2.0\n", pty.path);
        let file = machine_file_with_sensor(&(at + keys));
        let device = async {
            for number in 0.. {
                let said = message_of_sample(number);
                // The reader has closed the port.
                if pty.device.write_all(&said).await.is_err() {
                    break;
                }
                tokio::time::sleep(SAMPLE_PERIOD).await;
            }
            std::future::pending::<()>().await;
        };
        tokio::select! {
            summary = run_check_without_operator(&file) => summary,
            () = device => unreachable!("it ends with the check"),
        }
    })
}

/// Bytes sent at 115 200 baud as received at 9600 baud.
pub fn garbled_at_wrong_baud_rate(bytes: Vec<u8>) -> Vec<u8> {
    link::decode_at_baud(&bytes.repeat(12), 115_200, 9600)
}

// Modbus: the simulated sensor. Input registers 0 status, 1 counter, 2 and 3 the distance in 10 nm, low word first.

pub const MODBUS_MAP_KEYS: &str = "counter = { register = 1, type = \"u16\" }\n\
                   value = { register = 2, type = \"i32\", order = \"cdab\", scale_mm = 1e-5 }\n";

pub fn check_on_modbus(map_changes: &[(&str, &str)], rate_hz: f64) -> CheckSummary {
    let mut number = 0;
    let sense = move || {
        number += 1;
        SensorOutput::Distance(f64::from(noisy_distance_counts(number, 1.2345)) / COUNTS_PER_MM)
    };
    let timing = SampleTiming::AtFixedRate;
    let (at, _) = serve_on_tcp(timing, Box::new(sense), rate_hz).unwrap();
    let map = map_changes.iter().fold(MODBUS_MAP_KEYS.to_owned(), |map, (old, new)| {
        assert!(map.contains(old), "{old}");
        map.replacen(old, new, 1)
    });
    runtime().block_on(run_check_without_operator(&machine_file_with_sensor(&format!(
        "[sensor.modbus]\ntcp = \"{at}\"\n{map}"
    ))))
}

/// The built-in machine with an additional thermometer at `at`.
pub fn machine_file_with_thermometer(at: &str, scale_c: &str) -> MachineFile {
    let text = format!(
        "{}\n[[thermometer]]\nname = \"bed\"\n[thermometer.modbus]\ntcp = \"{at}\"\n\
         value = {{ register = 2, type = \"i32\", order = \"cdab\", scale_c = {scale_c} }}\n",
        changed_machine_toml(&[])
    );
    MachineFile::parse("machine.toml", text).unwrap()
}

/// Checks a device whose register value is 21.5 in units of 1e-5.
pub fn check_thermometer(scale_c: &str) -> CheckSummary {
    let sense = Box::new(|| SensorOutput::Distance(21.5));
    let (at, _) = serve_on_tcp(SampleTiming::AtFixedRate, sense, 10.0).unwrap();
    runtime().block_on(run_check_without_operator(&machine_file_with_thermometer(&at.to_string(), scale_c)))
}

/// A port that accepts connections and sends nothing.
pub fn check_with_silent_port(machine_file_for_address: impl Fn(&str) -> MachineFile) -> CheckSummary {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let file = machine_file_for_address(&listener.local_addr().unwrap().to_string());
    let summary = runtime().block_on(run_check_without_operator(&file));
    drop(listener);
    summary
}

/// LinuxCNC without a server for the axis positions.
pub fn check_without_sampler() -> CheckSummary {
    let folder = tempfile::tempdir().unwrap();
    check_with_silent_port(|address| {
        let control = format!(
            "kind = \"linuxcnc\"\ntcp = \"{address}\"\nprogram_dir = {:?}\n\
             sampler = {{ tcp = \"127.0.0.1:1\" }}\n",
            folder.path()
        );
        let changes = [("kind = \"simulated\"\n", control.as_str()), ("wire = \"memory\"\n", "")];
        MachineFile::parse("machine.toml", changed_machine_toml(&changes)).unwrap()
    })
}

/// Sound sensors on every kind of connection.
pub fn sound_sensors_pass() {
    let slow = "rate_hz = 500.0\n";
    for (name, summary) in [
        ("CAN", check_on_can(&[], open_sound_bus)),
        ("text", check_on_serial_line(TEXT_LINE_KEYS, text_line)),
        ("bytes", check_on_serial_line(BYTE_FRAME_KEYS, byte_frame)),
        ("Modbus", check_on_modbus(&[], 200.0)),
        (
            "in memory",
            runtime().block_on(run_check_without_operator(&machine_file_with_sensor(&format!(
                "{slow}[sensor.simulated]\nrate_hz = 500.0\n"
            )))),
        ),
    ] {
        let failed = super::simulated_machine_checks::failure_lines(&summary);
        assert!(failed.is_empty(), "{name}: {failed}");
        let told = summary.to_string();
        assert!(told.contains("sensors ok             laser ("), "{name}: {told}");
    }
}

pub fn answering_thermometer_passes() {
    let summary = check_thermometer("1e-5");
    assert!(super::simulated_machine_checks::failure_lines(&summary).is_empty(), "{summary}");
    let told = summary.to_string();
    assert!(told.contains("thermometer bed (127.0.0.1:") && told.contains("): 21.50 °C"), "{told}");
    // The built-in thermometer, which measures the simulated machine.
    assert!(told.contains("thermometer spindle (simulated): "), "{told}");
}
