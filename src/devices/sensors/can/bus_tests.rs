//! Tests of the driver on a faulty bus, with scripted events.

use std::sync::Arc;

use tokio::sync::mpsc;

use super::driver::CanDriver;
use super::tests::{StoppedClock, parse_config, test_sensor};
use crate::sensors::{Sample, SensorDriver as _, SensorError};
use link::can::{CanError, CanEvent, CanFrame, CanId, CanReceiver};
use machine::record::reading::ReadingFlag;

const COUNTER_KEY: &str = "counter = { byte = 3, width = 8 }";

/// A driver, and the sender of the events that it receives.
fn driver_and_event_sender(counter_key: &str, timeout_s: f64) -> (CanDriver, mpsc::Sender<CanEvent>) {
    let keys = "interface = \"can0\"\nid = 0x123\nlength = 4\n\
                value = { byte = 0, width = 24, order = \"big\", signed = true, scale_mm = 1e-5 }\n";
    let config = parse_config(&format!("{keys}timeout_s = {timeout_s:?}\n{counter_key}")).unwrap();
    let (sender, receiver) = mpsc::channel(64);
    let can = CanReceiver::from_events("can0", receiver);
    (CanDriver::new(&config, can, test_sensor().range_mm, Arc::new(StoppedClock)), sender)
}

fn standard_id(raw: u32) -> CanId {
    CanId::new(raw, false).unwrap()
}

/// Frame of the sensor with `count` in bytes 2 and 3, received `count` ms after 20 s.
fn frame_with_count(count: u8) -> CanEvent {
    CanEvent::Frame(CanFrame::new(20.0 + f64::from(count) * 1e-3, standard_id(0x123), &[0, 0, count, count]))
}

fn owned_text(words: &str) -> String {
    words.to_owned()
}

/// Error of `prepare` of a driver that receives `events` before it starts, and nothing afterwards.
async fn prepare_error_after(events: Vec<CanEvent>) -> CanError {
    let (mut driver, sender) = driver_and_event_sender(COUNTER_KEY, 0.05);
    for event in events {
        sender.send(event).await.unwrap();
    }
    match driver.prepare().await {
        Err(SensorError::Can(error)) => error,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn bus_with_only_errors_suggests_the_bit_rate() {
    let error = prepare_error_after(vec![
        CanEvent::BusErrors(owned_text("controller problem: rx warning")),
        CanEvent::BusErrors(owned_text("protocol violation")),
    ])
    .await;
    let message = error.to_string();
    assert!(message.contains("no frame 123 was received on `can0`"), "{message}");
    assert!(message.contains("the bus has errors: protocol violation"), "{message}");
    assert!(error.remedy().contains("compare the bit rate (`ip -details link show can0`)"));
}

#[tokio::test]
async fn bus_off_and_interface_down_are_reported() {
    let errors = || CanEvent::BusErrors(owned_text("bus error"));
    let off = || CanEvent::BusOff(owned_text("bus off"));
    let error = prepare_error_after(vec![errors(), off(), errors()]).await;
    assert!(matches!(error, CanError::BusOff { .. }), "{error}");
    assert!(error.remedy().contains("restart-ms"), "{}", error.remedy());
    let error = prepare_error_after(vec![off(), CanEvent::InterfaceDown(owned_text("network is down"))]).await;
    assert!(matches!(error, CanError::InterfaceDown { .. }), "{error}");
    // The bus was restarted, or set up again, meanwhile.
    let error = prepare_error_after(vec![errors(), off(), CanEvent::LostFrames(1)]).await;
    assert!(matches!(error, CanError::BusErrors { .. }), "{error}");
    let error =
        prepare_error_after(vec![errors(), CanEvent::InterfaceDown(owned_text("gone")), off(), CanEvent::InterfaceUp])
            .await;
    assert!(matches!(error, CanError::BusErrors { .. }), "{error}");
}

#[tokio::test]
async fn foreign_frames_are_reported() {
    let other = |raw| CanEvent::ForeignId(standard_id(raw));
    let error = prepare_error_after(vec![CanEvent::BusErrors(owned_text("bus error")), other(0x182), other(7)]).await;
    assert_eq!(error.to_string(), "no frame 123 was received on `can0`, only frames with other identifiers: 182, 007");
    assert!(error.remedy().contains("compare `id`"), "{}", error.remedy());
}

#[tokio::test]
async fn stuck_counter_is_reported() {
    let (mut driver, sender) = driver_and_event_sender(COUNTER_KEY, 30.0);
    tokio::spawn(async move {
        loop {
            // A full channel waits for its reader.
            if sender.send(frame_with_count(9)).await.is_err() {
                return;
            }
            tokio::task::yield_now().await;
        }
    });
    let error = driver.prepare().await.unwrap_err();
    assert!(matches!(error, SensorError::CounterFrozen), "{error}");
}

/// Sends `events` to a new driver and returns, for each of its next `count` samples, the flag and the number of samples
/// lost directly before it.
async fn flags_and_lost_counts(counter_key: &str, events: Vec<CanEvent>, count: usize) -> Vec<(ReadingFlag, u32)> {
    let (mut driver, sender) = driver_and_event_sender(counter_key, 30.0);
    driver.discard_old_samples().await.unwrap();
    for event in events {
        sender.send(event).await.unwrap();
    }
    let mut samples = Vec::new();
    for _ in 0..count {
        let Sample { flag, lost_before_count: missing, .. } = driver.next().await.unwrap();
        samples.push((flag, missing));
    }
    samples
}

/// Bus-off during the measurement gives a stale sample at once; the first frame after the bus-off has the flag `Gap`.
#[tokio::test]
async fn bus_off_gives_a_stale_sample_then_a_gap() {
    let events = || {
        vec![
            frame_with_count(1),
            CanEvent::BusErrors(owned_text("bus error")),
            frame_with_count(2),
            CanEvent::BusOff(owned_text("bus off")),
            CanEvent::LostFrames(1),
            frame_with_count(7),
            frame_with_count(8),
        ]
    };
    let (well, stale) = ((ReadingFlag::None, 0), (ReadingFlag::Stale, 0));
    assert_eq!(flags_and_lost_counts(COUNTER_KEY, events(), 5).await, [well, well, stale, (ReadingFlag::Gap, 4), well]);
    // Without a counter the number of missing samples is unknown.
    assert_eq!(flags_and_lost_counts("", events(), 5).await, [well, well, stale, (ReadingFlag::Gap, 0), well]);
}
