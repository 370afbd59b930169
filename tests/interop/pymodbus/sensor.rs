//! pymodbus as a displacement sensor: each measurement is taken once, missing ones are counted, and registers that
//! do not change are stale.

use std::sync::Arc;

use devices::sensors::modbus::{ModbusSensorConfig, ModbusSensorDriver};
use devices::sensors::{Sample, SensorDriver, SensorError};
use libtest_mimic::Failed;
use link::LinkConfig;
use link::clock::HostClock;
use link::modbus::Framing;
use machine::record::reading::ReadingFlag;

use super::server::{PymodbusServer, block_on};

const REGISTER_MAP: &str = r#"
timeout_s = 1.5
rate_hz = 1000
unit = 1
counter = { register = 101, type = "u16", gaps = true }
value = { register = 102, type = "i32", order = "cdab", scale_mm = 0.001 }
status = [{ register = 100, bit = 1, means = "no-echo" }]
"#;

/// Larger than the measured distances before the registers stop changing.
const SENSOR_RANGE_MM: [f64; 2] = [-100.0, 100.0];

/// Keys of a machine file for the address of the server.
pub fn server_address_keys(server: &PymodbusServer) -> String {
    match server.link_config() {
        LinkConfig::Serial { path, baud } => {
            format!("serial = \"{}\"\nbaud = {baud}\nparity = \"none\"", path.display())
        }
        other => format!("tcp = \"{other}\""),
    }
}

async fn open_sensor_driver(server: &PymodbusServer) -> ModbusSensorDriver {
    let at = server_address_keys(server);
    let config: ModbusSensorConfig = toml::from_str(&format!("{at}\n{REGISTER_MAP}")).unwrap();
    let sensor = serde_json::from_value(serde_json::json!({
        "name": "laser", "zero_mm": [0, 0, -150], "direction": [0, 0, -1], "range_mm": SENSOR_RANGE_MM
    }));
    let clock = Arc::new(HostClock::start());
    ModbusSensorDriver::open(config, &sensor.unwrap(), clock, None).await.unwrap()
}

/// Checks that each sample has the value of its measurement number, which advances by one and the number of missing
/// samples. `previous_measurement`: number before the first sample. Returns the last number.
fn check_consecutive_samples(samples: &[Sample], previous_measurement: u32) -> u32 {
    let mut place = previous_measurement;
    for sample in samples {
        place += sample.lost_before_count + 1;
        let expected = if place.is_multiple_of(10) { None } else { Some(i64::from(place) * 37) };
        let um = sample.value_mm.map(|mm| (mm * 1000.0).round() as i64);
        assert_eq!(um, expected, "measurement {place}");
        let gap = expected.is_some() && sample.lost_before_count > 0;
        assert_eq!(sample.flag == ReadingFlag::Gap, gap, "measurement {place}");
    }
    place
}

async fn check_measurements_read_or_counted(framing: Framing) -> Result<(), Failed> {
    const SAMPLE_COUNT: u32 = 600;
    let mut server = PymodbusServer::start(framing);
    let mut driver = open_sensor_driver(&server).await;
    server.start_measurements(5.0, SAMPLE_COUNT);
    let prepared = driver.prepare().await?;
    assert!(prepared.sample_rate_hz > 5.0, "{prepared:?}");
    driver.discard_old_samples().await?;
    let mut samples = vec![driver.next().await?];
    loop {
        let sample = driver.next().await?;
        match sample.flag {
            ReadingFlag::Stale if server.measurement_count() == SAMPLE_COUNT => break,
            // A server without processor time measures nothing, either.
            ReadingFlag::Stale => {}
            _ => samples.push(sample),
        }
    }
    let um = samples.iter().find_map(|sample| sample.value_mm).unwrap() * 1000.0;
    let empty = samples.iter().take_while(|sample| sample.value_mm.is_none()).count();
    let before = (um / 37.0).round() as u32 - 1 - u32::try_from(empty)?;
    let gaps: u32 = samples.iter().skip(1).map(|sample| sample.lost_before_count).sum();
    assert_eq!(check_consecutive_samples(&samples[1..], before + 1), SAMPLE_COUNT);
    println!("{} samples, {gaps} missing of {SAMPLE_COUNT} from {} on", samples.len(), before + 1);
    assert!(samples.len() > 20, "{}", samples.len());
    Ok(())
}

pub fn each_measurement_is_read_once_or_counted_missing_over_tcp() -> Result<(), Failed> {
    block_on(check_measurements_read_or_counted(Framing::Tcp))
}

pub fn each_measurement_is_read_once_or_counted_missing_over_rtu() -> Result<(), Failed> {
    block_on(check_measurements_read_or_counted(Framing::Rtu))
}

/// A reply that is late, cut or of another unit is a stale sample; the next sample is valid again. A sensor without
/// its registers is refused.
pub fn corrupted_replies_give_one_stale_sample_each() -> Result<(), Failed> {
    block_on(async {
        let mut server = PymodbusServer::start(Framing::Rtu);
        let mut driver = open_sensor_driver(&server).await;
        server.start_measurements(20.0, 100_000);
        driver.prepare().await?;
        for fault in ["drop", "short", "unit", "corrupt", "delay:2.2", "fewer"] {
            driver.discard_old_samples().await?;
            server.set_faults(&[fault]);
            let stale = driver.next().await?;
            assert_eq!((stale.flag, stale.value_mm), (ReadingFlag::Stale, None), "{fault}");
            let sample = driver.next().await?;
            assert_ne!(sample.flag, ReadingFlag::Stale, "after {fault}");
        }
        server.set_faults(&["exception:2"]);
        let refused = driver.next().await.unwrap_err();
        assert!(matches!(refused, SensorError::Modbus(_)), "{refused}");
        assert!(refused.remedy().contains("register map"), "{}", refused.remedy());
        Ok(())
    })
}
