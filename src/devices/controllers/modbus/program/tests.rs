//! Tests of the driver against the simulated control's own program.

use std::time::Duration;

use super::super::driver::ModbusDriver;
use super::super::tests::{driver_of_simulated_control, fault_at_line, prove_block_for, turn_at_feed, wait_for_hold};
use super::call::ContactRowResult;
use super::rows;
use crate::controllers::{ControllerDriver, ControllerError};
use machine::record::motion::{Motion, MotionBlock};
use machine::{Axis, Position};
use planning::gcode::TransmissionForm;
use planning::proof::ProvenBlock;
use simulator::controls::modbus::{ControlEvent, ControlEventLog, Fault, FaultKind};
use simulator::interpreter::SimulationPace;

const PROGRAM_KEYS: &str = "[program]";

fn prove_block(block: &MotionBlock) -> ProvenBlock {
    prove_block_for(&TransmissionForm::TableRows, block)
}

fn position_of(mm_or_rad: &[(Axis, f64)]) -> Position {
    mm_or_rad.iter().copied().collect()
}

fn x_position(mm: f64) -> Position {
    position_of(&[(Axis::X, mm)])
}

/// Motions to a position beside the part, whose contact is at 28 mm.
fn approach_motions() -> Vec<Motion> {
    let down = position_of(&[(Axis::Z, -150.0)]);
    vec![
        Motion::Rapid { to: x_position(40.0) },
        Motion::Guarded { to: down, feed_mm_min: 500.0 },
        Motion::Guarded { to: x_position(30.123), feed_mm_min: 299.5 },
    ]
}

fn touch_and_back_off() -> [Motion; 2] {
    [
        Motion::Probe { to: x_position(27.0), feed_mm_min: 60.0 },
        Motion::BackOff { to: x_position(30.123), feed_mm_min: 600.0 },
    ]
}

fn block(motions: Vec<Motion>) -> MotionBlock {
    MotionBlock { step: 70_001, repeat: 0, motions }
}

async fn prepared_driver(keys: &str, faults: Vec<Fault>) -> (ModbusDriver, ControlEventLog) {
    let (mut driver, _, diary) = driver_of_simulated_control(keys, SimulationPace::Immediate, faults).await;
    driver.prepare().await.unwrap();
    (driver, diary)
}

fn executed_texts(events: &ControlEventLog) -> Vec<String> {
    let events = events.lock().unwrap();
    let took = events.iter().filter_map(|entry| match entry {
        ControlEvent::ChunkAccepted { text, .. } => Some(text.clone()),
        _ => None,
    });
    took.collect()
}

#[tokio::test]
async fn block_is_one_call_with_the_motions_of_the_text() {
    let (mut driver, diary) = prepared_driver(PROGRAM_KEYS, Vec::new()).await;
    let mut motions = vec![Motion::OrientSpindle { s: -0.5 }, Motion::Dwell { seconds: 0.25 }];
    motions.extend(approach_motions());
    motions.extend(touch_and_back_off());
    motions.push(Motion::Rapid { to: position_of(&[(Axis::B, -0.1), (Axis::C, 0.2)]) });
    let outcome = driver.execute(prove_block(&block(motions))).await.unwrap();
    let touch = outcome.trigger_position.unwrap();
    assert!((touch.get_or_zero(Axis::X) - 28.0).abs() < 1e-3, "{touch:?}");
    assert_eq!((touch.get_or_zero(Axis::Z), touch.get_or_zero(Axis::S)), (-150.0, -0.5));
    // -0.5 rad is 331.352 degrees, -0.1 and 0.2 rad are -5.7296 and 11.4592 degrees.
    assert_eq!(
        executed_texts(&diary),
        ["step 70001: Orient 331.352; Dwell 0.25; Rapid X40.0000 0; Guarded Z-150.0000 500; Guarded \
          X30.1230 299.5; Touch X27.0000 60; Feed X30.1230 600; Rapid B-5.7296 C11.4592 0"]
    );
}

#[tokio::test]
async fn results_of_a_list_of_touches_are_transferred_one_by_one() {
    for kind in [None, Some(FaultKind::AcknowledgeIgnored), Some(FaultKind::StaleResult)] {
        let faults = kind.map(|kind| Fault { after_touch: 2, ..fault_at_line(kind, 0) });
        let (mut driver, diary) = prepared_driver(PROGRAM_KEYS, faults.into_iter().collect()).await;
        let motions: Vec<_> = approach_motions()
            .into_iter()
            .chain([touch_and_back_off(), touch_and_back_off(), touch_and_back_off()].concat())
            .collect();
        let block = block(motions);
        let rows = rows::rows_from_block(&prove_block(&block)).unwrap();
        let program = driver.program.clone().unwrap();
        let (found, status) = driver.execute_rows(&program, &rows, &prove_block(&block)).await.unwrap();
        assert_eq!(found.iter().map(|found| found.row_index).collect::<Vec<_>>(), [3, 5, 7], "{kind:?}");
        // Each result is a contact that the control has made.
        let diary = diary.lock().unwrap();
        let made = diary.iter().filter_map(|entry| match entry {
            ControlEvent::ContactLatched { t_s, .. } => Some(Some(*t_s)),
            _ => None,
        });
        let times: Vec<_> = found.iter().map(|found: &ContactRowResult| found.latch_time_s).collect();
        assert_eq!(times, made.collect::<Vec<_>>());
        assert_eq!(status.latch_count, 3);
        let wrong = |entry: &&ControlEvent| matches!(entry, ControlEvent::FaultOccurred(_));
        assert_eq!(diary.iter().filter(wrong).count(), usize::from(kind.is_some()));
    }
}

#[tokio::test]
async fn unexpected_and_missing_contacts_end_the_program() {
    let (mut driver, _) = prepared_driver(PROGRAM_KEYS, Vec::new()).await;
    let mut motions = approach_motions();
    motions.push(Motion::Guarded { to: x_position(20.0), feed_mm_min: 60.0 });
    motions.push(Motion::Rapid { to: x_position(-40.0) });
    let error = driver.execute(prove_block(&block(motions))).await.unwrap_err();
    assert!(matches!(error, ControllerError::UnexpectedContact { step: 70_001 }), "{error}");
    let stands = driver.read_snapshot().await.unwrap().position.get_or_zero(Axis::X);
    assert!((stands - 28.0).abs() < 0.1, "{stands}");

    let (mut driver, _) = prepared_driver(PROGRAM_KEYS, Vec::new()).await;
    let mut motions = approach_motions();
    motions.push(Motion::Probe { to: x_position(29.0), feed_mm_min: 60.0 });
    motions.push(Motion::Rapid { to: x_position(40.0) });
    let error = driver.execute(prove_block(&block(motions))).await.unwrap_err();
    assert!(matches!(error, ControllerError::NoContact { .. }), "{error}");
    assert_eq!(driver.read_snapshot().await.unwrap().position.get_or_zero(Axis::X), 29.0);
}

#[tokio::test]
async fn unread_result_is_not_used_by_the_next_run() {
    let (mut first, diary) = prepared_driver(PROGRAM_KEYS, Vec::new()).await;
    // The program ends, and its result is never acknowledged: the daemon was killed.
    let motions: Vec<_> = approach_motions().into_iter().chain(touch_and_back_off()).collect();
    let block = block(motions);
    let rows = rows::rows_from_block(&prove_block(&block)).unwrap();
    let (program, sequence) = (first.program.clone().unwrap(), first.window.next_sequence());
    let call = super::layout::ProgramCall { sequence, program: &program, step: 70_001, rows: &rows };
    let chunk = program.layout.encode_chunk(&call).unwrap();
    first.window.start_chunk(&chunk, "a call", Duration::ZERO).await.unwrap();
    tokio::time::sleep(Duration::from_millis(50)).await;
    let shown = first.window.read_status().await.unwrap().result.unwrap();
    assert!(shown.is_unacknowledged && shown.has_contact);
    // The next run prepares, and its own touch has another result.
    first.prepare().await.unwrap();
    assert!(!first.window.read_status().await.unwrap().result.unwrap().is_unacknowledged);
    let outcome = first
        .execute(prove_block(&MotionBlock { step: 2, repeat: 0, motions: touch_and_back_off().into() }))
        .await
        .unwrap();
    let diary = diary.lock().unwrap();
    let last = diary.iter().rev().find_map(|entry| match entry {
        ControlEvent::ContactLatched { t_s, .. } => Some(*t_s),
        _ => None,
    });
    assert_eq!(outcome.trigger_time_s, last);
}

#[tokio::test]
async fn block_that_does_not_fit_the_registers_starts_no_program() {
    let coarse = "[program.row]\nX = { scale = 0.01 }";
    for (keys, why) in [
        (coarse, "the registers would contain 30.12 instead of 30.123"),
        ("[program]\n[registers.command]\nchunk = { registers = 72 }", "holds only 4 rows"),
    ] {
        let (mut driver, diary) = prepared_driver(keys, Vec::new()).await;
        let motions = approach_motions().into_iter().chain(touch_and_back_off()).collect();
        let error = driver.execute(prove_block(&block(motions))).await.unwrap_err();
        assert!(error.to_string().contains(why), "{error}");
        assert!(executed_texts(&diary).is_empty());
    }
}

#[tokio::test]
async fn refusals_are_reported_with_their_reason() {
    for (keys, why) in [
        ("[program]\nnumber = 9", "program number is unknown"),
        ("[program]\ntool = 4", "another tool"),
        // An item is at another address: the checksum still fits, but the call is not the right one.
        ("[program.parameters]\nsequence = { address = 7 }", "cannot execute a row"),
    ] {
        let (mut driver, diary) = prepared_driver(keys, Vec::new()).await;
        let error = driver.execute(prove_block(&block(approach_motions()))).await.unwrap_err();
        assert!(error.to_string().contains(why), "{error}");
        assert!(executed_texts(&diary).is_empty());
        assert_eq!(driver.read_snapshot().await.unwrap().position.get_or_zero(Axis::X), 0.0);
    }
}

#[tokio::test]
async fn unfinished_call_of_an_earlier_run_is_ignored() {
    let (mut driver, diary) = prepared_driver(PROGRAM_KEYS, Vec::new()).await;
    driver.window.start_chunk(&[0; 48], "nonsense", Duration::ZERO).await.unwrap();
    driver.prepare().await.unwrap();
    driver.execute(prove_block(&block(approach_motions()))).await.unwrap();
    assert_eq!(executed_texts(&diary).len(), 1);
}

#[tokio::test]
async fn a_contact_during_a_rapid_is_held() {
    let faults = vec![fault_at_line(FaultKind::RapidContact, 0)];
    let (mut driver, _, diary) = driver_of_simulated_control(PROGRAM_KEYS, SimulationPace::RealTime, faults).await;
    driver.prepare().await.unwrap();
    let error = driver.execute(prove_block(&block(vec![Motion::Rapid { to: x_position(390.0) }]))).await.unwrap_err();
    assert!(matches!(error, ControllerError::UnexpectedContact { .. }), "{error}");
    wait_for_hold(&diary).await;
    let stands = driver.read_snapshot().await.unwrap().position.get_or_zero(Axis::X);
    assert!(stands < 380.0, "{stands}");
}

#[tokio::test]
async fn a_contact_during_a_turn_at_feed_is_held() {
    let faults = vec![fault_at_line(FaultKind::RapidContact, 0)];
    let (mut driver, _, diary) = driver_of_simulated_control(PROGRAM_KEYS, SimulationPace::RealTime, faults).await;
    driver.prepare().await.unwrap();
    let error = driver.execute(prove_block(&turn_at_feed())).await.unwrap_err();
    assert!(matches!(error, ControllerError::UnexpectedContact { .. }), "{error}");
    wait_for_hold(&diary).await;
    let turned = driver.read_snapshot().await.unwrap().position.get_or_zero(Axis::C).to_degrees();
    assert!(turned < 15.0, "{turned}");
}

#[tokio::test]
async fn contact_off_the_path_and_wrong_end_position_give_no_result() {
    for (item, first) in [("latch", 20), ("position", 32)] {
        // X and Y are read from each other's registers.
        let axes = [("X", 2), ("Y", 0), ("Z", 4), ("B", 8), ("C", 10)];
        let axes = axes.map(|(axis, k)| format!("{axis} = {{ address = {} }}", first + k));
        let keys = format!("{PROGRAM_KEYS}\n[registers.status]\n{item} = {{ {} }}", axes.join(", "));
        let (mut driver, diary) = prepared_driver(&keys, Vec::new()).await;
        let motions = approach_motions().into_iter().chain(touch_and_back_off()).collect();
        let error = driver.execute(prove_block(&block(motions))).await.unwrap_err();
        assert!(matches!(error, ControllerError::WrongPosition { .. }), "{item}: {error}");
        assert!(matches!(diary.lock().unwrap()[..], [.., ControlEvent::ContactLatched { .. }]));
    }
}
