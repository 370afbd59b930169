//! Bytes that the drivers of sensors and thermometers send over TCP to a peer with fixed replies, and their
//! interpretation of the replies.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, channel};
use std::thread;

use serde_json::Value;

use super::compare::check_text_against_baseline;
use super::method_cases::{LASER_MACHINE_FILE, SIMULATED_MACHINE_FILE, append_method_settings};
use super::workspace::{Workspace, replace_line_starts, stderr_text};

/// Number of samples after which distances repeat; the fourth sample is not a distance.
const DISTANCE_PERIOD_SAMPLES: u32 = 8;
/// Number of samples that are read from each sensor: the driver may omit the first ones of a sensor that sends
/// without requests.
const READ_SAMPLE_COUNT: usize = 3 * DISTANCE_PERIOD_SAMPLES as usize;

/// A peer on a free port of this computer, for one connection; it sends its log of requests.
struct SensorPeer {
    port: u16,
    requests: Receiver<Vec<u8>>,
}

impl SensorPeer {
    fn start(serve: impl FnOnce(TcpStream, &mut dyn FnMut(Vec<u8>)) + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let (log, requests) = channel();
        thread::spawn(move || {
            let (stream, _) = listener.accept().unwrap();
            stream.set_nodelay(true).unwrap();
            serve(stream, &mut |request| drop(log.send(request)));
        });
        Self { port, requests }
    }

    /// The first `count` requests, one per line.
    fn first_requests_text(&self, count: usize) -> String {
        let shown = |request: Vec<u8>| format!("> {}\n", request.escape_ascii());
        self.requests.iter().take(count).map(shown).collect()
    }
}

/// A sensor that sends without a request until the connection ends.
fn start_streaming_peer(sample: impl Fn(u32) -> Vec<u8> + Send + 'static) -> SensorPeer {
    SensorPeer::start(move |mut stream, _| {
        for index in 0.. {
            if stream.write_all(&sample(index)).is_err() {
                return;
            }
            thread::sleep(std::time::Duration::from_millis(2));
        }
    })
}

/// A sensor that sends one line for each request, which ends with a carriage return.
fn start_polled_peer(sample: impl Fn(u32) -> Vec<u8> + Send + 'static) -> SensorPeer {
    SensorPeer::start(move |mut stream, log| {
        let (mut request, mut byte, mut index) = (Vec::new(), [0], 0);
        while stream.read_exact(&mut byte).is_ok() {
            request.push(byte[0]);
            if byte[0] == b'\r' {
                log(std::mem::take(&mut request));
                if stream.write_all(&sample(index)).is_err() {
                    return;
                }
                index += 1;
            }
        }
    })
}

/// A Modbus TCP server that answers each register request with the next content. In the log the transaction number
/// is zero, because it is a counter.
fn start_modbus_peer(register_content: impl Fn(u32) -> Vec<u16> + Send + 'static) -> SensorPeer {
    SensorPeer::start(move |mut stream, log| {
        for index in 0.. {
            let mut request = [0; 12];
            if stream.read_exact(&mut request).is_err() {
                return;
            }
            let count = u16::from_be_bytes([request[10], request[11]]);
            let mut registers = register_content(index);
            registers.resize(usize::from(count), 0);
            let body: Vec<u8> = registers.iter().flat_map(|word| word.to_be_bytes()).collect();
            let length = u8::try_from(body.len()).unwrap();
            let head = [request[0], request[1], 0, 0, 0, length + 3, request[6], request[7], length];
            let reply = [&head[..], &body].concat();
            request[..2].fill(0);
            log(request.to_vec());
            if stream.write_all(&reply).is_err() {
                return;
            }
        }
    })
}

/// Samples as `trued watch` prints them, without their wall time: one period, from the sample without a distance
/// on.
fn watched_samples_text(sensor_keys: &str) -> String {
    let from = "[sensor.simulated]\nspeaks = \"can\"\nwire = \"memory\"\n";
    let workspace = Workspace::with_machine_file(&replace_line_starts(LASER_MACHINE_FILE, &[(from, sensor_keys)]));
    let (machine, samples) = (workspace.file_path("machine.toml"), READ_SAMPLE_COUNT.to_string());
    let arguments = ["watch", "laser", "--machine", &machine, "--samples", &samples, "--json"];
    let output = workspace.run_trued(&arguments);
    assert!(output.status.success(), "{}", stderr_text(&output));
    let sample = |line: &str| {
        let mut sample: Value = serde_json::from_str(line).unwrap();
        sample.as_object_mut().unwrap().remove("t_s").unwrap();
        sample
    };
    let samples: Vec<Value> = String::from_utf8(output.stdout).unwrap().lines().map(sample).collect();
    let period = samples.iter().skip_while(|sample| !sample["value_mm"].is_null());
    period.take(DISTANCE_PERIOD_SAMPLES as usize).map(|sample| format!("{sample}\n")).collect()
}

/// Distance of the sample in units of 10 nm. `None`: the sample is not a distance.
fn distance_in_10_nm(index: u32) -> Option<i32> {
    let index = index % DISTANCE_PERIOD_SAMPLES;
    (index != 3).then_some(-12_345 + 1_111 * i32::try_from(index).unwrap())
}

fn text_line(index: u32) -> Vec<u8> {
    let counter = index % 10_000;
    match distance_in_10_nm(index) {
        Some(value) => format!("M0,{:+.5},{counter:04}\r\n", f64::from(value) * 1e-5).into_bytes(),
        None => format!("M0,-FFFFFFF,{counter:04}\r\n").into_bytes(),
    }
}

const TEXT_LINE_KEYS: &str = "[sensor.serial.line]\nseparator = \",\"\nprefix = \"M0\"\n\
                    value = { column = 2, scale_mm = 1.0, codes = [{ is = \"-FFFFFFF\", means = \"no-echo\" }] }\n\
                    counter = { column = 3, round = 10000 }\n";

pub fn serial_text_lines_are_read_as_stored() {
    let peer = start_streaming_peer(text_line);
    let sensor = format!("[sensor.serial]\ntcp = \"127.0.0.1:{}\"\n{TEXT_LINE_KEYS}", peer.port);
    check_text_against_baseline("sensors/serial-lines.txt", &watched_samples_text(&sensor));
}

pub fn polled_text_lines_and_requests_are_as_stored() {
    let peer = start_polled_peer(text_line);
    let keys = "rate_hz = 500.0\nrequest = \"M0\\r\"\n";
    let sensor = format!("[sensor.serial]\ntcp = \"127.0.0.1:{}\"\n{keys}{TEXT_LINE_KEYS}", peer.port);
    let samples = watched_samples_text(&sensor);
    check_text_against_baseline(
        "sensors/serial-lines-on-request.txt",
        &(samples + &peer.first_requests_text(DISTANCE_PERIOD_SAMPLES as usize)),
    );
}

/// Sync, distance (32 bits), counter, CRC-16/MODBUS of distance and counter, low byte first.
fn byte_frame(index: u32) -> Vec<u8> {
    let value = distance_in_10_nm(index).unwrap_or(i32::MAX).to_be_bytes();
    let body = [&value[..], &[index as u8]].concat();
    let crc = body.iter().fold(0xFFFF_u16, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xA001 } else { crc >> 1 })
    });
    [&[0xAA, 0x55][..], &body, &crc.to_le_bytes()].concat()
}

pub fn serial_byte_frames_are_read_as_stored() {
    let peer = start_streaming_peer(byte_frame);
    let keys = "[sensor.serial.frame]\nsync = [0xAA, 0x55]\nlength = 5\norder = \"big\"\n\
                value = { byte = 0, width = 32, signed = true, scale_mm = 1e-5, \
                codes = [{ is = 0x7FFFFFFF, means = \"no-echo\" }] }\n\
                counter = { byte = 4, width = 8 }\nchecksum = { kind = \"crc16-modbus\", order = \"little\" }\n";
    let sensor = format!("[sensor.serial]\ntcp = \"127.0.0.1:{}\"\n{keys}", peer.port);
    check_text_against_baseline("sensors/serial-frames.txt", &watched_samples_text(&sensor));
}

pub fn modbus_sensor_samples_and_requests_are_as_stored() {
    let peer = start_modbus_peer(|index| {
        let value = distance_in_10_nm(index).unwrap_or_default() as u32;
        let status = u16::from(distance_in_10_nm(index).is_none());
        vec![(value >> 16) as u16, value as u16, index as u16, status]
    });
    let keys = "rate_hz = 100.0\nvalue = { register = 0, type = \"i32\", order = \"abcd\", scale_mm = 1e-5 }\n\
                counter = { register = 2, type = \"u16\" }\n\
                status = [{ register = 3, bit = 0, means = \"no-echo\" }]\n";
    let sensor = format!("[sensor.modbus]\ntcp = \"127.0.0.1:{}\"\n{keys}", peer.port);
    let samples = watched_samples_text(&sensor);
    check_text_against_baseline(
        "sensors/modbus.txt",
        &(samples + &peer.first_requests_text(DISTANCE_PERIOD_SAMPLES as usize)),
    );
}

/// The thermometer is polled in wall time, so only its first request is kept. Its value is in every reading.
pub fn readings_with_modbus_thermometer_are_as_stored() {
    let peer = start_modbus_peer(|_| vec![215]);
    let from = "[thermometer.simulated]\n";
    let to = format!(
        "[thermometer.modbus]\ntcp = \"127.0.0.1:{}\"\nvalue = {{ register = 0, type = \"i16\", scale_c = 0.1 }}\n",
        peer.port
    );
    let machine = replace_line_starts(SIMULATED_MACHINE_FILE, &[(from, &to)]);
    let workspace = Workspace::with_machine_file(&append_method_settings(&machine, "latch-delay", ""));
    let machine = workspace.file_path("machine.toml");
    workspace.run_stdout(&["run", "latch-delay", "--machine", &machine, "--json"]);
    workspace.run_stdout(&["export", "1", "--to", &workspace.file_path("export")]);
    let readings = workspace.read_file("export/run-1-readings.csv");
    check_text_against_baseline("sensors/thermometer-modbus.txt", &(readings + &peer.first_requests_text(1)));
}
