//! Tests with frames in memory: written by hand, and from the simulated sensor.

use std::sync::Arc;

use super::CanConfig;
use crate::sensors::{Sample, SensorHandle};
use link::Clock;
use link::can::{CanFrame, CanId, CanReceiver};
use link::clock::HostClock;
use machine::record::reading::ReadingFlag;
use machine::record::sensor;
use simulator::SensorOutput;
use simulator::sensor_devices::{SampleSource, can};

pub(super) fn test_sensor() -> sensor::Sensor {
    serde_json::from_value(serde_json::json!({
        "name": "laser", "zero_mm": [0.0, 0.0, -150.0], "direction": [0.0, 0.0, -1.0],
        "range_mm": [-100.0, 100.0],
    }))
    .unwrap()
}

pub(super) fn parse_config(toml: &str) -> Result<CanConfig, String> {
    toml::from_str(toml).map_err(|error| error.message().to_owned())
}

/// A sensor that sends these frames, one each millisecond, and then nothing.
fn spawn_sensor_with_frames(config: &CanConfig, frames: &[&[u8]]) -> SensorHandle {
    let mut left: std::collections::VecDeque<Vec<u8>> = frames.iter().map(|frame| frame.to_vec()).collect();
    let id = CanId::new(0x123, false).unwrap();
    let mut t_s = 0.0;
    let can = CanReceiver::from_generator("memory", move || {
        t_s += 1e-3;
        Some(CanFrame::new(t_s, id, &left.pop_front()?))
    });
    config.spawn_sensor(can, &test_sensor(), Arc::new(HostClock::start()), None)
}

const LITTLE_ENDIAN_KEYS: &str = r#"
interface = "can0"
id = 0x123
value = { byte = 0, width = 24, order = "little", signed = true, scale_mm = 1e-5 }
counter = { byte = 3, width = 8 }
"#;

fn values_flags_and_lost_counts(samples: &[Sample]) -> Vec<(Option<f64>, ReadingFlag, u32)> {
    // Digits below a picometre are the rounding of the scale.
    let rounded = |mm: f64| (mm * 1e9).round() / 1e9;
    let value_and_flag = |sample: &Sample| (sample.value_mm.map(rounded), sample.flag, sample.lost_before_count);
    samples.iter().map(value_and_flag).collect()
}

#[tokio::test]
async fn frames_become_samples_with_their_flags() {
    let config = parse_config(LITTLE_ENDIAN_KEYS).unwrap();
    let sensor = spawn_sensor_with_frames(
        &config,
        &[
            &[0xFF, 0xFF, 0x7F, 250],
            &[0x00, 0x00, 0x80, 251],
            &[0x01, 0x00, 0x00, 254],
            &[0x01, 0x00, 0x00, 254],
            &[0xA0, 0x37, 0xA0, 255],
        ],
    );
    let samples = sensor.read_samples(6).await.unwrap();
    assert_eq!(
        values_flags_and_lost_counts(&samples),
        [
            (Some(83.88607), ReadingFlag::None, 0),
            (Some(-83.88608), ReadingFlag::None, 0),
            (Some(1e-5), ReadingFlag::Gap, 2),
            (None, ReadingFlag::Stale, 0),
            (Some(-62.77216), ReadingFlag::None, 0),
            (None, ReadingFlag::Stale, 0),
        ]
    );
    let short = spawn_sensor_with_frames(&config, &[&[1, 2, 3]]).read_samples(1).await.unwrap_err();
    assert_eq!(
        short.to_string(),
        "the data of the sensor do not match the machine file: the frame has 3 bytes, \
                                   but the layout needs 4 (id 123 on memory)"
    );
}

pub(super) struct StoppedClock;

impl Clock for StoppedClock {
    fn now_s(&self) -> f64 {
        12.5
    }
}

#[tokio::test]
async fn frames_of_the_simulated_sensor_are_read() {
    let sees = [
        SensorOutput::Distance(1.234_56),
        SensorOutput::NoEcho,
        SensorOutput::TooMuchLight,
        SensorOutput::OutOfRange(11.0),
        SensorOutput::Distance(-0.5),
        // A distance beyond the range of 24 bits.
        SensorOutput::Distance(90.0),
    ];
    let mut sees = sees.into_iter();
    let sense: SampleSource = Box::new(move || sees.next().unwrap());
    let clock: Arc<dyn Clock> = Arc::new(StoppedClock);
    let mut frames = can::frame_generator(sense, clock.clone());
    // By hand from the data sheet: 123456 counts are 0x01E240.
    let first = frames().unwrap();
    assert_eq!(first.data(), [0, 1, 0x01, 0xE2, 0x40, 0]);
    assert_eq!((first.id, first.received_s), (CanId::new(0x181, false).unwrap(), 12.5));
    let can = CanReceiver::from_generator("memory", frames);
    let keys = format!("interface = \"memory\"\n{}", can::DATA_SHEET_TOML);
    let config: CanConfig = toml::from_str(&keys).unwrap();
    let samples = config.spawn_sensor(can, &test_sensor(), clock, None).read_samples(5).await.unwrap();
    assert_eq!(
        values_flags_and_lost_counts(&samples),
        [
            (None, ReadingFlag::Range, 0),
            (None, ReadingFlag::Saturated, 0),
            (None, ReadingFlag::Range, 0),
            (Some(-0.5), ReadingFlag::None, 0),
            (None, ReadingFlag::Range, 0),
        ]
    );
    assert!(samples.iter().all(|sample| sample.received_s == 12.5));
}

#[test]
fn invalid_config_keys_are_refused_with_a_reason() {
    let value = "value = { byte = 0, width = 24, order = \"big\", scale_mm = 1e-5 }";
    let refused = [
        ("interface = \"can0\"\nid = 0x800", "`id` 0x800 is too large for 11 bits"),
        ("interface = \"can0\"\nid = 0x20000000\nextended = true", "`id` 0x20000000 is too large"),
        ("interface = \"\"\nid = 1", "`interface` is ``"),
        ("interface = \"../../etc/x\"\nid = 1", "set a name from `ip link`"),
        ("interface = \"can0\"\nid = 1\nlength = 9", "`length` is 9"),
        ("interface = \"can0\"\nid = 1\nlength = 2", "`value` extends to byte 2"),
        ("interface = \"can0\"\nid = 1\ntimeout_s = 0.0", "`timeout_s` is 0"),
        ("interface = \"can0\"\nid = \"0x123\"", "invalid type: string"),
        ("interface = \"can0\"\nid = 1\nbitrate = 500000", "unknown field `bitrate`"),
    ];
    for (keys, why) in refused {
        let error = parse_config(&format!("{keys}\n{value}")).unwrap_err();
        assert!(error.contains(why), "{keys}: {error}");
    }
}
