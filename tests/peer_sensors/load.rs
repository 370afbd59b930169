//! A thousand samples a second while every core computes: none is lost by the program. What the script
//! itself is late with comes in a burst, and counts.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use libtest_mimic::Failed;
use trued::record::reading::Flag;
use trued::sensors::Sensor;

use super::on_a_runtime;
use super::peer::{Peer, TEXT};

/// Threads that compute until dropped.
struct Load(Arc<AtomicBool>);

impl Load {
    fn begin() -> Self {
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

impl Drop for Load {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

pub fn nothing_is_lost(seconds: u32) -> Result<(), Failed> {
    on_a_runtime(async {
        let mut peer = Peer::start("text");
        let sensor = Sensor::spawn("laser", peer.driver(TEXT).await);
        sensor.prepare().await?;
        let _: u64 = peer.tell("quiet").await;
        tokio::time::sleep(std::time::Duration::from_millis(200)).await;
        let _load = Load::begin();
        // All but what may belong to the first line, which may be one that had begun; and what the
        // script could not send in its time.
        let count = (seconds * 1000) * 9 / 10;
        let command = format!("steady {seconds}");
        let (sent, samples) = tokio::join!(peer.tell::<u32>(&command), sensor.take(count));
        let samples = samples?;
        assert!(sent >= count, "the script sent {sent}");
        let good = samples.iter().filter(|sample| sample.flag == Flag::None).count();
        let missing: u32 = samples.iter().map(|sample| sample.missing).sum();
        println!("{sent} sent in {seconds} s, {good} of {count} taken, {missing} missing");
        assert_eq!((good, missing), (samples.len(), 0));
        Ok(())
    })
}
