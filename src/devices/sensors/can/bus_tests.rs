//! Tests of the driver on a faulty bus, with scripted events.

use std::sync::Arc;

use tokio::sync::mpsc;

use super::driver::CanDriver;
use super::tests::{StoppedClock, config, test_sensor};
use crate::sensors::{Sample, SensorDriver as _, SensorError};
use link::can::{CanError, CanEvent, CanFrame, CanId, CanReceiver};
use machine::record::reading::ReadingFlag;

const COUNTED: &str = "counter = { byte = 3, width = 8 }";

/// A driver, and the sender of the events that it receives.
fn driver(counter: &str, timeout_s: f64) -> (CanDriver, mpsc::Sender<CanEvent>) {
    let keys = "interface = \"can0\"\nid = 0x123\nlength = 4\n\
                value = { byte = 0, width = 24, order = \"big\", signed = true, scale_mm = 1e-5 }\n";
    let config = config(&format!("{keys}timeout_s = {timeout_s:?}\n{counter}")).unwrap();
    let (sender, receiver) = mpsc::channel(64);
    let can = CanReceiver::from_events("can0", receiver);
    (CanDriver::new(&config, can, test_sensor().range_mm, Arc::new(StoppedClock)), sender)
}

fn id(raw: u32) -> CanId {
    CanId::new(raw, false).unwrap()
}

fn frame(count: u8) -> CanEvent {
    CanEvent::Frame(CanFrame::new(20.0 + f64::from(count) * 1e-3, id(0x123), &[0, 0, count, count]))
}

fn words(words: &str) -> String {
    words.to_owned()
}

/// Error of a driver that receives the events `sent` before it starts, and nothing afterwards.
async fn refused(sent: Vec<CanEvent>) -> CanError {
    let (mut driver, sender) = driver(COUNTED, 0.05);
    for event in sent {
        sender.send(event).await.unwrap();
    }
    match driver.prepare().await {
        Err(SensorError::Can(error)) => error,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn bus_with_only_errors_suggests_the_bit_rate() {
    let error = refused(vec![
        CanEvent::BusErrors(words("controller problem: rx warning")),
        CanEvent::BusErrors(words("protocol violation")),
    ])
    .await;
    let message = error.to_string();
    assert!(message.contains("no frame 123 was received on `can0`"), "{message}");
    assert!(message.contains("the bus has errors: protocol violation"), "{message}");
    assert!(error.remedy().contains("compare the bit rate (`ip -details link show can0`)"));
}

#[tokio::test]
async fn bus_off_and_interface_down_are_reported() {
    let errors = || CanEvent::BusErrors(words("bus error"));
    let off = || CanEvent::BusOff(words("bus off"));
    let error = refused(vec![errors(), off(), errors()]).await;
    assert!(matches!(error, CanError::BusOff { .. }), "{error}");
    assert!(error.remedy().contains("restart-ms"), "{}", error.remedy());
    let error = refused(vec![off(), CanEvent::Down(words("network is down"))]).await;
    assert!(matches!(error, CanError::Down { .. }), "{error}");
    // The bus was restarted, or set up again, meanwhile.
    let error = refused(vec![errors(), off(), CanEvent::LostFrames(1)]).await;
    assert!(matches!(error, CanError::BusErrors { .. }), "{error}");
    let error = refused(vec![errors(), CanEvent::Down(words("gone")), off(), CanEvent::Up]).await;
    assert!(matches!(error, CanError::BusErrors { .. }), "{error}");
}

#[tokio::test]
async fn foreign_frames_are_reported() {
    let other = |raw| CanEvent::ForeignId(id(raw));
    let error = refused(vec![CanEvent::BusErrors(words("bus error")), other(0x182), other(7)]).await;
    assert_eq!(error.to_string(), "no frame 123 was received on `can0`, only frames with other identifiers: 182, 007");
    assert!(error.remedy().contains("compare `id`"), "{}", error.remedy());
}

#[tokio::test]
async fn stuck_counter_is_reported() {
    let (mut driver, sender) = driver(COUNTED, 30.0);
    tokio::spawn(async move {
        loop {
            // A full channel waits for its reader.
            if sender.send(frame(9)).await.is_err() {
                return;
            }
            tokio::task::yield_now().await;
        }
    });
    let error = driver.prepare().await.unwrap_err();
    assert!(matches!(error, SensorError::CounterFrozen), "{error}");
}

async fn samples(counter: &str, sent: Vec<CanEvent>, count: usize) -> Vec<(ReadingFlag, u32)> {
    let (mut driver, sender) = driver(counter, 30.0);
    driver.discard_old_samples().await.unwrap();
    for event in sent {
        sender.send(event).await.unwrap();
    }
    let mut samples = Vec::new();
    for _ in 0..count {
        let Sample { flag, missing_count: missing, .. } = driver.next().await.unwrap();
        samples.push((flag, missing));
    }
    samples
}

/// A fault during the measurement gives a flagged sample at once, and a gap after its end.
#[tokio::test]
async fn failing_bus_is_flagged_and_leaves_a_gap() {
    let events = || {
        vec![
            frame(1),
            CanEvent::BusErrors(words("bus error")),
            frame(2),
            CanEvent::BusOff(words("bus off")),
            CanEvent::LostFrames(1),
            frame(7),
            frame(8),
        ]
    };
    let (well, stale) = ((ReadingFlag::None, 0), (ReadingFlag::Stale, 0));
    assert_eq!(samples(COUNTED, events(), 5).await, [well, well, stale, (ReadingFlag::Gap, 4), well]);
    // Without a counter the number of missing samples is unknown.
    assert_eq!(samples("", events(), 5).await, [well, well, stale, (ReadingFlag::Gap, 0), well]);
}
