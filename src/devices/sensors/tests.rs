//! Tests of the sensor handle: the watch, and silent sensors.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use super::{Sample, SensorDriver, SensorError, SensorHandle, SensorInfo};
use machine::record::reading::ReadingFlag;

/// Driver that delivers samples with the given flags, then is silent, or loses its link.
struct ScriptedDriver {
    flags: VecDeque<ReadingFlag>,
    loses_link_at_end: bool,
}

impl SensorDriver for ScriptedDriver {
    async fn prepare(&mut self) -> Result<SensorInfo, SensorError> {
        Ok(SensorInfo { identity: "a script".to_owned(), sample_rate_hz: 1.0 })
    }

    async fn discard_old_samples(&mut self) -> Result<(), SensorError> {
        if self.loses_link_at_end && self.flags.is_empty() { Err(SensorError::TaskEnded) } else { Ok(()) }
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        tokio::time::sleep(Duration::from_millis(1)).await;
        self.discard_old_samples().await?;
        let flag = self.flags.pop_front().unwrap_or(ReadingFlag::Stale);
        let value_mm = (flag == ReadingFlag::None).then_some(1.0);
        Ok(Sample { received_s: 0.0, value_mm, flag, lost_before_count: 0, encoder_count: None })
    }

    fn is_simulated_on_demand(&self) -> bool {
        false
    }
}

fn spawn_scripted_sensor(flags: &[ReadingFlag], loses_link_at_end: bool) -> SensorHandle {
    SensorHandle::spawn("script", ScriptedDriver { flags: flags.iter().copied().collect(), loses_link_at_end })
}

/// Number of calls of the hold during a watch, and the result of the watch. `expects_hold`: wait for the first call.
async fn watch_and_count_holds(
    sensor: &SensorHandle,
    expects_hold: bool,
) -> (u32, Result<Option<Sample>, SensorError>) {
    let held = Arc::new(AtomicU32::new(0));
    let count = held.clone();
    let act = move || {
        count.fetch_add(1, Ordering::SeqCst);
    };
    sensor.watch(|sample| sample.flag == ReadingFlag::None, act).await.unwrap();
    let known = held.clone();
    let until_held = async move {
        while known.load(Ordering::SeqCst) == 0 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    // Waits for the first hold, if one is expected; then whether there is a second one.
    let _ = tokio::time::timeout(Duration::from_secs(if expects_hold { 30 } else { 0 }), until_held).await;
    tokio::time::sleep(Duration::from_millis(50)).await;
    let ended = sensor.end_watch().await;
    (held.load(Ordering::SeqCst), ended)
}

#[tokio::test]
async fn first_bad_sample_calls_the_hold_once() {
    for flag in [ReadingFlag::Range, ReadingFlag::Saturated, ReadingFlag::Stale] {
        let (times, ended) =
            watch_and_count_holds(&spawn_scripted_sensor(&[ReadingFlag::None, ReadingFlag::None, flag], false), true)
                .await;
        assert_eq!((times, ended.unwrap().map(|sample| sample.flag)), (1, Some(flag)));
    }
    let good = [ReadingFlag::None; 10_000];
    let (times, ended) = watch_and_count_holds(&spawn_scripted_sensor(&good, false), false).await;
    assert_eq!((times, ended.unwrap()), (0, None));
}

#[tokio::test]
async fn lost_link_calls_the_hold_once() {
    let (times, ended) =
        watch_and_count_holds(&spawn_scripted_sensor(&[ReadingFlag::None, ReadingFlag::None], true), true).await;
    assert_eq!(times, 1);
    assert!(matches!(ended, Err(SensorError::TaskEnded)), "{ended:?}");
}

#[tokio::test]
async fn watch_over_a_lost_link_is_refused() {
    let sensor = spawn_scripted_sensor(&[], true);
    let refused = sensor.watch(|_| true, || panic!("nothing was watched")).await;
    assert!(matches!(refused, Err(SensorError::TaskEnded)), "{refused:?}");
    assert_eq!(sensor.end_watch().await.unwrap(), None);
}

#[tokio::test]
async fn reading_ends_after_three_consecutive_silences() {
    let taken = spawn_scripted_sensor(&[ReadingFlag::None, ReadingFlag::Stale, ReadingFlag::None], false)
        .read_samples(100)
        .await
        .unwrap();
    let flags: Vec<ReadingFlag> = taken.iter().map(|sample| sample.flag).collect();
    use ReadingFlag::{None, Stale};
    assert_eq!(flags, [None, Stale, None, Stale, Stale, Stale]);
}

/// The remedy of a link error concerns the sensor, so that the operator does not search at the control.
#[test]
fn link_error_remedies_concern_the_sensor_not_the_control() {
    use link::LinkError;
    let address = || "/dev/ttyUSB9".to_owned();
    let denied = SensorError::from(LinkError::PermissionDenied { address: address() }).remedy();
    assert!(denied.contains("dialout") && denied.contains("[[sensor]]"), "{denied}");
    let lost = LinkError::Lost { address: address(), why: "gone".to_owned() };
    assert!(!SensorError::from(lost).remedy().contains("state of the machine"));
    let missing = SensorError::from(LinkError::NoSuchPort { address: address() }).remedy();
    assert!(!missing.contains("[controller]"), "{missing}");
}
