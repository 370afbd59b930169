//! Tests of the driver against the simulated control, and against scripted peers.

mod faults;
mod readiness;
mod scripted_peer;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use scripted_peer::{IDLE_REPORT, spawn_peer_with_odd_replies, spawn_scripted_peer};

use super::{GrblDriver, GrblTimeouts};
use crate::controllers::{ControllerDriver, ControllerError, HaltHandle};
use link::{LineLink, LinkAddress, create_pty, open_line_link};
use machine::record::motion::{Motion, MotionBlock, MotionBlockOutcome};
use machine::{Axis, Position};
use planning::gcode::TransmissionForm;
use planning::proof::for_tests::{load_dialect, prove_block_text, prove_block_text_from};
use planning::proof::{ProvenBlock, render_and_prove_mode_text};
use simulator::controls::grbl::{Firmware, SimulatedGrblOptions, testing};
use simulator::interpreter::SimulationPace;
use simulator::{SimulatedWorld, Speed};

fn driver_with_short_timeouts(link: LineLink) -> (GrblDriver, HaltHandle) {
    let (machine, dialect) = (testing::five_axis_machine(), load_dialect("grbl").unwrap());
    let modes = render_and_prove_mode_text(&dialect, &machine.name, machine.axes.keys().copied(), None).unwrap();
    let (driver, halt) = GrblDriver::new(link, &machine, modes);
    let timeouts = GrblTimeouts {
        reply_timeout: Duration::from_millis(300),
        poll_interval: Duration::from_millis(20),
        follow_up_timeout: Duration::from_millis(100),
        stall_timeout: Duration::from_secs(2),
    };
    (driver.with_timeouts(timeouts), halt)
}

/// Proves the block for the transmission of this control; the clearance of bodies is not checked.
fn prove_block(block: &MotionBlock) -> ProvenBlock {
    let axes: Vec<Axis> = testing::five_axis_machine().axes.keys().copied().collect();
    let transmission = TransmissionForm::Lines { max_line_bytes: usize::MAX };
    prove_block_text(block, &axes, &load_dialect("grbl").unwrap(), &transmission).unwrap()
}

fn position(axes: &[(Axis, f64)]) -> Position {
    axes.iter().map(|(axis, mm_or_deg)| (*axis, axis.to_mm_or_rad(*mm_or_deg))).collect()
}

/// Approach, touch and retract at one of 8 angles around the part.
fn touch_block(step: u32) -> MotionBlock {
    let angle = f64::from(step % 8) * 45_f64.to_radians();
    let at = |r: f64| position(&[(Axis::X, r * angle.cos()), (Axis::Y, r * angle.sin())]);
    let motions = vec![
        Motion::Rapid { to: position(&[(Axis::Z, -20.0)]) },
        Motion::Rapid { to: at(60.0).with(Axis::C, angle) },
        Motion::Guarded { to: position(&[(Axis::Z, -150.0)]), feed_mm_min: 3000.0 },
        Motion::Guarded { to: at(30.0), feed_mm_min: 300.0 },
        Motion::Probe { to: at(26.0), feed_mm_min: 30.0 },
        Motion::BackOff { to: at(30.0), feed_mm_min: 300.0 },
        Motion::Guarded { to: at(60.0), feed_mm_min: 3000.0 },
    ];
    MotionBlock { step, repeat: 0, motions }
}

async fn run_touches(driver: &mut GrblDriver, steps: u32) -> Vec<MotionBlockOutcome> {
    let prepared = driver.prepare().await.unwrap();
    assert_eq!(prepared.identity, "Grbl 1.1f.20260817, axes XYZBC");
    let mut outcomes = Vec::new();
    for step in 0..steps {
        outcomes.push(driver.execute(prove_block(&touch_block(step))).await.unwrap());
    }
    driver.restore_modes().await.unwrap();
    outcomes
}

/// A prepared driver, its halt, and the simulated world in which its control moves.
async fn prepared_driver_in_world(pace: SimulationPace) -> (GrblDriver, HaltHandle, Arc<Mutex<SimulatedWorld>>) {
    let (ours, theirs) = tokio::io::duplex(4096);
    let world = testing::world_with_round_part();
    let mut control =
        Firmware::new(world.clone(), SimulatedGrblOptions::for_machine(&testing::five_axis_machine(), pace));
    tokio::spawn(async move { control.serve(theirs).await });
    let (mut driver, halt) = driver_with_short_timeouts(LineLink::from_stream("in process", ours));
    driver.prepare().await.unwrap();
    (driver, halt, world)
}

fn simulated_firmware() -> Firmware {
    Firmware::new(
        testing::world_with_round_part(),
        SimulatedGrblOptions::for_machine(&testing::five_axis_machine(), SimulationPace::Immediate),
    )
}

#[tokio::test]
async fn touches_agree_in_process_over_pty_and_over_tcp() {
    let (ours, theirs) = tokio::io::duplex(4096);
    let mut control = simulated_firmware();
    tokio::spawn(async move { control.serve(theirs).await });
    let (mut driver, _) = driver_with_short_timeouts(LineLink::from_stream("in process", ours));
    let in_process = run_touches(&mut driver, 70).await;
    for (step, outcome) in in_process.iter().enumerate() {
        let at = outcome.trigger_position.as_ref().unwrap();
        let radius = at.get_or_zero(Axis::X).hypot(at.get_or_zero(Axis::Y));
        assert!((radius - 28.0).abs() < 1.5e-3, "step {step}: {radius}");
        assert!((at.get_or_zero(Axis::C).to_degrees() - 45.0 * (step % 8) as f64).abs() < 1e-3);
    }
    assert!(in_process.is_sorted_by(|a, b| a.trigger_time_s.unwrap() < b.trigger_time_s.unwrap()));

    let mut pty = create_pty().unwrap();
    let mut control = simulated_firmware();
    tokio::spawn(async move { control.serve(&mut pty.device).await });
    let (mut driver, _) = driver_with_short_timeouts(
        open_line_link(&LinkAddress::Serial { path: pty.path, baud: 115_200 }).await.unwrap(),
    );
    assert_eq!(run_touches(&mut driver, 70).await, in_process);

    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    tokio::spawn(async move {
        let (stream, _) = listener.accept().await.unwrap();
        simulated_firmware().serve(stream).await
    });
    let address = LinkAddress::Tcp { host: "127.0.0.1".to_owned(), port };
    let (mut driver, _) = driver_with_short_timeouts(open_line_link(&address).await.unwrap());
    assert_eq!(run_touches(&mut driver, 70).await, in_process);
}

fn status_report(text: &str) -> String {
    format!("<{text}>\r\n")
}

async fn prepare_error(link: LineLink) -> ControllerError {
    driver_with_short_timeouts(link).0.prepare().await.unwrap_err()
}

#[tokio::test]
async fn unsuitable_control_is_refused_before_motion() {
    for (said, expected, remedy) in [
        ("Alarm|MPos:0.000", "the control is not ready: Alarm", "$X"),
        ("Hold:0|MPos:0.000", "the control is not ready: Hold:0", "reset the control"),
        ("Door:0|MPos:0.000", "the control is not ready: Door:0", "reset the control"),
        ("Tool|MPos:0.000", "the control is not ready: Tool", "reset the control"),
        ("Idle|MPos:0.000|Pn:P|Ov:100,100,100", "the control is not ready: the probe reads closed", "stylus"),
    ] {
        let (link, tape) = spawn_peer_with_odd_replies(move |line| (line == "?").then(|| status_report(said)));
        let error = prepare_error(link).await;
        assert_eq!(error.to_string(), expected);
        assert!(error.remedy().contains(remedy), "{}", error.remedy());
        assert!(!error.remedy().contains("resume"), "{}", error.remedy());
        let tape = tape.lock().unwrap().clone();
        assert!(!tape.contains('G') && !tape.contains("$X") && !tape.contains('\x18'), "{tape}");
    }
    let classic = "[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n";
    let (link, _) = spawn_peer_with_odd_replies(move |line| (line == "$I").then(|| classic.to_owned()));
    let error = prepare_error(link).await;
    assert!(matches!(&error, ControllerError::UnsupportedByControl { reason, .. }
        if reason == "the control has the axes XYZ, but not B, C"));
    assert!(error.remedy().contains("grblHAL"));
}

#[tokio::test]
async fn silence_noise_and_foreign_devices_are_distinguished() {
    let (link, _) = spawn_scripted_peer(|_| None);
    let error = prepare_error(link).await;
    assert!(matches!(error, ControllerError::NoAnswer { .. }), "{error}");
    let (link, _) = spawn_scripted_peer(|_| Some("\u{f8}\u{80}\u{1f}\u{0}x".to_owned()));
    let error = prepare_error(link).await;
    assert!(error.to_string().contains("unreadable bytes"), "{error}");
    assert!(error.remedy().contains("baud"));
    let (link, _) = spawn_scripted_peer(|_| Some("start\r\necho:Unknown command\r\n".to_owned()));
    let error = prepare_error(link).await;
    assert!(error.to_string().contains("`start`"), "{error}");
    let (link, _) = spawn_scripted_peer(|_| Some("HANG UP".to_owned()));
    assert!(matches!(prepare_error(link).await, ControllerError::Link(_)));
}

/// Result of one touch, and the lines sent for it. `odd_answer` replaces replies of the peer after the preparation.
async fn execute_touch(
    mut odd_answer: impl FnMut(&str) -> Option<String> + Send + 'static,
) -> (Result<MotionBlockOutcome, ControllerError>, String) {
    let prepared = Arc::new(Mutex::new(false));
    let copy = prepared.clone();
    let (link, tape) =
        spawn_peer_with_odd_replies(move |line| if *copy.lock().unwrap() { odd_answer(line) } else { None });
    let (mut driver, _) = driver_with_short_timeouts(link);
    driver.prepare().await.unwrap();
    *prepared.lock().unwrap() = true;
    tape.lock().unwrap().clear();
    let outcome = driver.execute(prove_block(&touch_block(3))).await;
    let tape = tape.lock().unwrap().replace(['?', '!'], "");
    (outcome, tape)
}

#[tokio::test]
async fn touch_with_replies_of_a_real_control_gives_its_position() {
    let (outcome, tape) = execute_touch(|_| None).await;
    let outcome = outcome.unwrap();
    let at = outcome.trigger_position.unwrap();
    // Position at the end of the touch, at 26 mm and 135 degrees, three decimals.
    assert_eq!([at.get_or_zero(Axis::X), at.get_or_zero(Axis::Y), at.get_or_zero(Axis::Z)], [-18.385, 18.385, -150.0]);
    assert_eq!(at.iter().map(|(axis, _)| axis.letter()).collect::<String>(), "XYZBC");
    assert_eq!(outcome.trigger_time_s, None);
    assert_eq!(tape.lines().count(), 8, "seven motions, and the touch told again: {tape}");
}

fn reply_to_probing_move(said: &'static str) -> impl FnMut(&str) -> Option<String> + Send {
    move |line| line.contains("F30.").then(|| said.to_owned())
}

fn reply_to_guarded_move(said: &'static str) -> impl FnMut(&str) -> Option<String> + Send {
    move |line| line.contains("F3000.").then(|| said.to_owned())
}

#[tokio::test]
async fn each_touch_failure_gives_the_expected_error() {
    let miss = "[PRB:0.000,0.000,1.000,0.000,0.000:0]\r\nok\r\n";
    let (outcome, _) = execute_touch(reply_to_probing_move(miss)).await;
    assert!(matches!(outcome, Err(ControllerError::NoContact { step: 3 })));
    let alarmed = "ALARM:5\r\n[PRB:0.000,0.000,1.000,0.000,0.000:0]\r\nok\r\n";
    let (outcome, _) = execute_touch(reply_to_probing_move(alarmed)).await;
    assert!(matches!(outcome, Err(ControllerError::NoContact { step: 3 })));
    let (outcome, _) = execute_touch(reply_to_probing_move("ALARM:4\r\nok\r\n")).await;
    assert!(matches!(outcome, Err(ControllerError::ProbeStillClosed { step: 3 })));
    let (outcome, _) = execute_touch(reply_to_probing_move("ok\r\n")).await;
    assert!(matches!(outcome, Err(ControllerError::UnreadableReply { .. })));
    let (outcome, _) = execute_touch(reply_to_probing_move("[PRB:1.000,0.000:1]\r\nok\r\n")).await;
    assert!(matches!(outcome, Err(ControllerError::UnreadableReply { .. })));
    let hit = "[PRB:0.000,0.000,1.000,0.000,0.000:1]\r\nok\r\n";
    let (outcome, tape) = execute_touch(reply_to_guarded_move(hit)).await;
    assert!(matches!(outcome, Err(ControllerError::UnexpectedContact { step: 3 })));
    assert_eq!(tape.lines().count(), 3, "nothing follows: {tape}");
    let closed = |line: &str| (line == "?").then(|| status_report("Idle|MPos:{at}|Pn:PZ"));
    let (outcome, tape) = execute_touch(closed).await;
    assert!(matches!(outcome, Err(ControllerError::ProbeStillClosed { step: 3 })));
    assert!(!tape.contains("F30."), "{tape}");
    let mut probed = false;
    let stuck = move |line: &str| {
        probed |= line.contains("F30.");
        (probed && line == "?").then(|| status_report("Idle|MPos:{at}|Pn:P"))
    };
    let (outcome, tape) = execute_touch(stuck).await;
    assert!(matches!(outcome, Err(ControllerError::ProbeStillClosed { step: 3 })));
    assert_eq!(tape.lines().count(), 7, "nothing follows the back-off: {tape}");
}

#[tokio::test]
async fn only_a_back_off_is_executed_in_contact() {
    let (mut driver, _halt, world) = prepared_driver_in_world(SimulationPace::Immediate).await;
    // The target is 1.5 mm inside the part: contact is at 28 mm.
    let at = |x: f64| position(&[(Axis::X, x)]);
    let one = |motion: Motion| prove_block(&MotionBlock { step: 3, repeat: 0, motions: vec![motion] });
    let out = |x: f64| one(Motion::BackOff { to: at(x), feed_mm_min: 60.0 });
    let guarded = || one(Motion::Guarded { to: at(40.0), feed_mm_min: 60.0 });
    let pressed = position(&[(Axis::X, 26.5), (Axis::Z, -150.0)]);
    world.lock().unwrap().travel(&pressed, Speed::Rapid);
    assert!(matches!(driver.prepare().await, Err(ControllerError::ProbeClosed)));
    let refused = driver.execute(out(27.5)).await;
    assert!(matches!(refused, Err(ControllerError::NotReady { .. })), "{refused:?}");

    driver.prepare_in_contact().await.unwrap();
    let refused = driver.execute(guarded()).await;
    assert!(matches!(refused, Err(ControllerError::ProbeStillClosed { step: 3 })), "{refused:?}");
    assert!((world.lock().unwrap().displayed_position().get_or_zero(Axis::X) - 26.5).abs() < 1e-9);
    driver.prepare_in_contact().await.unwrap();
    let closed = driver.execute(out(27.5)).await;
    assert!(matches!(closed, Err(ControllerError::ProbeStillClosed { step: 3 })), "{closed:?}");
    assert!((world.lock().unwrap().displayed_position().get_or_zero(Axis::X) - 27.5).abs() < 1e-9);
    driver.prepare_in_contact().await.unwrap();
    driver.execute(out(28.5)).await.unwrap();
    driver.execute(guarded()).await.unwrap();
}

#[tokio::test]
async fn alarms_errors_and_resets_are_reported_with_their_meaning() {
    let (outcome, tape) = execute_touch(reply_to_guarded_move("error:20\r\n")).await;
    let error = outcome.unwrap_err();
    assert!(error.to_string().contains("`error:20`"), "{error}");
    assert!(error.to_string().contains("does not know a word"), "{error}");
    assert_eq!(tape.lines().count(), 3);
    for (code, meaning) in [(1, "hard limit"), (2, "soft limits"), (9, "homing"), (99, "manual")] {
        let alarm = format!("ALARM:{code}\r\n");
        let (outcome, _) = execute_touch(move |line| line.contains("G0").then(|| alarm.clone())).await;
        let error = outcome.unwrap_err();
        assert!(error.to_string().starts_with(&format!("alarm {code}: ")), "{error}");
        assert!(error.to_string().contains(meaning), "{error}");
        let names_limits = error.remedy().contains("min and max") && error.remedy().contains("Ctrl-X");
        assert_eq!(names_limits, code == 2, "{}", error.remedy());
    }
    let reset = "ALARM:3\r\n\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n";
    let banner = "\r\nGrbl 1.1f ['$' for help]\r\n";
    for said in [reset, banner] {
        let (outcome, tape) = execute_touch(reply_to_probing_move(said)).await;
        assert!(matches!(outcome, Err(ControllerError::ControlReset { .. })));
        assert_eq!(tape.lines().count(), 5);
    }
}

#[tokio::test]
async fn lost_reply_dead_control_and_lost_link_end_the_job() {
    // A byte of the line was lost: the control idles and never answers the line.
    let (outcome, _) = execute_touch(reply_to_probing_move("")).await;
    assert!(matches!(outcome, Err(ControllerError::NoAnswer { .. })));
    let mut dead = false;
    let dying = move |line: &str| {
        dead |= line.contains("F30.");
        dead.then(String::new)
    };
    assert!(matches!(execute_touch(dying).await.0, Err(ControllerError::NoAnswer { .. })));
    let (outcome, _) = execute_touch(reply_to_probing_move("HANG UP")).await;
    assert!(matches!(outcome, Err(ControllerError::Link(_))));
}

#[tokio::test]
async fn slow_move_is_awaited_while_the_control_reports_run() {
    let mut polls = 0;
    let running = move |line: &str| match line {
        "?" if polls > 0 && polls < 30 => {
            polls += 1;
            Some(status_report("Run|MPos:0.000,0.000,0.000,0.000,0.000|FS:30,0"))
        }
        probing if probing.contains("F30.") => {
            polls = 1;
            Some(">".to_owned())
        }
        "?" if polls == 30 => {
            polls += 1;
            Some(format!("{IDLE_REPORT}{{told}}\r\nok\r\n"))
        }
        _ => None,
    };
    assert_eq!(execute_touch(running).await.0.unwrap().trigger_position.unwrap().get_or_zero(Axis::X), -18.385);
}

#[tokio::test]
async fn dwell_is_awaited_although_the_control_reports_idle() {
    let begun = Arc::new(Mutex::new(None));
    let (link, _) = spawn_peer_with_odd_replies(move |line| {
        let mut begun = begun.lock().unwrap();
        if line.contains("G4 ") {
            *begun = Some(std::time::Instant::now());
            return Some(String::new());
        }
        let over = begun.is_some_and(|since| since.elapsed() > Duration::from_millis(450));
        (line == "?" && over).then(|| {
            *begun = None;
            format!("{IDLE_REPORT}ok\r\n")
        })
    });
    let (mut driver, _) = driver_with_short_timeouts(link);
    driver.prepare().await.unwrap();
    let motions = vec![Motion::Dwell { seconds: 0.45 }];
    driver.execute(prove_block(&MotionBlock { step: 0, repeat: 0, motions })).await.unwrap();
}

#[tokio::test]
async fn halt_during_a_touch_sends_the_hold_and_no_further_line() {
    let halt: Arc<Mutex<Option<HaltHandle>>> = Arc::default();
    let asked = halt.clone();
    let mut held = false;
    let (link, tape) = spawn_peer_with_odd_replies(move |line| match line {
        "!" => {
            held = true;
            Some(String::new())
        }
        "?" if held => Some(status_report("Hold:0|MPos:0.000,0.000,0.000,0.000,0.000")),
        probing if probing.contains("F30.") => {
            asked.lock().unwrap().as_ref().unwrap().trigger();
            Some(String::new())
        }
        _ => None,
    });
    let (mut driver, handle) = driver_with_short_timeouts(link);
    *halt.lock().unwrap() = Some(handle);
    driver.prepare().await.unwrap();
    for _ in 0..2 {
        let outcome = driver.execute(prove_block(&touch_block(0))).await;
        assert!(matches!(outcome, Err(ControllerError::Halted)), "{outcome:?}");
    }
    assert!(matches!(driver.restore_modes().await, Err(ControllerError::Halted)));
    let tape = tape.lock().unwrap().clone();
    let after = tape.split_once('!').unwrap().1;
    assert!(after.chars().all(|byte| matches!(byte, '?' | '!')), "{after}");
}

/// Error after a halt at a control that loses `lost_hold_count` holds and moves meanwhile, and the text sent.
async fn halt_with_lost_holds(lost_hold_count: usize) -> (ControllerError, String) {
    let halt: Arc<Mutex<Option<HaltHandle>>> = Arc::default();
    let asked = halt.clone();
    let (mut moves, mut holds) = (false, 0);
    let (link, tape) = spawn_peer_with_odd_replies(move |line| match line {
        "!" => {
            holds += 1;
            Some(String::new())
        }
        "?" if holds > lost_hold_count => Some(status_report("Hold:0|MPos:0.000,0.000,0.000,0.000,0.000")),
        "?" if moves => Some(status_report("Run|MPos:0.000,0.000,0.000,0.000,0.000")),
        probing if probing.contains("F30.") => {
            moves = true;
            asked.lock().unwrap().as_ref().unwrap().trigger();
            Some(String::new())
        }
        _ => None,
    });
    let (mut driver, handle) = driver_with_short_timeouts(link);
    *halt.lock().unwrap() = Some(handle);
    driver.prepare().await.unwrap();
    let error = driver.execute(prove_block(&touch_block(0))).await.unwrap_err();
    let tape = tape.lock().unwrap().clone();
    (error, tape)
}

#[tokio::test]
async fn lost_hold_is_repeated_until_the_machine_is_at_rest() {
    let (error, tape) = halt_with_lost_holds(2).await;
    assert!(matches!(error, ControllerError::Halted), "{error}");
    let after = tape.split_once('!').unwrap().1;
    assert!(after.chars().all(|byte| matches!(byte, '?' | '!')), "{after}");

    let (error, _) = halt_with_lost_holds(usize::MAX).await;
    assert!(matches!(error, ControllerError::HoldFailed { .. }), "{error}");
    assert!(error.remedy().contains("emergency stop"), "{}", error.remedy());
}

#[tokio::test]
async fn halt_stops_a_slow_move_of_the_simulated_machine() {
    let (mut driver, halt, world) = prepared_driver_in_world(SimulationPace::RealTime).await;
    let before = world.lock().unwrap().displayed_position();
    // 90 mm at 10 mm/min: nine minutes without a hold.
    let to = position(&[(Axis::Z, -90.0)]);
    let block = MotionBlock { step: 0, repeat: 0, motions: vec![Motion::Guarded { to, feed_mm_min: 10.0 }] };
    let running = tokio::spawn(async move { (driver.execute(prove_block(&block)).await, driver) });
    tokio::time::sleep(Duration::from_millis(50)).await;
    halt.trigger();
    let (outcome, _driver) = running.await.unwrap();
    assert!(matches!(outcome, Err(ControllerError::Halted)), "{outcome:?}");
    let after = world.lock().unwrap().displayed_position();
    assert!((before.get_or_zero(Axis::Z) - after.get_or_zero(Axis::Z)).abs() < 1.0);
}

#[tokio::test]
async fn late_reply_of_the_first_blank_line_is_not_assigned_to_the_next() {
    let (mut asked, mut owed) = (0, true);
    let (link, _) = spawn_peer_with_odd_replies(move |line| {
        asked += usize::from(line == "?");
        match line {
            "" => Some(String::new()),
            "?" if asked == 2 => {
                owed = false;
                Some(format!("{IDLE_REPORT}ok\r\n"))
            }
            "$I" if std::mem::take(&mut owed) => Some("ok\r\n".to_owned()),
            _ => None,
        }
    });
    let prepared = driver_with_short_timeouts(link).0.prepare().await.unwrap();
    assert_eq!(prepared.identity, "Grbl 1.1f.20260817, axes XYZBC");
    // The answer to the blank line never comes: the next line is sent nevertheless.
    let (link, _) = spawn_peer_with_odd_replies(|line| line.is_empty().then(String::new));
    driver_with_short_timeouts(link).0.prepare().await.unwrap();
}
