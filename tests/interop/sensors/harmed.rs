//! Samples that are skipped, cut short, spoilt, late, in bursts: what the driver counts is what the script
//! says.

use devices::sensors::{Driver, Sample};
use libtest_mimic::Failed;
use machine::record::reading::Flag;

use super::on_a_runtime;
use super::peer::{FRAMES, Peer, TEXT};

/// Counter and micrometres of all that was sent whole; skipped and spoilt.
type Sent = (Vec<(u64, Option<i64>)>, (u64, u64));

const COUNT: usize = 3000;
/// So much silence ends a trial; the script's own is shorter.
const SILENT: usize = 10;

fn um(sample: &Sample) -> Option<i64> {
    sample.value_mm.map(|mm| (mm * 1000.0).round() as i64)
}

async fn counted(form: &str, keys: &str, seed: u64) -> Result<(), Failed> {
    let mut peer = Peer::start(form);
    let mut driver = peer.driver(keys).await;
    driver.prepare().await?;
    let _: u64 = peer.tell("quiet").await;
    // What it sent before is read, and forgotten.
    tokio::time::sleep(std::time::Duration::from_millis(200)).await;
    driver.forget().await?;

    let command = format!("harm {seed} {COUNT}");
    let (sent, samples) = tokio::join!(peer.tell::<Sent>(&command), until_silent(&mut driver));
    let (whole, (skipped, spoilt)) = sent;
    let samples = samples?;
    let stale = samples.iter().filter(|sample| sample.flag == Flag::Stale).count() - SILENT;
    assert!(stale > 0, "seed {seed} has no silence");
    let samples: Vec<_> = samples.into_iter().filter(|sample| sample.flag != Flag::Stale).collect();
    // The first line may have begun before it was listened to.
    let first = whole.len() - samples.len();
    assert!(first <= 1, "{} of {} came", samples.len(), whole.len());
    let came: Vec<_> = samples.iter().map(um).collect();
    let said: Vec<_> = whole.iter().skip(first).map(|(_, um)| *um).collect();
    assert_eq!(came, said);
    let flagged = samples.iter().filter(|sample| sample.flag == Flag::Range).count();
    assert_eq!(flagged, said.iter().filter(|um| um.is_none()).count());

    let missing: u64 = samples.iter().map(|sample| u64::from(sample.missing)).sum();
    assert!(skipped > 50 && spoilt > 50, "{skipped} {spoilt}");
    // What was harmed before the first that came whole is not told.
    let round = if form == "text" { 1000 } else { 65_536 };
    let before = (whole[first].0 + round - whole[0].0) % round - first as u64;
    assert_eq!(missing + before, skipped + spoilt);
    let gaps = |sample: &&Sample| sample.value_mm.is_some() && sample.missing > 0;
    let flagged = samples.iter().filter(|sample| sample.flag == Flag::Gap).count();
    assert_eq!(samples.iter().filter(gaps).count(), flagged);
    Ok(())
}

async fn until_silent(driver: &mut impl Driver) -> Result<Vec<Sample>, Failed> {
    let (mut samples, mut silent) = (Vec::new(), 0);
    while samples.len() < SILENT || silent < SILENT {
        let sample = driver.next().await?;
        silent = if sample.flag == Flag::Stale { silent + 1 } else { 0 };
        samples.push(sample);
    }
    Ok(samples)
}

pub fn lines() -> Result<(), Failed> {
    on_a_runtime(async {
        for seed in [1, 2] {
            counted("text", TEXT, seed).await?;
        }
        Ok(())
    })
}

pub fn frames() -> Result<(), Failed> {
    on_a_runtime(async {
        for seed in [1, 2] {
            counted("frames", FRAMES, seed).await?;
        }
        Ok(())
    })
}

pub fn asked() -> Result<(), Failed> {
    on_a_runtime(async {
        let peer = Peer::start("asked");
        let mut driver = peer.patient(&format!("request = \"M0\\r\"\n{TEXT}")).await;
        assert!(driver.prepare().await?.rate_hz > 10.0);
        driver.forget().await?;
        let mut last = um(&driver.next().await?).unwrap();
        for _ in 0..500 {
            let sample = driver.next().await?;
            assert_eq!((sample.flag, sample.missing), (Flag::None, 0));
            // As the script's `um` has it.
            let next = (last + 8000 + 37) % 16_001 - 8000;
            assert_eq!(um(&sample), Some(next));
            last = next;
        }
        Ok(())
    })
}
