//! Tests of the driver against the simulated control: stops, and register tables that do not fit.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::json;
use tokio::net::TcpListener;

use super::timeouts::ModbusTimeouts;
use super::{ModbusConfig, ModbusDriver};
use crate::controllers::{ControllerDriver, ControllerError, HaltHandle};
use machine::record::artefact::Artefact;
use machine::record::machine::{Machine, Probe};
use machine::record::motion::{Motion, MotionBlock};
use machine::{Axis, Position};
use planning::gcode::TransmissionForm;
use planning::proof::for_tests::{load_dialect, prove_block_text};
use planning::proof::{ProvenBlock, render_and_prove_mode_text};
use simulator::controls::modbus::{
    ControlEvent, ControlEventLog, Fault, FaultKind, Firmware, SimulatedModbusOptions, serve_tcp,
};
use simulator::interpreter::SimulationPace;
use simulator::{MachineTruth, SimulatedWorld};

fn five_axis_machine() -> Machine {
    let linear = json!({"min": -400, "max": 400});
    serde_json::from_value(json!({
        "name": "bench", "topology": "w-C-B-X-F-Z-Y-S-t",
        "axes": {"X": linear, "Y": linear, "Z": linear, "B": linear, "C": linear}
    }))
    .unwrap()
}

/// Driver whose table has `keys`, its halt, and the event log of the simulated control. The control has a resident
/// program if the keys name one.
pub(super) async fn driver_of_simulated_control(
    keys: &str,
    pace: SimulationPace,
    faults: Vec<Fault>,
) -> (ModbusDriver, HaltHandle, ControlEventLog) {
    let probe: Probe = serde_json::from_value(json!({"ball_radius_mm": 3})).unwrap();
    let artefact: Artefact = serde_json::from_value(json!({
        "kind": "cylinder", "centre_mm": [0, 0, -200], "axis": [0, 0, 1], "radius_mm": 25
    }))
    .unwrap();
    let world = SimulatedWorld::new(&five_axis_machine(), &probe, &artefact, &MachineTruth::default()).unwrap();
    let resident = keys.contains("[program");
    let options = SimulatedModbusOptions {
        faults,
        has_resident_program: resident,
        ..SimulatedModbusOptions::for_machine(&five_axis_machine(), pace)
    };
    let firmware = Firmware::new(Arc::new(Mutex::new(world)), options);
    let diary = firmware.event_log();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let at = listener.local_addr().unwrap();
    tokio::spawn(serve_tcp(firmware, listener));
    let config: ModbusConfig = toml::from_str(&format!("tcp = \"{at}\"\n{keys}")).unwrap();
    let (machine, dialect) = (five_axis_machine(), load_dialect("grbl-m19").unwrap());
    let modes = render_and_prove_mode_text(&dialect, &machine.name, machine.axes.keys().copied(), None).unwrap();
    let (driver, halt) = ModbusDriver::open(&config, &machine, modes).await.unwrap();
    (driver, halt, diary)
}

/// Proves the block for transmission in lines.
fn prove_block(block: &MotionBlock) -> ProvenBlock {
    prove_block_for(&TransmissionForm::Lines { max_line_bytes: usize::MAX }, block)
}

/// Proves the block for the given transmission; the clearance of bodies is not checked.
pub(super) fn prove_block_for(transmission: &TransmissionForm, block: &MotionBlock) -> ProvenBlock {
    let axes: Vec<Axis> = five_axis_machine().axes.keys().copied().collect();
    prove_block_text(block, &axes, &load_dialect("grbl-m19").unwrap(), transmission).unwrap()
}

fn slow_move_to(x_mm: f64) -> MotionBlock {
    let to = Position::new().with(Axis::X, x_mm);
    MotionBlock { step: 1, repeat: 0, motions: vec![Motion::BackOff { to, feed_mm_min: 600.0 }] }
}

async fn halt_during_move(driver: &mut ModbusDriver, halt: HaltHandle) -> ControllerError {
    tokio::spawn(async move {
        tokio::time::sleep(Duration::from_millis(200)).await;
        halt.trigger();
    });
    driver.execute(prove_block(&slow_move_to(100.0))).await.unwrap_err()
}

#[tokio::test]
async fn halt_stops_a_move_and_no_command_follows() {
    let (mut driver, halt, diary) = driver_of_simulated_control("", SimulationPace::RealTime, Vec::new()).await;
    driver.prepare().await.unwrap();
    let error = halt_during_move(&mut driver, halt).await;
    assert!(matches!(error, ControllerError::Halted), "{error}");
    let stands = driver.read_snapshot().await.unwrap().position.get_or_zero(Axis::X);
    assert!(0.0 < stands && stands < 90.0, "{stands}");
    let error = driver.execute(prove_block(&slow_move_to(0.0))).await.unwrap_err();
    assert!(matches!(error, ControllerError::Halted), "{error}");
    assert!(driver.prepare().await.is_err());
    let diary = diary.lock().unwrap();
    assert_eq!(diary.last(), Some(&ControlEvent::HoldRegisterWritten));
}

#[tokio::test]
async fn lost_hold_is_repeated() {
    let lost = vec![fault_at_line(FaultKind::LostHold, 0), fault_at_line(FaultKind::LostHold, 0)];
    let (mut driver, halt, diary) = driver_of_simulated_control("", SimulationPace::RealTime, lost).await;
    driver.prepare().await.unwrap();
    let error = halt_during_move(&mut driver, halt).await;
    assert!(matches!(error, ControllerError::Halted), "{error}");
    let stands = driver.read_snapshot().await.unwrap().position.get_or_zero(Axis::X);
    assert!(0.0 < stands && stands < 90.0, "{stands}");
    let diary = diary.lock().unwrap();
    assert_eq!(diary.iter().filter(|entry| **entry == ControlEvent::FaultOccurred(FaultKind::LostHold)).count(), 2);
    assert_eq!(diary.last(), Some(&ControlEvent::HoldRegisterWritten));
}

/// The control ignores every hold, and reports the motion.
#[tokio::test]
async fn control_that_does_not_hold_is_reported() {
    let deaf = (0..1000).map(|_| fault_at_line(FaultKind::LostHold, 0)).collect();
    let (driver, halt, _) = driver_of_simulated_control("", SimulationPace::RealTime, deaf).await;
    let timeouts = ModbusTimeouts { reply_timeout: Duration::from_millis(100), ..ModbusTimeouts::default() };
    let mut driver = driver.with_timeouts(timeouts);
    driver.prepare().await.unwrap();
    let error = halt_during_move(&mut driver, halt).await;
    assert!(matches!(error, ControllerError::HoldFailed { .. }), "{error}");
    assert!(error.remedy().contains("emergency stop"), "{}", error.remedy());
}

#[tokio::test]
async fn frozen_control_is_refused_by_prepare() {
    let (mut dead, ..) =
        driver_of_simulated_control("", SimulationPace::Immediate, vec![fault_at_line(FaultKind::ProgramStopped, 0)])
            .await;
    let error = dead.prepare().await.unwrap_err();
    assert!(matches!(error, ControllerError::ControlFrozen), "{error}");
}

/// The control's program stops during a move; its registers no longer change, and could be taken for those
/// of a machine that moves slowly.
#[tokio::test]
async fn stopped_heartbeat_ends_a_move_before_the_stall_timeout() {
    let frozen = vec![fault_at_line(FaultKind::ProgramStopped, 20)];
    let (driver, ..) = driver_of_simulated_control("", SimulationPace::RealTime, frozen).await;
    let heartbeat = Duration::from_millis(400);
    let long = Duration::from_secs(10);
    let timeouts = ModbusTimeouts {
        heartbeat_timeout: heartbeat,
        stall_timeout: long,
        reply_timeout: long,
        ..ModbusTimeouts::default()
    };
    let mut driver = driver.with_timeouts(timeouts);
    driver.prepare().await.unwrap();
    let mut ended = Ok(Default::default());
    for x_mm in 1..30 {
        ended = driver.execute(prove_block(&slow_move_to(f64::from(x_mm)))).await;
        if ended.is_err() {
            break;
        }
    }
    assert!(matches!(ended, Err(ControllerError::ControlFrozen)), "{ended:?}");
}

/// Only the heartbeat stops: the control's program continues, and each move ends long before the timeout.
#[tokio::test]
async fn stopped_heartbeat_is_detected_over_short_moves() {
    let stands = vec![fault_at_line(FaultKind::HeartbeatStopped, 5)];
    let (driver, ..) = driver_of_simulated_control("", SimulationPace::RealTime, stands).await;
    let timeouts = ModbusTimeouts { heartbeat_timeout: Duration::from_millis(400), ..ModbusTimeouts::default() };
    let mut driver = driver.with_timeouts(timeouts);
    driver.prepare().await.unwrap();
    let mut ended = Ok(Default::default());
    for x_mm in 1..30 {
        ended = driver.execute(prove_block(&slow_move_to(f64::from(x_mm)))).await;
        if ended.is_err() {
            break;
        }
    }
    assert!(matches!(ended, Err(ControllerError::ControlFrozen)), "{ended:?}");
}

#[tokio::test]
async fn implausible_time_stamp_gives_no_reading() {
    let wrong = vec![fault_at_line(FaultKind::WrongStamp, 0)];
    let (mut driver, ..) = driver_of_simulated_control("", SimulationPace::Immediate, wrong).await;
    driver.prepare().await.unwrap();
    let x = |x_mm: f64| Position::new().with(Axis::X, x_mm);
    let down = Position::new().with(Axis::Z, -190.0);
    let way = vec![Motion::Rapid { to: x(60.0) }, Motion::Rapid { to: down }];
    driver.execute(prove_block(&MotionBlock { step: 0, repeat: 0, motions: way })).await.unwrap();
    let motions =
        vec![Motion::Probe { to: x(20.0), feed_mm_min: 60.0 }, Motion::BackOff { to: x(60.0), feed_mm_min: 300.0 }];
    let touch = driver.execute(prove_block(&MotionBlock { step: 1, repeat: 0, motions })).await;
    let error = touch.unwrap_err();
    assert!(error.to_string().contains("1e300 s"), "{error}");
    assert!(error.remedy().contains("latch_time_s"), "{}", error.remedy());
}

/// Until a touch has verified the position, a turn is a feed motion (planning `turn_feeds.rs`).
#[tokio::test]
async fn a_contact_during_a_turn_at_feed_is_held() {
    let faults = vec![fault_at_line(FaultKind::RapidContact, 0)];
    let (mut driver, _, diary) = driver_of_simulated_control("", SimulationPace::RealTime, faults).await;
    driver.prepare().await.unwrap();
    let error = driver.execute(prove_block(&turn_at_feed())).await.unwrap_err();
    assert!(matches!(error, ControllerError::UnexpectedContact { .. }), "{error}");
    wait_for_hold(&diary).await;
    let turned = driver.read_snapshot().await.unwrap().position.get_or_zero(Axis::C).to_degrees();
    assert!(turned < 15.0, "{turned}");
}

/// A turn that takes two seconds if no hold ends it.
pub(super) fn turn_at_feed() -> MotionBlock {
    let to = Position::new().with(Axis::C, 20_f64.to_radians());
    MotionBlock { step: 1, repeat: 0, motions: vec![Motion::Feed { to, feed_mm_min: 600.0 }] }
}

/// Waits until a hold is the last event of the simulated control; panics after one second.
pub(super) async fn wait_for_hold(events: &ControlEventLog) {
    let deadline = tokio::time::Instant::now() + Duration::from_secs(1);
    while events.lock().unwrap().last() != Some(&ControlEvent::HoldRegisterWritten) {
        assert!(tokio::time::Instant::now() < deadline, "no hold");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// A touch during which any one status is torn: half of it is an older one.
#[tokio::test]
async fn torn_status_does_not_change_the_touch_result() {
    let x = |x_mm: f64| Position::new().with(Axis::X, x_mm);
    let down = |z_mm: f64| Position::new().with(Axis::Z, z_mm);
    let probe = |from: f64, to: f64| MotionBlock {
        step: 1,
        repeat: 0,
        motions: vec![
            Motion::Rapid { to: x(from) },
            Motion::Probe { to: x(to), feed_mm_min: 60.0 },
            Motion::BackOff { to: x(from), feed_mm_min: 300.0 },
        ],
    };
    let mut torn_within = 0;
    for at_request in 0..120 {
        let torn = Fault { at_request, ..fault_at_line(FaultKind::StatusChangesDuringRead, 0) };
        let (mut driver, _, diary) = driver_of_simulated_control("", SimulationPace::Immediate, vec![torn]).await;
        driver.prepare().await.unwrap();
        let begun = diary.lock().unwrap().len();
        let way = vec![Motion::Rapid { to: x(60.0) }, Motion::Rapid { to: down(-190.0) }];
        driver.execute(prove_block(&MotionBlock { step: 0, repeat: 0, motions: way })).await.unwrap();
        let far = driver.execute(prove_block(&probe(60.0, 20.0))).await.unwrap().trigger_position.unwrap();
        let diary = diary.lock().unwrap();
        torn_within +=
            usize::from(diary[begun..].contains(&ControlEvent::FaultOccurred(FaultKind::StatusChangesDuringRead)));
        assert!((far.get_or_zero(Axis::X) - 28.0).abs() < 0.01, "{at_request}: {}", far.get_or_zero(Axis::X));
    }
    assert!(torn_within > 20, "{torn_within}");
}

pub(super) fn fault_at_line(kind: FaultKind, at_line: u64) -> Fault {
    Fault {
        kind,
        at_request: 0,
        min_accepted_chunks: at_line,
        after_touch: 0,
        code: None,
        late_s: None,
        slow_latch_period_s: None,
    }
}

#[tokio::test]
async fn swapped_registers_are_reported_before_motion() {
    let shifted = "[registers.status]\nversion = { address = 3 }\nalarm = { address = 1 }";
    let (mut driver, _, diary) =
        self::driver_of_simulated_control(shifted, SimulationPace::Immediate, Vec::new()).await;
    let error = driver.prepare().await.unwrap_err();
    assert!(error.to_string().contains("version 0"), "{error}");
    assert!(error.remedy().contains("[controller.registers]"));
    assert!(diary.lock().unwrap().is_empty());
}

#[tokio::test]
async fn wrong_word_order_is_detected_by_the_implied_position() {
    let axes = |first: u16, order: &str| {
        let axis = |(axis, k): (&str, u16)| format!("{axis} = {{ address = {}, order = \"{order}\" }}", first + k);
        [("X", 0), ("Y", 2), ("Z", 4), ("B", 8), ("C", 10)].map(axis).join(", ")
    };
    let keys = |order: &str| {
        let (position, latch) = (axes(32, order), axes(20, order));
        format!("[registers.status]\nposition = {{ {position} }}\nlatch = {{ {latch} }}")
    };
    let (mut driver, ..) =
        self::driver_of_simulated_control(&keys("abcd"), SimulationPace::Immediate, Vec::new()).await;
    driver.prepare().await.unwrap();
    driver.execute(prove_block(&slow_move_to(12.5))).await.unwrap();
    let (mut driver, ..) =
        self::driver_of_simulated_control(&keys("cdab"), SimulationPace::Immediate, Vec::new()).await;
    let error = driver.prepare().await.unwrap_err();
    assert!(error.to_string().contains("is not plausible"), "{error}");
}

#[test]
fn invalid_controller_keys_are_refused_with_a_reason() {
    for (keys, why) in [
        ("", "exactly one link"),
        ("tcp = \"a:1\"\nparity = \"even\"", "is only for `serial`"),
        ("serial = \"/dev/x\"\nframing = \"tcp\"", "needs a TCP link"),
        ("serial = \"/dev/x\"\nunit = 0", "1 to 247"),
        ("tcp = \"a:1\"\ntimeout_s = 0.0", "permitted: 0.01 to 30 s"),
        ("tcp = \"a:1\"\n[registers.command]\nhold = { address = 1 }", "overlap at address"),
        ("tcp = \"a:1\"\nregister = 1", "unknown field"),
        ("tcp = \"a:1\"\n[registers.status.result]", "belongs to a resident program"),
        ("tcp = \"a:1\"\n[program]\nnummer = 1", "unknown field"),
        ("tcp = \"a:1\"\n[program.row]\nX = { address = 5 }", "`row.X` and `row.Y` overlap at address"),
        ("tcp = \"a:1\"\n[program.row]\nC = { address = 15 }", "beyond the 16 registers of a row"),
        ("tcp = \"a:1\"\n[program.parameters]\nrows = { address = 8 }", "before the table"),
        ("tcp = \"a:1\"\nprogram = {}\n[registers.command]\nchunk = { registers = 20 }", "too small for one row"),
        ("tcp = \"a:1\"\nprogram = {}\n[registers.command]\nchunk = { order = \"badc\" }", "have no `order`"),
        ("tcp = \"a:1\"\nprogram = {}\n[registers.status]\nsequence_tail = { address = 44 }", "outside the block"),
    ] {
        let said = toml::from_str::<ModbusConfig>(keys).unwrap_err();
        assert!(said.message().contains(why), "{keys}: {}", said.message());
    }
}
