//! Tests of the driver against a simulated sensor, and of invalid maps.

use std::sync::Arc;

use serde_json::json;

use super::ModbusSensorDriver;
use super::config::ModbusSensorConfig;
use crate::sensors::SensorDriver;
use link::clock::HostClock;
use machine::record::reading::ReadingFlag;
use machine::record::sensor::Sensor;
use simulator::SensorOutput;
use simulator::sensor_devices::modbus::{SampleTiming, serve_on_tcp};

const REGISTER_MAP_KEYS: &str = r#"
[value]
register = 10
type = "i32"
scale_mm = 0.001
codes = [{ is = -2147483648, means = "no-echo" }]
[counter]
register = 12
type = "u16"
[[status]]
register = 9
bit = 2
width = 2
is = 3
means = "saturated"
[[status]]
register = 9
bit = 15
means = "stale"
"#;

fn config_error(text: &str) -> String {
    toml::from_str::<ModbusSensorConfig>(&format!("tcp = \"127.0.0.1:9\"\n{text}")).unwrap_err().to_string()
}

fn test_sensor() -> Sensor {
    serde_json::from_value(json!({
        "name": "laser", "zero_mm": [0, 0, -150], "direction": [0, 0, -1], "range_mm": [-10, 10]
    }))
    .unwrap()
}

#[test]
fn registers_are_decoded_by_the_map() {
    let config: ModbusSensorConfig = toml::from_str(&format!("tcp = \"127.0.0.1:9\"\n{REGISTER_MAP_KEYS}")).unwrap();
    let map = &config.register_map;
    assert_eq!((map.span.first, map.span.last), (9, 12));
    let read = |words: [u16; 4]| {
        let decoded = map.sample_layout.decode(&words).unwrap();
        (decoded.value_mm, decoded.counter_value)
    };
    assert_eq!(read([0, 0, 2000, 7]), (Ok(2.0), Some(7)));
    // -1500 = FFFF FA24.
    assert_eq!(read([8, 0xFFFF, 0xFA24, 65_535]), (Ok(-1.5), Some(65_535)));
    assert_eq!(read([12, 0, 2000, 8]), (Err(ReadingFlag::Saturated), Some(8)));
    assert_eq!(read([0x8000, 0, 2000, 8]), (Err(ReadingFlag::Stale), Some(8)));
    assert_eq!(read([0, 0x8000, 0, 8]), (Err(ReadingFlag::Range), Some(8)));
    assert_eq!(map.sample_layout.counter_modulus(), Some(65_536));
    // Only the span may be read, and nothing written.
    let allowed = config.device_settings().access_list;
    assert_eq!((allowed.readable, allowed.writable), (vec![map.span], vec![]));

    let float = "value = { register = 0, type = \"f32\", scale_mm = 1, nan = \"no-echo\" }";
    let nan = [0x7FC0, 0];
    let map =
        |keys: &str| toml::from_str::<ModbusSensorConfig>(&format!("tcp = \"a:9\"\n{keys}")).unwrap().register_map;
    assert_eq!(map(float).sample_layout.decode(&nan).unwrap().value_mm, Err(ReadingFlag::Range));
    assert!(map(&float.replace(", nan = \"no-echo\"", "")).sample_layout.decode(&nan).is_err());
}

#[test]
fn encoder_count_is_read_with_the_value() {
    let read = |kind: &str, words: [u16; 6]| {
        let count = format!("encoder_count = {{ register = 13, type = \"{kind}\", order = \"cdab\" }}");
        let text = format!("tcp = \"a:9\"\n{count}\n{REGISTER_MAP_KEYS}");
        let map = toml::from_str::<ModbusSensorConfig>(&text).unwrap().register_map;
        // A 16-bit number is the last register that is read.
        let words = words.get(..usize::from(map.span.last - map.span.first + 1)).unwrap();
        (map.sample_layout.encoder_modulus(), map.sample_layout.decode(words).unwrap().wrapped_encoder_count)
    };
    assert_eq!(read("u32", [0, 0, 2000, 7, 0xFFFE, 0x0001]), (Some(1 << 32), Some(0x1_FFFE)));
    assert_eq!(read("i32", [0, 0, 2000, 7, 0xFFFF, 0xFFFF]), (Some(1 << 32), Some(u32::MAX)));
    assert_eq!(read("i16", [0, 0, 2000, 7, 0xFFFE, 0]), (Some(1 << 16), Some(0xFFFE)));
    let float = format!("encoder_count = {{ register = 13, type = \"f32\" }}\n{REGISTER_MAP_KEYS}");
    assert!(config_error(&float).contains("`encoder_count.type` must be `u16`, `i16`, `u32` or `i32`"));
    let same = format!("encoder_count = {{ register = 12, type = \"u16\" }}\n{REGISTER_MAP_KEYS}");
    assert!(config_error(&same).contains("`counter` and `encoder_count` overlap at register 12"));
}

#[test]
fn invalid_maps_are_refused_with_a_reason() {
    let map = |from: &str, to: &str| config_error(&REGISTER_MAP_KEYS.replace(from, to));
    assert!(map("register = 12", "register = 11").contains("`value` and `counter` overlap at register 11"));
    assert!(map("register = 9\nbit = 15", "register = 10\nbit = 15").contains("overlap"));
    assert!(map("scale_mm = 0.001", "scale_mm = 0").contains("all readings would be equal"));
    assert!(map("scale_mm = 0.001", "scale_mm = \"0.001\"").contains("invalid type"));
    assert!(map("register = 12", "register = 300").contains("too many for one request"));
    assert!(map("register = 12\ntype = \"u16\"", "register = 12\ntype = \"f32\"").contains("unsigned integer"));
    assert!(map("is = 3", "is = 4").contains("can never be 4"));
    assert!(map("bit = 15", "bit = 3").contains("bits from 2 and those from 3 overlap"));
    assert!(map("bit = 15", "bit = 2\nwidth = 2\nis = 3").contains("are met at the same time"));
    let behind = REGISTER_MAP_KEYS.replace("bit = 15", "bit = 2\nwidth = 2");
    assert!(toml::from_str::<ModbusSensorConfig>(&format!("tcp = \"127.0.0.1:9\"\n{behind}")).is_ok());
    assert!(map("bit = 15", "bit = 16").contains("bits 0 to 15"));
    assert!(map("scale_mm = 0.001", "scale_mm = 0.001\nnan = \"range\"").contains("is only for `f32`"));
    assert!(config_error(&format!("space = \"coil\"\n{REGISTER_MAP_KEYS}")).contains("a bit cannot hold a distance"));
    assert!(config_error(&format!("rate_hz = 0\n{REGISTER_MAP_KEYS}")).contains("`rate_hz`"));
}

/// The registers hold only the newest value: an unchanged value shows by its noise, if the noise is
/// declared.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn frozen_value_is_detected_without_a_counter() {
    let prepared = async |noise_um: Option<f64>, step: f64| {
        let mut place = 0.0;
        let sense = move || {
            place += step;
            SensorOutput::Distance(place % 1.0)
        };
        let (at, _) = serve_on_tcp(SampleTiming::AtFixedRate, Box::new(sense), 100.0).unwrap();
        let value = "value = { register = 2, type = \"i32\", order = \"cdab\", scale_mm = 0.00001 }";
        let config = format!("tcp = \"{at}\"\ntimeout_s = 0.2\n{value}\n");
        let config = toml::from_str::<ModbusSensorConfig>(&config).unwrap();
        let sensor = Sensor { noise_um, ..test_sensor() };
        let clock = Arc::new(HostClock::start());
        let mut registers = ModbusSensorDriver::open(config, &sensor, clock, None).await.unwrap();
        registers.prepare().await.map(|prepared| prepared.identity).map_err(|error| error.to_string())
    };
    let error = prepared(Some(0.5), 0.0).await.unwrap_err();
    assert!(error.contains("never change"), "{error}");
    let lives = prepared(Some(0.5), 0.013).await.unwrap();
    assert!(lives.contains("only by its noise"), "{lives}");
    // The noise is less than the counts require, or unknown: detection is impossible, and the identity
    // states it.
    for noise_um in [None, Some(0.01)] {
        let unseen = prepared(noise_um, 0.0).await.unwrap();
        assert!(unseen.contains("a frozen value cannot be detected"), "{unseen}");
    }
}
