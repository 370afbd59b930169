//! Tests of the handle: the watch, and silent sensors.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use super::{Driver, Prepared, Sample, Sensor, SensorError};
use machine::record::reading::Flag;

/// Sends the given flags, then is silent; if `broken`, its link is lost then.
struct Script {
    flags: VecDeque<Flag>,
    broken: bool,
}

impl Driver for Script {
    async fn prepare(&mut self) -> Result<Prepared, SensorError> {
        Ok(Prepared { identity: "a script".to_owned(), rate_hz: 1.0 })
    }

    async fn forget(&mut self) -> Result<(), SensorError> {
        if self.broken && self.flags.is_empty() { Err(SensorError::Gone) } else { Ok(()) }
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        tokio::time::sleep(Duration::from_millis(1)).await;
        self.forget().await?;
        let flag = self.flags.pop_front().unwrap_or(Flag::Stale);
        let value_mm = (flag == Flag::None).then_some(1.0);
        Ok(Sample { t_s: 0.0, value_mm, flag, missing: 0, encoder_count: None })
    }

    fn on_demand(&self) -> bool {
        false
    }
}

fn sensor(flags: &[Flag], broken: bool) -> Sensor {
    Sensor::spawn("script", Script { flags: flags.iter().copied().collect(), broken })
}

/// Number of holds within a while, and the result of the watch.
async fn held(sensor: &Sensor, holds: bool) -> (u32, Result<Option<Sample>, SensorError>) {
    let held = Arc::new(AtomicU32::new(0));
    let count = held.clone();
    let act = move || {
        count.fetch_add(1, Ordering::SeqCst);
    };
    sensor.watch(|sample| sample.flag == Flag::None, act).await.unwrap();
    let known = held.clone();
    let until_held = async move {
        while known.load(Ordering::SeqCst) == 0 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    // Waits for the first hold, if one is expected; then whether there is a second one.
    let _ = tokio::time::timeout(Duration::from_secs(if holds { 30 } else { 0 }), until_held).await;
    tokio::time::sleep(Duration::from_millis(50)).await;
    let ended = sensor.rest().await;
    (held.load(Ordering::SeqCst), ended)
}

#[tokio::test]
async fn whatever_is_not_good_holds_the_machine_once() {
    for flag in [Flag::Range, Flag::Saturated, Flag::Stale] {
        let (times, ended) = held(&sensor(&[Flag::None, Flag::None, flag], false), true).await;
        assert_eq!((times, ended.unwrap().map(|sample| sample.flag)), (1, Some(flag)));
    }
    let good = [Flag::None; 10_000];
    let (times, ended) = held(&sensor(&good, false), false).await;
    assert_eq!((times, ended.unwrap()), (0, None));
}

#[tokio::test]
async fn a_link_that_is_lost_holds_it_too() {
    let (times, ended) = held(&sensor(&[Flag::None, Flag::None], true), true).await;
    assert_eq!(times, 1);
    assert!(matches!(ended, Err(SensorError::Gone)), "{ended:?}");
}

#[tokio::test]
async fn a_watch_that_cannot_stand_is_refused_before_anything_moves() {
    let sensor = sensor(&[], true);
    let refused = sensor.watch(|_| true, || panic!("nothing was watched")).await;
    assert!(matches!(refused, Err(SensorError::Gone)), "{refused:?}");
    assert_eq!(sensor.rest().await.unwrap(), None);
}

#[tokio::test]
async fn silence_is_not_waited_for_again_and_again() {
    let taken = sensor(&[Flag::None, Flag::Stale, Flag::None], false).take(100).await.unwrap();
    let flags: Vec<Flag> = taken.iter().map(|sample| sample.flag).collect();
    use Flag::{None, Stale};
    assert_eq!(flags, [None, Stale, None, Stale, Stale, Stale]);
}

/// The remedy names the fault and the sensor, so that the operator does not search at the control.
#[test]
fn a_sensors_link_has_remedies_of_its_own() {
    use link::LinkError;
    let address = || "/dev/ttyUSB9".to_owned();
    let denied = SensorError::from(LinkError::Denied { address: address() }).remedy();
    assert!(denied.contains("dialout") && denied.contains("[[sensor]]"), "{denied}");
    let lost = LinkError::Lost { address: address(), why: "gone".to_owned() };
    assert!(!SensorError::from(lost).remedy().contains("state of the machine"));
    let missing = SensorError::from(LinkError::Missing { address: address() }).remedy();
    assert!(!missing.contains("[controller]"), "{missing}");
}
