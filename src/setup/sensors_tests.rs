//! Tests of several sensors on one port: combinations that the machine file refuses, and accepted combinations over a
//! pseudo-terminal.

use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio::time::sleep;

use super::MachineFile;
use super::machine_file::SensorEntry;
use super::sensors::SensorOpener;
use devices::sensors::{Sample, SensorError};
use link::clock::HostClock;
use link::{Pty, create_pty};
use machine::record::reading::ReadingFlag;
use simulator::SensorOutput;
use simulator::sensor_devices::modbus::{DATA_SHEET_TOML, SampleTiming, serve_on_tcp};

/// A sensor entry; `interface_toml` is the TOML table of its interface.
fn parse_sensor_entry(name: &str, interface_toml: &str) -> SensorEntry {
    let keys = "zero_mm = [0, 0, 0]\ndirection = [1, 0, 0]\nrange_mm = [-1, 1]\n";
    toml::from_str(&format!("name = \"{name}\"\n{keys}{interface_toml}")).unwrap()
}

/// The sensor at the port `path` whose value, mm, is in `column` (from 1) of lines such as `0.0123,-0.0040,17`.
fn line_column_sensor(name: &str, path: &str, column: usize) -> SensorEntry {
    let keys = "separator = \",\"\ncounter = { column = 3, round = 1000 }\n";
    let value = format!("value = {{ column = {column}, scale_mm = 1.0 }}\n");
    parse_sensor_entry(name, &format!("[serial]\nserial = \"{path}\"\n[serial.line]\n{keys}{value}"))
}

fn new_sensor_opener(entries: &[SensorEntry]) -> SensorOpener {
    SensorOpener::new(entries, None, Arc::new(HostClock::start()), None)
}

/// Values of the samples that have one.
fn values_mm(samples: &[Sample]) -> Vec<f64> {
    samples.iter().filter_map(|sample| sample.value_mm).collect()
}

#[tokio::test]
async fn two_sensors_read_their_columns_of_one_serial_port() {
    let Pty { mut device, path, client_side } = create_pty().unwrap();
    let amplifier = tokio::spawn(async move {
        for count in 0_u32.. {
            let line = format!("0.0123,-0.0040,{}\n", count % 1000);
            if device.write_all(line.as_bytes()).await.is_err() {
                return;
            }
            sleep(Duration::from_millis(2)).await;
        }
    });
    let sensors = new_sensor_opener(&[line_column_sensor("x1", &path, 1), line_column_sensor("y1", &path, 2)]);
    let x1 = sensors.open("x1").await.unwrap();
    x1.prepare().await.unwrap();
    let y1 = sensors.open("y1").await.unwrap();
    y1.prepare().await.unwrap();
    // The drivers hold the pseudo-terminal open now.
    drop(client_side);
    let (of_x1, of_y1) = tokio::join!(x1.read_samples(20), y1.read_samples(20));
    assert_eq!(values_mm(&of_x1.unwrap()), [0.0123; 20]);
    assert_eq!(values_mm(&of_y1.unwrap()), [-0.0040; 20]);
    for sensor in [&x1, &y1] {
        let tally = sensor.sample_counters().await.unwrap();
        assert_eq!(tally.lost_sample_count, 0, "{}", sensor.name());
        sensor.watch(|sample| sample.flag == ReadingFlag::None, || ()).await.unwrap();
    }
    // After one sensor is closed, the other continues.
    drop(y1);
    assert_eq!(x1.read_samples(3).await.unwrap().len(), 3);
    let y1 = sensors.open("y1").await.unwrap();
    assert_eq!(values_mm(&y1.read_samples(3).await.unwrap()), [-0.0040; 3]);
    // The port is lost while both sensors are watched: each holds the machine and reports the loss.
    let (hold, mut held) = mpsc::unbounded_channel();
    for sensor in [&x1, &y1] {
        let (hold, name) = (hold.clone(), sensor.name().to_owned());
        let holds = move || drop(hold.send(name.clone()));
        sensor.watch(|sample| sample.flag == ReadingFlag::None, holds).await.unwrap();
    }
    amplifier.abort();
    let mut names = [held.recv().await.unwrap(), held.recv().await.unwrap()];
    names.sort();
    assert_eq!(names, ["x1", "y1"]);
    for sensor in [x1, y1] {
        let lost = sensor.end_watch().await.unwrap_err();
        assert!(matches!(lost, SensorError::Link(_)), "{}: {lost}", sensor.name());
    }
}

#[tokio::test]
async fn two_queried_sensors_take_turns_on_one_port() {
    let Pty { mut device, path, client_side: _client } = create_pty().unwrap();
    let addressed = tokio::spawn(async move {
        let mut request = [0; 3];
        while device.read_exact(&mut request).await.is_ok() {
            let reply: &[u8] = if request == *b"M1\r" { b"0.1\n" } else { b"0.2\n" };
            sleep(Duration::from_millis(1)).await;
            device.write_all(reply).await.unwrap();
        }
    });
    let queried = |name: &str, request: &str| {
        let line = "[serial.line]\nvalue = { scale_mm = 1.0 }\n";
        parse_sensor_entry(name, &format!("[serial]\nserial = \"{path}\"\nrequest = \"{request}\\r\"\n{line}"))
    };
    let sensors = new_sensor_opener(&[queried("x1", "M1"), queried("y1", "M2")]);
    let (x1, y1) = (sensors.open("x1").await.unwrap(), sensors.open("y1").await.unwrap());
    let (of_x1, of_y1) = tokio::join!(x1.read_samples(50), y1.read_samples(50));
    assert_eq!(values_mm(&of_x1.unwrap()), [0.1; 50]);
    assert_eq!(values_mm(&of_y1.unwrap()), [0.2; 50]);
    addressed.abort();
}

/// Request to read input register 0 of unit 1, with its CRC.
const READ_REQUEST_TO_UNIT_1: [u8; 8] = [0x01, 0x04, 0x00, 0x00, 0x00, 0x01, 0x31, 0xCA];
/// Request to read input register 0 of unit 2, with its CRC.
const READ_REQUEST_TO_UNIT_2: [u8; 8] = [0x02, 0x04, 0x00, 0x00, 0x00, 0x01, 0x31, 0xF9];
/// Register value 123: 0.0123 mm at a scale of 1e-4 mm.
const REPLY_OF_UNIT_1: [u8; 7] = [0x01, 0x04, 0x02, 0x00, 0x7B, 0xF9, 0x13];
/// Register value -40: -0.0040 mm at a scale of 1e-4 mm.
const REPLY_OF_UNIT_2: [u8; 7] = [0x02, 0x04, 0x02, 0xFF, 0xD8, 0xBC, 0x9A];

fn modbus_unit_sensor(name: &str, path: &str, unit: u8) -> SensorEntry {
    let value = "value = { register = 0, type = \"i16\", scale_mm = 1e-4 }\n";
    let port = format!("serial = \"{path}\"\nparity = \"none\"\nbaud = 115200\n");
    parse_sensor_entry(name, &format!("[modbus]\n{port}unit = {unit}\ntimeout_s = 0.1\n{value}"))
}

#[tokio::test]
async fn two_sensors_read_their_units_on_one_modbus_line() {
    let Pty { mut device, path, client_side: _client } = create_pty().unwrap();
    let bus = tokio::spawn(async move {
        let (mut request, mut owed) = ([0; 8], 0);
        for count in 0_u32.. {
            device.read_exact(&mut request).await.unwrap();
            match request {
                // A late reply of unit 2 arrives before the reply of unit 1.
                READ_REQUEST_TO_UNIT_1 if owed > 0 => {
                    owed -= 1;
                    device.write_all(&REPLY_OF_UNIT_2).await.unwrap();
                    device.write_all(&REPLY_OF_UNIT_1).await.unwrap();
                }
                READ_REQUEST_TO_UNIT_1 => device.write_all(&REPLY_OF_UNIT_1).await.unwrap(),
                READ_REQUEST_TO_UNIT_2 if count % 20 == 19 => owed += 1,
                READ_REQUEST_TO_UNIT_2 => device.write_all(&REPLY_OF_UNIT_2).await.unwrap(),
                other => panic!("{other:02X?}"),
            }
        }
    });
    let sensors = new_sensor_opener(&[modbus_unit_sensor("x1", &path, 1), modbus_unit_sensor("y1", &path, 2)]);
    let (x1, y1) = (sensors.open("x1").await.unwrap(), sensors.open("y1").await.unwrap());
    let (of_x1, of_y1) = tokio::join!(x1.read_samples(40), y1.read_samples(40));
    let (of_x1, of_y1) = (of_x1.unwrap(), of_y1.unwrap());
    assert!(of_x1.len() == 40 && values_mm(&of_x1).len() > 20, "{of_x1:?}");
    assert!(of_y1.len() == 40 && values_mm(&of_y1).len() > 20, "{of_y1:?}");
    assert!(values_mm(&of_x1).iter().all(|mm| (mm - 0.0123).abs() < 1e-12), "{of_x1:?}");
    assert!(values_mm(&of_y1).iter().all(|mm| (mm + 0.0040).abs() < 1e-12), "{of_y1:?}");
    bus.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_sensors_read_one_modbus_tcp_server_concurrently() {
    let distance = Box::new(|| SensorOutput::Distance(0.25));
    let (at, _) = serve_on_tcp(SampleTiming::AtFixedRate, distance, 200.0).unwrap();
    let reached = format!("[modbus]\n{}{DATA_SHEET_TOML}", at.to_toml());
    let sensors = new_sensor_opener(&[parse_sensor_entry("x1", &reached), parse_sensor_entry("y1", &reached)]);
    let (x1, y1) = (sensors.open("x1").await.unwrap(), sensors.open("y1").await.unwrap());
    let (of_x1, of_y1) = tokio::join!(x1.read_samples(10), y1.read_samples(10));
    for samples in [of_x1.unwrap(), of_y1.unwrap()] {
        assert_eq!(values_mm(&samples).len(), 10, "{samples:?}");
    }
}

/// Result for a machine file whose sensors `a` and `b` have these two interface tables.
fn parse_with_interfaces(interface_of_a: &str, interface_of_b: &str) -> Result<MachineFile, String> {
    let simulated = "simulated = { rate_hz = 1000.0 }";
    let text = include_str!("../../config/r-test.toml");
    let text = text.replacen(simulated, interface_of_a, 1).replacen(simulated, interface_of_b, 1);
    MachineFile::parse("shop.toml", text).map_err(|error| error.to_string())
}

#[test]
fn sensors_of_one_port_must_agree_on_its_keys() {
    let a = "serial = { serial = \"/dev/ttyS7\", baud = 9600, line = { separator = \",\", \
             value = { column = 1, scale_mm = 1.0 } } }";
    let b = a.replace("column = 1", "column = 2");
    parse_with_interfaces(a, &b).unwrap();
    let refused = |from: &str, to: &str, expected: &str| {
        assert!(b.contains(from), "{from}");
        let error = parse_with_interfaces(a, &b.replace(from, to)).unwrap_err();
        assert!(error.starts_with("shop.toml:"), "{error}");
        let expected = format!(
            "`b` shares the port /dev/ttyS7 with `a`, but {expected} there: set the same value for all sensors \
             of a port"
        );
        assert!(error.contains(&expected), "{error}");
    };
    refused("baud = 9600", "baud = 115200", "`baud` is 115200 here and 9600");
    refused("9600,", "9600, timeout_s = 2,", "`timeout_s` is 2 here and 0.5");
    refused("9600,", "9600, request = \"M\",", "`request` is set here and not set");
    refused("\",\"", "\";\"", "`separator` is \";\" here and \",\"");
    refused("line = {", "line = { end = \"\\r\",", "`end` is \"\\r\" here and \"\\n\"");
    let modbus = |baud: u32, unit: u8| {
        format!(
            "modbus = {{ serial = \"/dev/ttyS7\", baud = {baud}, unit = {unit}, \
             value = {{ register = 0, type = \"i16\", scale_mm = 1e-4 }} }}"
        )
    };
    parse_with_interfaces(&modbus(9600, 1), &modbus(9600, 2)).unwrap();
    let error = parse_with_interfaces(&modbus(9600, 1), &modbus(19_200, 2)).unwrap_err();
    assert!(error.contains("`baud` is 19200 here and 9600 there"), "{error}");
    let error = parse_with_interfaces(a, &modbus(9600, 2)).unwrap_err();
    assert!(error.contains("its table is [sensor.modbus] here and [sensor.serial]"), "{error}");
    // Sensors on different ports need not agree.
    parse_with_interfaces(a, &modbus(9600, 2).replace("ttyS7", "ttyS8")).unwrap();
}

#[test]
fn encoder_section_and_encoder_count_require_each_other() {
    let encoder = |table: &str, of_a: &str| {
        let text = include_str!("../../config/r-test.toml");
        let text = text.replacen("simulated = { rate_hz = 1000.0 }", of_a, 1);
        MachineFile::parse("shop.toml", format!("{text}\n{table}")).map_err(|error| error.to_string())
    };
    let counts = "serial = { serial = \"/dev/ttyS7\", line = { separator = \",\", \
                  value = { column = 1, scale_mm = 1.0 }, encoder_count = { column = 2 } } }";
    let plain = counts.replace(", encoder_count = { column = 2 }", "");
    let table = "[encoder]\naxis = \"C\"\ncounts_per_turn = -36000\n";
    let stated = encoder(table, counts).unwrap().encoder.unwrap();
    assert_eq!((stated.axis, stated.counts_per_turn), (machine::Axis::C, -36_000));
    encoder("", &plain).unwrap();
    let refused = |table: &str, of_a: &str, expected: &str| {
        let error = encoder(table, of_a).unwrap_err();
        assert!(error.starts_with("shop.toml:") && error.contains(expected), "{error}");
    };
    refused("", counts, "has `encoder_count`: add the section [encoder] with `axis` and `counts_per_turn`");
    refused(table, &plain, "no sensor has `encoder_count`");
    refused(&table.replace("-36000", "0"), counts, "`counts_per_turn` in [encoder] is 0");
    refused(&table.replace("-36000", "0.1"), counts, "counts_per_turn");
    for axis in ["X", "S", "A"] {
        let other = table.replace("\"C\"", &format!("\"{axis}\""));
        refused(&other, counts, &format!("`axis` in [encoder] is {axis}; it must be a rotary axis of this machine"));
    }
}
