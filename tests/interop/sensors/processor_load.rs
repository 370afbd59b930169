//! A thousand samples a second while every core computes: the program loses none. Samples that the script sends
//! late come in a burst, and count.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use devices::sensors::{SensorDriver, SensorError};
use libtest_mimic::Failed;
use machine::record::reading::ReadingFlag;

use super::block_on;
use super::python_sensor::{PythonSensor, TEXT_LINE_KEYS};

/// Threads that compute until dropped.
struct ProcessorLoad(Arc<AtomicBool>);

impl ProcessorLoad {
    fn start() -> Self {
        let on = Arc::new(AtomicBool::new(true));
        for seed in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            let on = on.clone();
            std::thread::spawn(move || {
                let mut number = seed as u64;
                while on.load(Ordering::Relaxed) {
                    number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                }
                std::hint::black_box(number)
            });
        }
        Self(on)
    }
}

impl Drop for ProcessorLoad {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

pub fn no_sample_is_lost_in_10_s_under_load() -> Result<(), Failed> {
    check_no_sample_lost_under_load(10)
}

pub fn no_sample_is_lost_in_60_s_under_load() -> Result<(), Failed> {
    check_no_sample_lost_under_load(60)
}

fn check_no_sample_lost_under_load(seconds: u32) -> Result<(), Failed> {
    block_on(async {
        let mut peer = PythonSensor::start("text");
        let mut driver = peer.open_driver(TEXT_LINE_KEYS).await;
        driver.prepare().await?;
        let _: u64 = peer.send_command("quiet").await;
        tokio::time::sleep(Duration::from_millis(200)).await;
        driver.discard_old_samples().await?;
        let load = ProcessorLoad::start();
        let over = AtomicBool::new(false);
        let command = format!("steady {seconds}");
        let script = async {
            let sent = peer.send_command::<u32>(&command).await;
            over.store(true, Ordering::Relaxed);
            sent
        };
        let listener = async {
            let mut samples = Vec::new();
            loop {
                let was_over = over.load(Ordering::Relaxed);
                let sample = driver.next().await?;
                if was_over && sample.flag == ReadingFlag::Stale {
                    return Ok::<_, SensorError>(samples);
                }
                samples.push(sample);
            }
        };
        let (sent, samples) = tokio::join!(script, listener);
        drop(load);
        let samples = samples?;
        let good = samples.iter().filter(|sample| sample.flag == ReadingFlag::None).count();
        let stale = samples.iter().filter(|sample| sample.flag == ReadingFlag::Stale).count();
        let missing: u32 = samples.iter().map(|sample| sample.lost_before_count).sum();
        println!("{sent} sent in {seconds} s, {good} taken, {missing} missing, {stale} silences");
        // The first line may have begun before the driver listened. A silence is the script's.
        assert_eq!((good, missing), (sent as usize - 1, 0));
        assert_eq!(good + stale, samples.len());
        Ok(())
    })
}
