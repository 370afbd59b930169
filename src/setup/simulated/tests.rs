//! Simulated sensors, tested with the drivers of real sensors.

use std::sync::Arc;

use devices::sensors::{Sample, SensorDriver};
use link::clock::HostClock;
use machine::record::reading::ReadingFlag;
use machine::record::sensor::Sensor;
use serde_json::json;
use simulator::SensorOutput;
use simulator::sensor_devices::SampleSource;
use simulator::sensor_devices::modbus::SampleTiming;
use simulator::sensor_devices::serial::OutputFormat;

use super::SimulatedSensorConfig;
use super::sensor_wire::{self, SensorWire};

fn sensor() -> Sensor {
    serde_json::from_value(json!({
        "name": "laser", "zero_mm": [0, 0, -150], "direction": [0, 0, -1], "range_mm": [-10, 10]
    }))
    .unwrap()
}

fn clock() -> Arc<HostClock> {
    Arc::new(HostClock::start())
}

/// Value in µm (0 without a value), flag, and number of missing samples before it.
fn value_um_flag_and_missing_count(sample: &Sample) -> (i64, &'static str, u32) {
    assert_eq!(sample.value_mm.is_some(), sample.flag == ReadingFlag::None);
    let um = sample.value_mm.map_or(0, |mm| (mm * 1000.0).round() as i64);
    (um, sample.flag.as_str(), sample.lost_before_count)
}

fn value_um_and_flag_without_gap(sample: &Sample) -> (i64, &'static str) {
    let (um, flag, missing) = value_um_flag_and_missing_count(sample);
    assert_eq!(missing, 0);
    (um, flag)
}

/// Cycles through the values 0 to 9 and the samples without a value.
fn cyclic_sample_source() -> SampleSource {
    let mut place = 0_u32;
    Box::new(move || {
        place += 1;
        match place % 13 {
            10 => SensorOutput::NoEcho,
            11 => SensorOutput::OutOfRange(12.5),
            12 => SensorOutput::TooMuchLight,
            digit => SensorOutput::Distance(f64::from(digit) - 4.87654),
        }
    })
}

fn expected_value_um_and_flag(place: u32) -> (i64, &'static str) {
    match place % 13 {
        10 | 11 => (0, "range"),
        12 => (0, "saturated"),
        digit => ((f64::from(digit) * 1000.0 - 4876.54).round() as i64, ""),
    }
}

#[tokio::test]
async fn a_serial_sensor_in_memory_measures_on_request() {
    for format in [OutputFormat::TextLines, OutputFormat::BinaryFrames] {
        let mut serial =
            sensor_wire::start_serial_sensor(format, None, cyclic_sample_source(), 1000.0, &sensor(), clock())
                .await
                .unwrap();
        assert_eq!(serial.prepare().await.unwrap().sample_rate_hz, 1000.0);
        assert!(serial.is_simulated_on_demand());
        // The first sample was taken by `prepare`.
        for place in 2..200 {
            let (um, flag, missing) = value_um_flag_and_missing_count(&serial.next().await.unwrap());
            assert_eq!(((um, flag), missing), (expected_value_um_and_flag(place), 0), "{format:?} {place}");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_serial_sensor_on_a_wire_sends_by_itself() {
    for (format, wire) in [(OutputFormat::TextLines, SensorWire::Tcp), (OutputFormat::BinaryFrames, SensorWire::Pty)] {
        let mut serial =
            sensor_wire::start_serial_sensor(format, Some(wire), cyclic_sample_source(), 1000.0, &sensor(), clock())
                .await
                .unwrap();
        assert!(serial.prepare().await.unwrap().sample_rate_hz > 10.0);
        assert!(!serial.is_simulated_on_demand());
        serial.discard_old_samples().await.unwrap();
        let mut samples = Vec::new();
        for _ in 0..100 {
            samples.push(value_um_flag_and_missing_count(&serial.next().await.unwrap()));
        }
        assert!(samples.iter().all(|(.., missing)| *missing == 0), "{samples:?}");
        let fits = |first: u32| {
            (first..).zip(&samples).all(|(place, (um, flag, _))| (*um, *flag) == expected_value_um_and_flag(place))
        };
        assert!((0..13).any(fits), "{format:?} {wire:?}: {samples:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_modbus_sensor_measures_when_it_is_read() {
    for wire in [SensorWire::Tcp, SensorWire::Pty] {
        let mut place = 0;
        let sense = move || {
            place += 1;
            match place {
                4 => SensorOutput::NoEcho,
                5 => SensorOutput::OutOfRange(11.0),
                6 => SensorOutput::TooMuchLight,
                _ => SensorOutput::Distance(-0.5 * f64::from(place)),
            }
        };
        let clock = Arc::new(HostClock::start());
        let mut registers =
            sensor_wire::start_modbus_sensor(SampleTiming::WhenRead, wire, Box::new(sense), 1000.0, &sensor(), clock)
                .await
                .unwrap();
        assert!(registers.is_simulated_on_demand());
        // One sample at the start, one for `prepare`.
        assert_eq!(registers.prepare().await.unwrap().sample_rate_hz, 1000.0);
        registers.discard_old_samples().await.unwrap();
        let expected = [(-1500, ""), (0, "range"), (0, "range"), (0, "saturated"), (-3500, "")];
        for expected in expected {
            assert_eq!(value_um_and_flag_without_gap(&registers.next().await.unwrap()), expected, "{wire:?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn modbus_sensor_at_fixed_rate_returns_each_measurement_once() {
    let mut place = 0;
    let sense = move || {
        place += 1;
        SensorOutput::Distance(f64::from(place % 1000) * 0.01)
    };
    let clock = Arc::new(HostClock::start());
    let mut registers = sensor_wire::start_modbus_sensor(
        SampleTiming::AtFixedRate,
        SensorWire::Tcp,
        Box::new(sense),
        50.0,
        &sensor(),
        clock,
    )
    .await
    .unwrap();
    let prepared = registers.prepare().await.unwrap();
    assert!(!registers.is_simulated_on_demand() && prepared.sample_rate_hz > 1.0, "{prepared:?}");
    registers.discard_old_samples().await.unwrap();
    let mut last = 0;
    for _ in 0..20 {
        let (um, flag) = value_um_and_flag_without_gap(&registers.next().await.unwrap());
        assert!(flag.is_empty() && um > last, "{um} after {last}");
        last = um;
    }
}

#[test]
fn wire_that_a_simulated_sensor_does_not_support_is_refused() {
    let refused = |keys: &str| toml::from_str::<SimulatedSensorConfig>(keys).unwrap_err().to_string();
    assert!(refused("speaks = \"modbus\"").contains("requires `wire = \"tcp\"`"));
    assert!(refused("speaks = \"modbus\"\nwire = \"memory\"").contains("requires `wire = \"tcp\"`"));
    assert!(refused("speaks = \"serial\"\nwire = \"udp\"").contains("`wire` is `udp`"));
    for sound in ["", "wire = \"vcan0\"", "speaks = \"modbus\"\nwire = \"pty\"", "speaks = \"serial\""] {
        assert!(toml::from_str::<SimulatedSensorConfig>(sound).is_ok(), "{sound}");
    }
}
