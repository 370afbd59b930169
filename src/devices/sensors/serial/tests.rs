//! Tests of the driver with bytes written by hand.

use std::sync::Arc;
use std::time::Duration;

use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

use super::config::SerialConfig;
use super::driver::SerialDriver;
use super::splitter::{StreamPiece, StreamSplitter};
use crate::sensors::{Sample, SensorDriver, SensorError};
use link::clock::HostClock;
use link::{Pty, SharedPorts, create_pty_at_baud};
use machine::record::reading::ReadingFlag;
use machine::record::sensor::Sensor;

const LINE_LAYOUT: &str = r#"
[line]
end = "\r\n"
prefix = "D"
separator = ";"
value = { column = 1, scale_mm = 0.001, codes = [{ is = "----", means = "no-echo" }] }
counter = { column = 2, round = 100 }
status = [{ column = 3, is = "S", means = "saturated" }]
"#;

const FRAME_LAYOUT: &str = r#"
[frame]
sync = [0xA5, 0x5A]
length = 5
order = "little"
value = { byte = 0, width = 24, signed = true, scale_mm = 0.001 }
counter = { byte = 3, width = 8 }
status = [{ byte = 4, bit = 7, means = "range" }]
checksum = { kind = "xor" }
tail = [0x0D]
"#;

fn parse_config(toml: &str) -> SerialConfig {
    toml::from_str(&format!("tcp = \"127.0.0.1:9\"\n{toml}")).unwrap()
}

fn config_error(toml: &str) -> String {
    toml::from_str::<SerialConfig>(&format!("tcp = \"127.0.0.1:9\"\n{toml}")).unwrap_err().to_string()
}

pub fn test_sensor() -> Sensor {
    serde_json::from_value(json!({
        "name": "laser", "zero_mm": [0, 0, -150], "direction": [0, 0, -1], "range_mm": [-10, 10]
    }))
    .unwrap()
}

fn host_clock() -> Arc<HostClock> {
    Arc::new(HostClock::start())
}

/// Value or flag, and the count.
type ValueAndCount = (Result<f64, ReadingFlag>, Option<u64>);

/// Decoded pieces of a stream that arrives in `parts`: value or flag with the count, and `None` for bytes that could
/// not be decoded.
fn decode_parts(layout: &str, parts: &[&[u8]]) -> Vec<Option<ValueAndCount>> {
    let mut splitter = StreamSplitter::new(parse_config(layout).format);
    splitter.discard_buffer(false);
    let pieces = parts.iter().flat_map(|part| splitter.push(part)).collect::<Vec<_>>();
    let value_and_count = |piece| match piece {
        StreamPiece::Decoded { sample, .. } => Some((sample.value_mm, sample.counter_value)),
        StreamPiece::Undecodable(_) => None,
    };
    pieces.into_iter().map(value_and_count).collect()
}

fn value_mm_and_count(value: f64, count: u64) -> Option<ValueAndCount> {
    Some((Ok(value), Some(count)))
}

#[test]
fn lines_split_anywhere_give_the_same_samples() {
    let bytes = b"D+2000;07;\r\n\r\nD -1500 ; 8;\r\nD----;9;\r\nD5;10;S\r\n";
    let expected = [
        value_mm_and_count(2.0, 7),
        value_mm_and_count(-1.5, 8),
        Some((Err(ReadingFlag::Range), Some(9))),
        Some((Err(ReadingFlag::Saturated), Some(10))),
    ];
    for at in 0..bytes.len() {
        assert_eq!(decode_parts(LINE_LAYOUT, &[&bytes[..at], &bytes[at..]]), expected, "cut at {at}");
    }
}

#[test]
fn invalid_or_endless_line_gives_no_sample() {
    for line in ["E2000;07;", "D2000", "D2000;x;", "Dinf;7;", "D1e999;7;", "D;7;", "D20 00;7;", "D1;100;"] {
        assert_eq!(decode_parts(LINE_LAYOUT, &[line.as_bytes(), b"\r\n"]), [None], "{line}");
    }
    assert_eq!(decode_parts(LINE_LAYOUT, &[b"D1\xFF;7;\r\nD1000;8;\r\n"]), [None, value_mm_and_count(1.0, 8)]);
    // An endless line is reported once for each piece of it, and is not stored.
    assert_eq!(
        decode_parts(LINE_LAYOUT, &[&[b'D'; 600], &[b'D'; 300], b"\r\nD1000;8;\r\n"]),
        [None, value_mm_and_count(1.0, 8)]
    );
}

/// 24 bits, little-endian: 2000 = D0 07 00, -1500 = 24 FA FF; the exclusive or was computed by hand.
const FRAME_OF_2000_UM: [u8; 9] = [0xA5, 0x5A, 0xD0, 0x07, 0x00, 0x07, 0x00, 0xD0, 0x0D];
const FRAME_OF_MINUS_1500_UM: [u8; 9] = [0xA5, 0x5A, 0x24, 0xFA, 0xFF, 0x08, 0x00, 0x29, 0x0D];
const OUT_OF_RANGE_FRAME: [u8; 9] = [0xA5, 0x5A, 0x00, 0x00, 0x00, 0x09, 0x80, 0x89, 0x0D];

#[test]
fn frames_split_anywhere_give_the_same_samples() {
    let bytes = [FRAME_OF_2000_UM, FRAME_OF_MINUS_1500_UM, OUT_OF_RANGE_FRAME].concat();
    let expected = [value_mm_and_count(2.0, 7), value_mm_and_count(-1.5, 8), Some((Err(ReadingFlag::Range), Some(9)))];
    for at in 0..bytes.len() {
        assert_eq!(decode_parts(FRAME_LAYOUT, &[&bytes[..at], &bytes[at..]]), expected, "cut at {at}");
    }
}

#[test]
fn missing_or_altered_byte_loses_one_frame() {
    for at in 0..9 {
        let mut short = FRAME_OF_2000_UM.to_vec();
        short.remove(at);
        let found = decode_parts(
            FRAME_LAYOUT,
            &[&FRAME_OF_MINUS_1500_UM, &short, &OUT_OF_RANGE_FRAME, &FRAME_OF_MINUS_1500_UM],
        );
        let good: Vec<_> = found.into_iter().flatten().collect();
        assert_eq!(good.len(), 3, "without byte {at}: {good:?}");
        let mut flipped = FRAME_OF_2000_UM;
        flipped[at] ^= 0x10;
        let found = decode_parts(FRAME_LAYOUT, &[&FRAME_OF_MINUS_1500_UM, &flipped, &OUT_OF_RANGE_FRAME]);
        assert_eq!(found.iter().flatten().count(), 2, "byte {at} flipped: {found:?}");
    }
    // A value equal to the sync bytes, A5 5A 00: the checksum shows the true beginning.
    let alike = [0xA5, 0x5A, 0xA5, 0x5A, 0x00, 0x03, 0x00, 0xFC, 0x0D];
    assert_eq!(decode_parts(FRAME_LAYOUT, &[&alike[1..], &alike]).into_iter().flatten().count(), 1);
}

#[test]
fn invalid_layouts_are_refused_with_a_reason() {
    let line = |from: &str, to: &str| config_error(&LINE_LAYOUT.replace(from, to));
    assert!(line("scale_mm = 0.001", "scale_mm = 0.0").contains("all readings would be equal"));
    assert!(line("scale_mm = 0.001", "scale_mm = \"x\"").contains("invalid type"));
    assert!(line("{ column = 2, round", "{ column = 1, round").contains("are both column 1"));
    assert!(line("column = 3, is", "column = 2, is").contains("are both column 2"));
    assert!(line("{ column = 1,", "{ column = 0,").contains("the first column is 1"));
    assert!(line("separator = \";\"", "").contains("has only one column"));
    assert!(line("separator = \";\"", "separator = \".\"").contains("can be part of a number"));
    assert!(line("separator = \";\"", "separator = \";\"\ncolumns = 2").contains("has 2 columns"));
    assert!(line("round = 100", "round = 1").contains("2 to 4294967296"));
    assert!(line("end = \"\\r\\n\"", "end = \"\"").contains("`end` is empty"));
    assert!(line("prefix = \"D\"", "prefix = \"D\\r\\n\"").contains("a line could never match"));
    assert!(line("[line]", "rate_hz = 5\n[line]").contains("is only for sensors with `request`"));
    assert!(config_error("").contains("exactly one of"));
    let frame = |from: &str, to: &str| config_error(&FRAME_LAYOUT.replace(from, to));
    assert!(frame("{ byte = 3, width = 8 }", "{ byte = 2, width = 8 }").contains("overlap"));
    assert!(frame("length = 5", "length = 4").contains("extends to byte 4"));
    assert!(frame("sync = [0xA5, 0x5A]", "sync = []").contains("the first bytes of each frame"));
    assert!(frame("scale_mm = 0.001", "scale_mm = 0").contains("all readings would be equal"));
    assert!(frame("kind = \"xor\"", "kind = \"crc32\"").contains("needs an `order`"));
    assert!(frame("kind = \"xor\"", "kind = \"luhn\"").contains("unknown variant"));
}

/// A driver, and the TCP stream on which the test plays the sensor.
async fn driver_and_tcp_peer(layout: &str) -> (SerialDriver, TcpStream) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let at = listener.local_addr().unwrap();
    let config = toml::from_str(&format!("tcp = \"{at}\"\ntimeout_s = 0.2\n{layout}")).unwrap();
    let serial = SerialDriver::open(config, &test_sensor(), host_clock(), SharedPorts::default()).await.unwrap();
    (serial, listener.accept().await.unwrap().0)
}

/// Value in um or flag, and number of missing samples.
fn um_flag_and_missing_count(sample: Sample) -> (i64, &'static str, u32) {
    let um = sample.value_mm.map_or(0, |mm| (mm * 1000.0).round() as i64);
    assert_eq!(sample.value_mm.is_some(), matches!(sample.flag, ReadingFlag::None | ReadingFlag::Gap));
    (um, sample.flag.as_str(), sample.lost_before_count)
}

#[tokio::test]
async fn lines_become_flagged_samples_with_lost_counts() {
    let (mut serial, mut far) = driver_and_tcp_peer(LINE_LAYOUT).await;
    far.write_all(b"rest of a line\r\nD1;97;\r\nD2;98;\r\nD3;98;\r\nD-11000;99;\r\nD4;0;\r\n").await.unwrap();
    far.write_all(b"D5;4;\r\nnoise\r\nD6;6;\r\nD----;8;\r\nD7;9;S\r\nD8;10;\r\n").await.unwrap();
    let expected = [
        (1, "", 0),
        (2, "", 0),
        (0, "stale", 0),
        (0, "range", 0),
        (4, "", 0),
        (5, "gap", 3),
        (6, "gap", 1),
        (0, "range", 1),
        (0, "saturated", 0),
        (8, "", 0),
        (0, "stale", 0),
    ];
    for expected in expected {
        assert_eq!(um_flag_and_missing_count(serial.next().await.unwrap()), expected);
    }
    far.write_all(b"D9;11;\r\nD10;12;\r\n").await.unwrap();
    assert_eq!(um_flag_and_missing_count(serial.next().await.unwrap()), (9, "", 0));
    serial.discard_old_samples().await.unwrap();
    // Samples that were not read are not missing.
    far.write_all(b"D11;50;\r\nD12;51;\r\n").await.unwrap();
    assert_eq!(um_flag_and_missing_count(serial.next().await.unwrap()), (12, "", 0));
    drop(far);
    let lost = serial.next().await.unwrap_err();
    assert!(matches!(lost, SensorError::Link(_)), "{lost}");
}

#[tokio::test]
async fn corruption_without_counter_is_a_gap_of_unknown_size() {
    let layout = "[line]\nvalue = { scale_mm = 0.001 }";
    let (mut serial, mut far) = driver_and_tcp_peer(layout).await;
    far.write_all(b"half\n1\nx\ny\n2\n3\n").await.unwrap();
    for expected in [(1, "", 0), (2, "gap", 0), (3, "", 0)] {
        assert_eq!(um_flag_and_missing_count(serial.next().await.unwrap()), expected);
    }
}

#[tokio::test]
async fn late_reply_is_not_assigned_to_the_next_request() {
    let (mut serial, mut far) = driver_and_tcp_peer(&format!("request = \"M0\\r\"\n{LINE_LAYOUT}")).await;
    let device = tokio::spawn(async move {
        let mut asked = [0; 3];
        far.read_exact(&mut asked).await.unwrap();
        assert_eq!(&asked, b"M0\r");
        tokio::time::sleep(Duration::from_millis(300)).await;
        far.write_all(b"D1;1;\r\n").await.unwrap();
        far.read_exact(&mut asked).await.unwrap();
        far.write_all(b"D2;2;\r\n").await.unwrap();
        far
    });
    assert_eq!(um_flag_and_missing_count(serial.next().await.unwrap()), (0, "stale", 0));
    assert_eq!(um_flag_and_missing_count(serial.next().await.unwrap()), (2, "", 0));
    drop(device.await.unwrap());
}

async fn prepare_error(layout: &str, sent: &'static [u8]) -> SensorError {
    let (mut serial, mut far) = driver_and_tcp_peer(layout).await;
    let device = tokio::spawn(async move {
        while !sent.is_empty() && far.write_all(sent).await.is_ok() {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        far
    });
    let error = serial.prepare().await.unwrap_err();
    device.abort();
    error
}

#[tokio::test]
async fn unreadable_sensor_is_refused_with_a_remedy() {
    let silent = prepare_error(LINE_LAYOUT, b"").await;
    assert!(matches!(silent, SensorError::Silent { .. }), "{silent}");
    let noise = prepare_error(LINE_LAYOUT, b"\x80\xF8\x00\x98\x1E\r\n").await;
    assert!(noise.to_string().contains("mostly noise"), "{noise}");
    assert!(noise.remedy().contains("baud rate"), "{}", noise.remedy());
    let text = prepare_error(LINE_LAYOUT, b"Dabc;1;\r\n").await;
    assert!(text.to_string().contains("Dabc;1;"), "{text}");
    assert!(text.remedy().contains("a number in the column of the value"), "{}", text.remedy());
    let endless = prepare_error(LINE_LAYOUT, b"D1;1;\r").await;
    assert!(endless.remedy().contains("`end`"), "{endless}: {}", endless.remedy());
    let frames = prepare_error(FRAME_LAYOUT, b"D1;1;\r\n").await;
    assert!(frames.remedy().contains("sync"), "{}", frames.remedy());
}

#[tokio::test]
async fn wrong_baud_rate_is_named_in_the_remedy() {
    let Pty { mut device, path, .. } = create_pty_at_baud(38_400).unwrap();
    let sends = tokio::spawn(async move {
        for count in 0_u64.. {
            let line = format!("D{};{};\r\n", 1000 + count % 7, count % 100);
            device.write_all(line.as_bytes()).await.unwrap();
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    });
    let at = |baud: u32| {
        let keys = format!("serial = \"{path}\"\nbaud = {baud}\n{LINE_LAYOUT}");
        let config = toml::from_str(&keys).unwrap();
        async move { SerialDriver::open(config, &test_sensor(), host_clock(), SharedPorts::default()).await }
    };
    for baud in [115_200, 57_600, 9_600] {
        let mut serial = loop {
            // The previous driver closes its port on a thread of its own.
            match at(baud).await {
                Err(_) => tokio::time::sleep(Duration::from_millis(1)).await,
                Ok(serial) => break serial,
            }
        };
        let error = serial.prepare().await.unwrap_err();
        assert!(error.remedy().contains(&format!("another baud rate than {baud}")), "{baud}: {error}");
    }
    sends.abort();
}

#[tokio::test]
async fn encoder_count_is_part_of_the_sample() {
    let columns = "separator = \",\"\nvalue = { column = 1, scale_mm = 0.001 }\n";
    let layout = format!("[line]\n{columns}encoder_count = {{ column = 2, round = 65536 }}");
    let (mut serial, mut far) = driver_and_tcp_peer(&layout).await;
    far.write_all(b"\n1,65535\n2,0\n3,-1\n4,x\n5,65537\n").await.unwrap();
    for count in [65_535, 0, 65_535, 1] {
        assert_eq!(serial.next().await.unwrap().encoder_count, Some(count));
    }
    // No data come.
    assert_eq!(serial.next().await.unwrap().encoder_count, None);
    let endless = format!("[line]\n{columns}encoder_count = {{ column = 2 }}");
    assert_eq!(parse_config(&endless).format.encoder_modulus(), Some(1 << 32));
    assert_eq!(parse_config(LINE_LAYOUT).format.encoder_modulus(), None);
    let same = format!("[line]\n{columns}encoder_count = {{ column = 1 }}");
    assert!(config_error(&same).contains("`value` and `encoder_count` are both column 1"));
}
