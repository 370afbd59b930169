//! Samples that are skipped, truncated, corrupted, late or in bursts: the driver's counts agree with the script.

use devices::sensors::{Sample, SensorDriver};
use libtest_mimic::Failed;
use machine::record::reading::ReadingFlag;

use super::block_on;
use super::python_sensor::{BYTE_FRAME_KEYS, PythonSensor, TEXT_LINE_KEYS};

/// Counter and micrometres of all samples sent completely; numbers of skipped and corrupted samples.
type SentSamplesAndLosses = (Vec<(u64, Option<i64>)>, (u64, u64));

const SAMPLE_COUNT: usize = 3000;
/// Number of silent periods that ends a trial; the script's own silence is shorter.
const SILENT_PERIODS_AT_END: usize = 10;

fn distance_um(sample: &Sample) -> Option<i64> {
    sample.value_mm.map(|mm| (mm * 1000.0).round() as i64)
}

async fn check_counted_losses(form: &str, keys: &str, seed: u64) -> Result<(), Failed> {
    let mut peer = PythonSensor::start(form);
    let mut driver = peer.open_driver(keys).await;
    driver.prepare().await?;
    let _: u64 = peer.send_command("quiet").await;
    // Samples sent earlier are read and discarded.
    tokio::time::sleep(std::time::Duration::from_millis(200)).await;
    driver.discard_old_samples().await?;

    let command = format!("harm {seed} {SAMPLE_COUNT}");
    let (sent, samples) =
        tokio::join!(peer.send_command::<SentSamplesAndLosses>(&command), read_until_silent(&mut driver));
    let (whole, (skipped, spoilt)) = sent;
    let samples = samples?;
    let stale = samples.iter().filter(|sample| sample.flag == ReadingFlag::Stale).count() - SILENT_PERIODS_AT_END;
    assert!(stale > 0, "seed {seed} has no silence");
    let samples: Vec<_> = samples.into_iter().filter(|sample| sample.flag != ReadingFlag::Stale).collect();
    // The first line may have begun before the driver listened.
    let first = whole.len() - samples.len();
    assert!(first <= 1, "{} of {} came", samples.len(), whole.len());
    let came: Vec<_> = samples.iter().map(distance_um).collect();
    let said: Vec<_> = whole.iter().skip(first).map(|(_, um)| *um).collect();
    assert_eq!(came, said);
    let flagged = samples.iter().filter(|sample| sample.flag == ReadingFlag::Range).count();
    assert_eq!(flagged, said.iter().filter(|um| um.is_none()).count());

    let missing: u64 = samples.iter().map(|sample| u64::from(sample.lost_before_count)).sum();
    assert!(skipped > 50 && spoilt > 50, "{skipped} {spoilt}");
    // Faults before the first complete sample are not counted.
    let round = if form == "text" { 1000 } else { 65_536 };
    let before = (whole[first].0 + round - whole[0].0) % round - first as u64;
    assert_eq!(missing + before, skipped + spoilt);
    let gaps = |sample: &&Sample| sample.value_mm.is_some() && sample.lost_before_count > 0;
    let flagged = samples.iter().filter(|sample| sample.flag == ReadingFlag::Gap).count();
    assert_eq!(samples.iter().filter(gaps).count(), flagged);
    Ok(())
}

async fn read_until_silent(driver: &mut impl SensorDriver) -> Result<Vec<Sample>, Failed> {
    let (mut samples, mut silent) = (Vec::new(), 0);
    while samples.len() < SILENT_PERIODS_AT_END || silent < SILENT_PERIODS_AT_END {
        let sample = driver.next().await?;
        silent = if sample.flag == ReadingFlag::Stale { silent + 1 } else { 0 };
        samples.push(sample);
    }
    Ok(samples)
}

pub fn losses_of_damaged_text_lines_are_counted() -> Result<(), Failed> {
    block_on(async {
        for seed in [1, 2] {
            check_counted_losses("text", TEXT_LINE_KEYS, seed).await?;
        }
        Ok(())
    })
}

pub fn losses_of_damaged_byte_frames_are_counted() -> Result<(), Failed> {
    block_on(async {
        for seed in [1, 2] {
            check_counted_losses("frames", BYTE_FRAME_KEYS, seed).await?;
        }
        Ok(())
    })
}

pub fn polled_lines_lose_no_sample() -> Result<(), Failed> {
    block_on(async {
        let peer = PythonSensor::start("asked");
        let mut driver = peer.open_driver_with_long_timeout(&format!("request = \"M0\\r\"\n{TEXT_LINE_KEYS}")).await;
        assert!(driver.prepare().await?.sample_rate_hz > 10.0);
        driver.discard_old_samples().await?;
        let mut last = distance_um(&driver.next().await?).unwrap();
        for _ in 0..500 {
            let sample = driver.next().await?;
            assert_eq!((sample.flag, sample.lost_before_count), (ReadingFlag::None, 0));
            // The sequence of the script's `um`.
            let next = (last + 8000 + 37) % 16_001 - 8000;
            assert_eq!(distance_um(&sample), Some(next));
            last = next;
        }
        Ok(())
    })
}
