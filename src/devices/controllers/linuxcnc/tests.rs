//! Tests of the driver against a scripted linuxcncrsh that sends the lines of the real one; a test replaces
//! some of its answers. `tests/interop/linuxcnc` tests the behaviour of the real one.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::{TcpListener, TcpStream};

use super::driver::{LinuxCncDriver, LinuxCncSettings};
use super::files::result_log_path;
use crate::controllers::{ControllerDriver, ControllerError, HaltHandle};
use link::LinkAddress;
use machine::record::motion::{Motion, MotionBlock, MotionBlockOutcome};
use machine::{Axis, Position};
use planning::gcode::TransmissionForm;
use planning::proof::for_tests::{load_dialect, prove_block_text, prove_block_text_from};
use planning::proof::{ProvenBlock, render_and_prove_mode_text};

/// Replaces a reply of the healthy control: number of the connection, from 1 (the second is the one for halts), and
/// line; `None`: the healthy control replies.
type ReplyOverride = Box<dyn FnMut(usize, &str) -> Option<&'static str> + Send>;

/// Numbers of the log line `state`: no offset, kinematics of type 0.
const READY_STATE: &str = "2.9 0 0 0 0 0 0 0 0 0 1 0";

/// Scripted control with its machine, which moves along X only.
#[derive(Default)]
pub(super) struct ScriptedControl {
    program_path: String,
    state_log_values: &'static str,
    /// Log of each program that moves, and the X position at its end, mm; `None`: such a program never ends.
    log_and_end_x_mm: Option<(&'static str, f64)>,
    is_moving: bool,
    x_mm: f64,
    abort_count: usize,
}

impl ScriptedControl {
    fn run(&mut self) {
        let text = fs::read_to_string(&self.program_path).unwrap();
        let log = text.split("(LOGOPEN,").nth(1).unwrap().split(')').next().unwrap();
        if text.contains("(LOG,state") {
            fs::write(log, format!("state {}\nEND\n", self.state_log_values)).unwrap();
        } else if let Some((says, x)) = self.log_and_end_x_mm {
            fs::write(log, says).unwrap();
            self.x_mm = x;
        } else {
            self.is_moving = true;
        }
    }

    fn set(&mut self, what: &str) -> String {
        let (key, rest) = what.split_once(' ').unwrap_or((what, ""));
        match key {
            "open" => self.program_path = rest.to_owned(),
            "run" => self.run(),
            "abort" => (self.is_moving, self.abort_count) = (false, self.abort_count + 1),
            _ => {}
        }
        format!("SET {} ACK\n\r", key.to_uppercase())
    }

    fn get(&mut self, key: &str) -> String {
        self.x_mm += f64::from(u8::from(self.is_moving));
        let said = match key {
            "ESTOP" => "OFF".to_owned(),
            "MACHINE" => "ON".to_owned(),
            "JOINT_HOMED" => "YES ".repeat(9),
            "OPTIONAL_STOP" => "1".to_owned(),
            "PROGRAM" => self.program_path.clone(),
            "PROGRAM_STATUS" if self.is_moving => "RUNNING".to_owned(),
            "PROGRAM_STATUS" => "IDLE".to_owned(),
            "FEED_OVERRIDE" => "100".to_owned(),
            "MODE" => "AUTO".to_owned(),
            "USER_LINEAR_UNITS" => "MM".to_owned(),
            "USER_ANGULAR_UNITS" => "DEG".to_owned(),
            "PROBE_VALUE" => "0".to_owned(),
            "ABS_ACT_POS" | "JOINT_POS" => format!("{:.6} 0.0 0.0 0.0 0.0 0.0", self.x_mm),
            _ => "OK".to_owned(),
        };
        format!("{key} {said}\r\n")
    }

    fn reply(&mut self, line: &str) -> String {
        match line.split_once(' ') {
            Some(("hello", _)) => "HELLO ACK EMCNETSVR 1.1\n\r".to_owned(),
            Some(("set", "echo off")) => String::new(),
            Some(("set", what)) => self.set(what),
            Some(("get", key)) => self.get(key),
            _ => panic!("{line}"),
        }
    }
}

async fn serve_peer(
    mut stream: TcpStream,
    connection_number: usize,
    odd: Arc<Mutex<ReplyOverride>>,
    machine: Arc<Mutex<ScriptedControl>>,
) {
    let (read, mut write) = stream.split();
    let mut lines = BufReader::new(read).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        let said = odd.lock().unwrap()(connection_number, &line).map(str::to_owned);
        let said = said.unwrap_or_else(|| machine.lock().unwrap().reply(&line));
        if write.write_all(said.as_bytes()).await.is_err() {
            return;
        }
    }
}

/// A prepared driver, its halt, and the machine.
pub(super) async fn prepared_driver(
    directory: &tempfile::TempDir,
    program_end: Option<(&'static str, f64)>,
    odd: impl FnMut(usize, &str) -> Option<&'static str> + Send + 'static,
) -> (LinuxCncDriver, HaltHandle, Arc<Mutex<ScriptedControl>>) {
    let (mut driver, halt, machine) = open_driver(directory, program_end, odd).await;
    driver.prepare().await.unwrap();
    (driver, halt, machine)
}

/// A driver that is not prepared yet, its halt, and the machine.
async fn open_driver(
    directory: &tempfile::TempDir,
    program_end: Option<(&'static str, f64)>,
    odd: impl FnMut(usize, &str) -> Option<&'static str> + Send + 'static,
) -> (LinuxCncDriver, HaltHandle, Arc<Mutex<ScriptedControl>>) {
    let machine = Arc::new(Mutex::new(ScriptedControl {
        log_and_end_x_mm: program_end,
        state_log_values: READY_STATE,
        ..ScriptedControl::default()
    }));
    let odd: Arc<Mutex<ReplyOverride>> = Arc::new(Mutex::new(Box::new(odd)));
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let of = machine.clone();
    tokio::spawn(async move {
        for number in 1.. {
            let (stream, _) = listener.accept().await.unwrap();
            tokio::spawn(serve_peer(stream, number, odd.clone(), of.clone()));
        }
    });
    let settings = LinuxCncSettings {
        address: LinkAddress::Tcp { host: "127.0.0.1".to_owned(), port },
        shared_directory: directory.path().to_owned(),
        axes: vec![Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C],
        ini_path: Some(rig_ini_path()),
    };
    let dialect = load_dialect("linuxcnc").unwrap();
    let log = result_log_path(directory.path());
    let modes = render_and_prove_mode_text(&dialect, "test", settings.axes.clone(), Some(&log)).unwrap();
    let (driver, halt) = LinuxCncDriver::open(settings, modes).await.unwrap();
    (driver, halt, machine)
}

/// INI file with kinematics `xyzbc-trt-kins sparm=identityfirst`, five joints.
fn rig_ini_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers/linuxcnc/rig.ini")
}

fn x_position(x_mm: f64) -> Position {
    Position::new().with(Axis::X, x_mm)
}

/// Proves the block for the transmission of this control; the clearance of bodies is not checked.
fn prove_block(driver: &LinuxCncDriver, block: &MotionBlock) -> ProvenBlock {
    let dialect = load_dialect("linuxcnc").unwrap();
    prove_block_text(block, &driver.settings.axes, &dialect, &driver.transmission()).unwrap()
}

/// Rapid move to X 60 and guarded move to X 30.
fn guarded_block() -> MotionBlock {
    let motions =
        vec![Motion::Rapid { to: x_position(60.0) }, Motion::Guarded { to: x_position(30.0), feed_mm_min: 300.0 }];
    MotionBlock { step: 1, repeat: 0, motions }
}

async fn halt_during_move(mut driver: LinuxCncDriver, halt: HaltHandle) -> Result<MotionBlockOutcome, ControllerError> {
    let person = tokio::spawn(async move {
        tokio::time::sleep(Duration::from_millis(100)).await;
        halt.trigger();
    });
    let outcome = driver.execute(prove_block(&driver, &guarded_block())).await;
    person.await.unwrap();
    outcome
}

/// Words of one line are mixed into another: each of these answers is one that `strtok` in two threads can
/// give.
#[tokio::test]
async fn halt_stops_the_machine_despite_odd_replies() {
    let directory = tempfile::tempdir().unwrap();
    let mut odd = vec![
        ("get ABS_ACT_POS", "ABS_ACT_POS A 0.0\r\n"),
        ("set abort", "SET NAK\n\r"),
        ("set enable EMCTOO", "SET ABORT ACK\n\r"),
    ];
    let mut hears = false;
    let (driver, halt, machine) = prepared_driver(&directory, None, move |number, line| match (number, line) {
        (2, "set enable EMCTOO") => {
            hears = true;
            Some("SET NAK\n\r")
        }
        (2, "set abort") => Some("SET ABORT NAK\n\r"),
        (1, line) if hears => odd.pop_if(|(asked, _)| *asked == line).map(|(_, answer)| answer),
        _ => None,
    })
    .await;
    let outcome = halt_during_move(driver, halt).await;
    assert!(matches!(outcome, Err(ControllerError::Halted)), "{outcome:?}");
    let machine = machine.lock().unwrap();
    assert!(!machine.is_moving && machine.abort_count >= 1, "{} aborts", machine.abort_count);
}

#[tokio::test]
async fn control_that_refuses_abort_is_reported() {
    let directory = tempfile::tempdir().unwrap();
    let (driver, halt, machine) =
        prepared_driver(&directory, None, |_, line| (line == "set abort").then_some("SET ABORT NAK\n\r")).await;
    let error = halt_during_move(driver, halt).await.unwrap_err();
    assert!(matches!(error, ControllerError::HoldFailed { .. }), "{error}");
    assert!(error.may_have_lost_position() && error.remedy().contains("emergency stop"));
    assert!(machine.lock().unwrap().is_moving);
}

#[tokio::test]
async fn block_for_other_start_or_transmission_is_not_executed() {
    let directory = tempfile::tempdir().unwrap();
    let well = "guarded 1 1 0.000000 30.0 0.0 0.0\nEND\n";
    let (mut driver, _, machine) = prepared_driver(&directory, Some((well, 30.0)), |_, _| None).await;
    let dialect = load_dialect("linuxcnc").unwrap();
    let (axes, sent) = (driver.settings.axes.clone(), driver.transmission());
    let before = fs::read_to_string(&machine.lock().unwrap().program_path).unwrap();
    let elsewhere = prove_block_text_from(x_position(12.0), &guarded_block(), &axes, &dialect, &sent).unwrap();
    let error = driver.execute(elsewhere).await.unwrap_err();
    assert!(error.to_string().contains("it is at X0.000, not at X12.000"), "{error}");
    driver.prepare().await.unwrap();
    let as_lines = TransmissionForm::Lines { max_line_bytes: 80 };
    let foreign = prove_block_text(&guarded_block(), &axes, &dialect, &as_lines).unwrap();
    let error = driver.execute(foreign).await.unwrap_err();
    assert!(matches!(error, ControllerError::WrongTransmission { step: 1 }), "{error}");
    assert_eq!(fs::read_to_string(&machine.lock().unwrap().program_path).unwrap(), before);
}

#[tokio::test]
async fn executed_program_is_the_proven_text() {
    let directory = tempfile::tempdir().unwrap();
    let well = "guarded 1 1 0.000000 30.0 0.0 0.0\nEND\n";
    let (mut driver, _, machine) = prepared_driver(&directory, Some((well, 30.0)), |_, _| None).await;
    let block = prove_block(&driver, &guarded_block());
    let [part] = block.units().unwrap() else { panic!("{block:?}") };
    let text = part.unit.text.clone();
    driver.execute(block).await.unwrap();
    let ran = fs::read_to_string(&machine.lock().unwrap().program_path).unwrap();
    assert_eq!(ran, text);
    assert!(ran.contains("X30"), "{ran}");
}

/// The log, which the interpreter writes, reports success.
#[tokio::test]
async fn program_with_a_wrong_end_position_fails() {
    let directory = tempfile::tempdir().unwrap();
    let well = "guarded 1 1 0.000000 30.0 0.0 0.0\nEND\n";
    let (mut driver, ..) = prepared_driver(&directory, Some((well, 30.0)), |_, _| None).await;
    driver.execute(prove_block(&driver, &guarded_block())).await.unwrap();

    let (mut driver, _, machine) = prepared_driver(&directory, Some((well, 47.0)), |_, _| None).await;
    let error = driver.execute(prove_block(&driver, &guarded_block())).await.unwrap_err();
    assert!(error.to_string().contains("X47.000, not at X30.000"), "{error}");
    assert_eq!(machine.lock().unwrap().abort_count, 1);

    let stale = "touch 1 1 1.000000 -28.0 0.0 0.0 0.0 0.0 0.0\nEND\n";
    let (mut driver, ..) = prepared_driver(&directory, Some((stale, 28.0)), |_, _| None).await;
    let motions =
        vec![Motion::Rapid { to: x_position(30.0) }, Motion::Probe { to: x_position(26.0), feed_mm_min: 30.0 }];
    let error = driver.execute(prove_block(&driver, &MotionBlock { step: 1, repeat: 0, motions })).await.unwrap_err();
    assert!(matches!(error, ControllerError::WrongPosition { .. }), "{error}");
}

/// At B = C = 0 each axis is where its joint is in every mode.
#[tokio::test]
async fn compensating_kinematics_are_refused_where_all_rotary_axes_are_at_zero() {
    let directory = tempfile::tempdir().unwrap();
    let (mut driver, _, machine) = open_driver(&directory, None, |_, _| None).await;
    for (state, ini, expected) in [
        ("2.9 0 0 0 0 0 0 0 0 0 1 1", Some(rig_ini_path()), Some("M429")),
        // HAL pins are not readable; without an INI file the meaning of the numbers is unknown.
        ("2.9 0 0 0 0 0 0 0 0 0 0 -1", Some(rig_ini_path()), Some("HAL_PIN_VARS")),
        (READY_STATE, None, Some("[controller] ini")),
        (READY_STATE, Some(rig_ini_path()), None),
    ] {
        machine.lock().unwrap().state_log_values = state;
        driver.settings.ini_path = ini;
        match (driver.prepare().await, expected) {
            (Ok(_), None) => {}
            (Err(ControllerError::NotReady { state, remedy }), Some(expected)) => {
                assert!(state.contains("kinematics"), "{state}");
                assert!(remedy.contains(expected), "{remedy}");
            }
            (outcome, _) => panic!("{state}: {outcome:?}"),
        }
    }
}

/// The rotary axes are away from zero and each axis is where its joint is: that is identity mode, whatever
/// the INI file has.
#[tokio::test]
async fn identity_shown_by_positions_needs_no_ini_file() {
    let directory = tempfile::tempdir().unwrap();
    let (mut driver, ..) = open_driver(&directory, None, |_, line| match line {
        "get ABS_ACT_POS" => Some("ABS_ACT_POS 20.0 30.0 10.0 0.0 5.0 12.0\r\n"),
        "get JOINT_POS" => Some("JOINT_POS 20.0 30.0 10.0 5.0 12.0 0.0\r\n"),
        _ => None,
    })
    .await;
    driver.settings.ini_path = None;
    driver.prepare().await.unwrap();
}

#[tokio::test]
async fn touch_at_another_feed_override_is_rejected() {
    let directory = tempfile::tempdir().unwrap();
    let touch = "from 1 1 30.0 0.0 0.0\ntouch 1 1 1.000000 28.0 0.0 0.0 0.0 0.0 0.0\nEND\n";
    let mut runs = 0;
    let (mut driver, ..) = prepared_driver(&directory, Some((touch, 28.0)), move |_, line| {
        runs += u32::from(line == "set run");
        // The first program of the driver moves nothing.
        (line == "get FEED_OVERRIDE" && runs > 1).then_some("FEED_OVERRIDE 120\r\n")
    })
    .await;
    let motions =
        vec![Motion::Rapid { to: x_position(30.0) }, Motion::Probe { to: x_position(26.0), feed_mm_min: 30.0 }];
    let error = driver.execute(prove_block(&driver, &MotionBlock { step: 1, repeat: 0, motions })).await.unwrap_err();
    assert!(error.to_string().contains("override is 120 %"), "{error}");
}

/// LinuxCNC itself aborts at the edge of the input; this test covers the case in which it does not.
#[tokio::test]
async fn a_contact_while_a_rotary_axis_turns_at_feed_aborts() {
    let directory = tempfile::tempdir().unwrap();
    let mut runs = 0;
    let (mut driver, _, machine) = prepared_driver(&directory, None, move |_, line| {
        runs += u32::from(line == "set run");
        (line == "get PROBE_VALUE" && runs > 1).then_some("PROBE_VALUE 1\r\n")
    })
    .await;
    let turn = Position::new().with(Axis::C, 1.0);
    let motions = vec![Motion::Feed { to: turn, feed_mm_min: 60.0 }];
    let block = prove_block(&driver, &MotionBlock { step: 4, repeat: 0, motions });
    let executed = tokio::time::timeout(Duration::from_secs(2), driver.execute(block)).await;
    let error = executed.expect("it runs on").unwrap_err();
    assert!(matches!(error, ControllerError::UnexpectedContact { step: 4 }), "{error}");
    let machine = machine.lock().unwrap();
    assert!(!machine.is_moving && machine.abort_count == 1, "{} aborts", machine.abort_count);
}

#[tokio::test]
async fn touch_after_a_turn_at_feed_is_no_unexpected_contact() {
    let directory = tempfile::tempdir().unwrap();
    let touch = "from 1 1 30.0 0.0 0.0\ntouch 1 1 1.000000 28.0 0.0 0.0 0.0 0.0 0.0\nEND\n";
    let mut runs = 0;
    let (mut driver, ..) = prepared_driver(&directory, Some((touch, 28.0)), move |_, line| {
        runs += u32::from(line == "set run");
        (line == "get PROBE_VALUE" && runs > 1).then_some("PROBE_VALUE 1\r\n")
    })
    .await;
    let turn = Motion::Feed { to: Position::new().with(Axis::C, 0.0), feed_mm_min: 60.0 };
    let motions = vec![turn, Motion::Probe { to: x_position(26.0), feed_mm_min: 30.0 }];
    let block = prove_block(&driver, &MotionBlock { step: 1, repeat: 0, motions });
    let outcome = driver.execute(block).await.unwrap();
    assert_eq!(outcome.trigger_position.unwrap().get_or_zero(Axis::X), 28.0);
}

#[tokio::test]
async fn a_joint_beyond_the_axes_must_be_homed_too() {
    let directory = tempfile::tempdir().unwrap();
    let (mut driver, ..) = open_driver(&directory, None, |_, line| {
        (line == "get JOINT_HOMED").then_some("JOINT_HOMED YES YES YES YES YES NO YES\r\n")
    })
    .await;
    driver.settings.ini_path = None;
    let error = driver.prepare().await.unwrap_err();
    assert!(error.to_string().contains("joint 5 is not homed"), "{error}");
}
