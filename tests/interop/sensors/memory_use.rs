//! Checks that the memory use does not grow while a sensor is read: as many samples as in thirty minutes at a
//! thousand a second (three minutes in the gate).

use std::sync::Arc;

use devices::sensors::SensorHandle;
use devices::sensors::serial::{SerialConfig, SerialDriver};
use libtest_mimic::Failed;
use link::clock::HostClock;
use simulator::SensorOutput;
use simulator::sensor_devices::serial::{OutputFormat, REQUEST_KEY_TOML, data_sheet_toml, serve_on_demand};
use testing::population::population_size;

use super::python_sensor::sensor_description;

/// Number of samples at each dwell point.
const SAMPLES_PER_POINT: u32 = 100;
const FULL_DWELL_POINT_COUNT: u64 = 18_000;
/// Maximum growth of the memory, kB. A leak of all samples would be ten times this limit: a sample has 32 bytes, and
/// nine tenths of them come after the first check of the memory.
fn max_memory_growth_kb(points: u64) -> u64 {
    points * u64::from(SAMPLES_PER_POINT) * 32 * 9 / 10 / 1024 / 10
}

const MEMORY_PAGE_KB: u64 = 4;

fn resident_memory_kb() -> u64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap();
    text.split(' ').nth(1).unwrap().parse::<u64>().unwrap() * MEMORY_PAGE_KB
}

pub fn memory_use_does_not_grow_with_samples() -> Result<(), Failed> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut place = 0_u32;
        let sense = move || {
            place += 1;
            SensorOutput::Distance(f64::from(place % 1000) * 0.001)
        };
        let keys = format!("serial = \"memory\"\n{REQUEST_KEY_TOML}{}", data_sheet_toml(OutputFormat::TextLines));
        let config: SerialConfig = toml::from_str(&keys)?;
        let flow = serve_on_demand(OutputFormat::TextLines, Box::new(sense));
        let driver =
            SerialDriver::from_stream(flow, config, &sensor_description(), Arc::new(HostClock::start()), 1000.0);
        let sensor = SensorHandle::spawn("laser", driver);
        sensor.prepare().await?;
        let (mut before, mut expected) = (0, 1);
        let points = population_size(FULL_DWELL_POINT_COUNT);
        for point in 0..points {
            for sample in sensor.read_samples(SAMPLES_PER_POINT).await? {
                expected += 1;
                let um = sample.value_mm.map(|mm| (mm * 1000.0).round() as u32);
                assert_eq!(um, Some(expected % 1000));
            }
            if point == points / 10 {
                before = resident_memory_kb();
            }
        }
        let after = resident_memory_kb();
        println!("{before} kB after 1 in 10, {after} kB at the end");
        assert!(after < before + max_memory_growth_kb(points), "{before} kB became {after} kB");
        Ok(())
    })
}
