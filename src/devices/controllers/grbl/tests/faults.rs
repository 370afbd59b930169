//! Faults of the control or of the link, and the error that the driver returns for each.

use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use simulator::Speed;
use simulator::controls::grbl::{Fault, FaultKind};

/// Error of one touch, and everything that was sent for it, without `?`.
async fn touch_error_and_sent_text(
    answer: impl FnMut(&str) -> Option<String> + Send + 'static,
) -> (ControllerError, String) {
    block_error_and_sent_text(&touch_block(3), answer).await
}

/// As `touch_error_and_sent_text`, for `block` instead of a touch.
async fn block_error_and_sent_text(
    block: &MotionBlock,
    mut answer: impl FnMut(&str) -> Option<String> + Send + 'static,
) -> (ControllerError, String) {
    let prepared = Arc::new(AtomicBool::new(false));
    let copy = prepared.clone();
    let (link, tape) = spawn_peer_with_odd_replies(move |line| copy.load(Ordering::SeqCst).then(|| answer(line))?);
    let (mut driver, _) = driver_with_short_timeouts(link);
    driver.prepare().await.unwrap();
    prepared.store(true, Ordering::SeqCst);
    tape.lock().unwrap().clear();
    let error = driver.execute(prove_block(block)).await.unwrap_err();
    // Nothing more is sent, and a hold has had time to be sent.
    let again = driver.execute(prove_block(&touch_block(4))).await.unwrap_err();
    assert!(matches!(again, ControllerError::NotReady { .. }), "{again}");
    tokio::time::sleep(Duration::from_millis(30)).await;
    let sent = tape.lock().unwrap().replace('?', "");
    (error, sent)
}

/// Replies `reply` to the line `line_number`, which counts from 1 without `?` and `!`.
fn reply_at_line(line_number: usize, reply: &'static str) -> impl FnMut(&str) -> Option<String> + Send {
    let mut lines = 0;
    move |line| {
        lines += usize::from(!matches!(line, "?" | "!"));
        (lines == line_number && !matches!(line, "?" | "!")).then(|| reply.to_owned())
    }
}

#[tokio::test]
async fn surplus_reply_is_not_assigned_to_the_next_line() {
    for (nth, said) in [(1, ">ok\r\nok\r\n"), (3, ">{told}\r\nok\r\nok\r\n"), (2, ">ok\r\nerror:9\r\n")] {
        let (error, sent) = touch_error_and_sent_text(reply_at_line(nth, said)).await;
        assert!(matches!(error, ControllerError::UnexpectedReply { .. }), "{error}");
        assert!(sent.ends_with('!') && sent.lines().count() == nth + 1, "{sent}");
    }
    // The surplus answer comes during the touch: the result is missing.
    let (error, sent) = touch_error_with_extra_line("ok\r\n").await;
    assert!(matches!(error, ControllerError::UnreadableReply { .. }), "{error}");
    assert!(sent.ends_with('!'), "{sent}");
}

#[tokio::test]
async fn contradictory_touch_reports_give_no_reading() {
    let other = "[PRB:-18.384,18.385,-150.000,0.000,135.000:1]\r\nok\r\n";
    let (error, sent) = touch_error_and_sent_text(move |line| (line == "$#").then(|| other.to_owned())).await;
    assert!(matches!(error, ControllerError::TouchMismatch { step: 3, .. }), "{error}");
    assert!(sent.ends_with("$#\n"), "{sent}");
    let (error, _) = touch_error_with_extra_line("[PRB:-18.385,18.385,-150.000,0.000,135.000:1]\r\n").await;
    assert!(matches!(error, ControllerError::UnreadableReply { .. }), "told twice at once: {error}");
}

/// Error of one touch whose result comes after the surplus text `extra`, and everything that was sent for it.
async fn touch_error_with_extra_line(extra: &'static str) -> (ControllerError, String) {
    touch_error_and_sent_text(move |line| line.contains("F30.").then(|| format!(">{extra}{{told}}\r\nok\r\n"))).await
}

#[tokio::test]
async fn touch_off_the_path_gives_no_reading() {
    // Both reports agree, but the machine was never at that position.
    let told = "[PRB:-18.385,18.385,-149.000,0.000,135.000:1]\r\nok\r\n";
    let lie = move |line: &str| (line == "$#" || line.contains("F30.")).then(|| format!(">{told}"));
    let (error, _) = touch_error_and_sent_text(lie).await;
    assert!(matches!(&error, ControllerError::WrongPosition { actual, .. } if actual == "Z-149.000"), "{error}");
}

#[tokio::test]
async fn machine_at_a_wrong_end_position_gets_no_further_motion() {
    for nth in [1, 2, 3] {
        // The line is acknowledged but not executed, as if one of its bytes had been altered.
        let said = if nth == 3 { "[PRB:0.000,0.000,0.000,0.000,0.000:0]\r\nok\r\n" } else { "ok\r\n" };
        let (error, sent) = touch_error_and_sent_text(reply_at_line(nth, said)).await;
        assert!(matches!(error, ControllerError::WrongPosition { .. }), "{error}");
        assert!(error.to_string().contains("the machine is at"), "{error}");
        assert_eq!(sent.lines().count(), nth, "{sent}");
    }
}

#[tokio::test]
async fn hold_or_door_at_the_machine_ends_the_run() {
    for state in ["Hold:0", "Hold:1", "Door:1", "Tool"] {
        let (error, sent) = touch_error_and_sent_text(move |line| {
            (line == "?").then(|| status_report(&format!("{state}|MPos:{{at}}")))
        })
        .await;
        assert_eq!(error.to_string(), format!("held at the machine: the control reports {state}"));
        assert!(error.remedy().contains("reset the control"), "{}", error.remedy());
        assert_eq!(sent.lines().count(), 1, "{sent}");
    }
}

#[tokio::test]
async fn lost_alarm_message_and_hanging_motion_are_detected() {
    let (error, _) = touch_error_and_sent_text(|line| (line == "?").then(|| status_report("Alarm|MPos:{at}"))).await;
    assert_eq!(error.to_string(), "the control is not ready: Alarm");
    let (error, sent) = touch_error_and_sent_text(|line| (line == "?").then(|| status_report("Run|MPos:{at}"))).await;
    assert!(matches!(error, ControllerError::NoAnswer { seconds: 2.0, .. }), "{error}");
    assert!(sent.ends_with('!'), "{sent}");
}

#[tokio::test]
async fn one_lost_status_request_is_tolerated() {
    let mut asked = 0;
    let (link, _) = spawn_peer_with_odd_replies(move |line| {
        asked += usize::from(line == "?");
        (line == "?" && asked % 5 == 0).then(String::new)
    });
    let (mut driver, _) = driver_with_short_timeouts(link);
    driver.prepare().await.unwrap();
    driver.execute(prove_block(&touch_block(3))).await.unwrap();
}

#[tokio::test]
async fn wrong_modes_are_refused_before_motion() {
    let modes = |words: &str| format!("[GC:{words}]\r\nok\r\n");
    let offset = "[G59:0.000,0.100,0.000,0.000,0.000]\r\n[G92:0.000,0.000,0.000,0.000,0.000]\r\n\
        [HOME:0.000,0.000,0.000,0.000,0.000:31]\r\nok\r\n";
    for (asked, said, why) in [
        ("$G", modes("G0 G59 G17 G20 G90 G94"), "G21 is not active"),
        ("$G", modes("G0 G59 G17 G21 G91 G94"), "G90 is not active"),
        ("$G", modes("G0 G54 G17 G21 G90 G94"), "G59 is not active"),
        ("$G", "ok\r\n".to_owned(), "the control does not report its modes ($G)"),
        ("$#", offset.to_owned(), "the offset G59 is not zero"),
    ] {
        let (link, tape) = spawn_peer_with_odd_replies(move |line| (line == asked).then(|| said.clone()));
        let error = prepare_error(link).await;
        assert!(error.to_string().ends_with(why), "{error}");
        assert!(!tape.lock().unwrap().contains("G53"));
    }
}

/// Executes a touch on the simulated control, which has the fault `kind` at line `at_line` of the touch.
async fn touch_with_fault(
    kind: FaultKind,
    at_line: u64,
    code: Option<u8>,
) -> Result<MotionBlockOutcome, ControllerError> {
    let (ours, theirs) = tokio::io::duplex(4096);
    // Number of lines that `prepare` sends, as the control counts them.
    let (prepare, after_touch) = (13, 0);
    let fault = Fault { kind, at_line: prepare + at_line, after_touch, code };
    let options = SimulatedGrblOptions {
        faults: vec![fault],
        ..SimulatedGrblOptions::for_machine(&testing::five_axis_machine(), SimulationPace::Immediate)
    };
    let mut control = Firmware::new(testing::world_with_round_part(), options);
    tokio::spawn(async move { control.serve(theirs).await });
    let (mut driver, _) = driver_with_short_timeouts(LineLink::from_stream("in process", ours));
    driver.prepare().await.expect("the fault comes later");
    driver.execute(prove_block(&touch_block(0))).await
}

#[tokio::test]
async fn each_simulated_fault_gives_the_expected_error() {
    use ControllerError as E;
    use FaultKind as K;
    type ErrorPredicate = fn(&ControllerError) -> bool;
    let cases: [(K, u64, Option<u8>, ErrorPredicate); 24] = [
        (K::Silence, 3, None, |e| matches!(e, E::NoAnswer { .. })),
        (K::Restart, 3, None, |e| matches!(e, E::ControlReset { .. })),
        (K::BannerWithoutRestart, 3, None, |e| matches!(e, E::ControlReset { .. })),
        (K::LostLine, 3, None, |e| matches!(e, E::NoAnswer { .. })),
        (K::LostAnswer, 3, None, |e| matches!(e, E::NoAnswer { .. })),
        (K::DoubleOk, 3, None, |e| matches!(e, E::UnexpectedReply { .. })),
        (K::Alarm, 3, Some(1), |e| matches!(e, E::Alarm { code: 1, .. })),
        (K::Alarm, 3, Some(2), |e| matches!(e, E::Alarm { code: 2, .. })),
        (K::Alarm, 3, Some(3), |e| matches!(e, E::Alarm { code: 3, .. })),
        (K::Alarm, 3, Some(4), |e| matches!(e, E::ProbeStillClosed { .. })),
        (K::Alarm, 3, Some(5), |e| matches!(e, E::NoContact { .. })),
        (K::Alarm, 3, Some(6), |e| matches!(e, E::Alarm { code: 6, .. })),
        (K::Alarm, 3, Some(9), |e| matches!(e, E::Alarm { code: 9, .. })),
        (K::Error, 3, None, |e| e.to_string().contains("error:7")),
        (K::ProbeStuck, 1, None, |e| matches!(e, E::UnexpectedContact { .. })),
        (K::ProbeStuck, 3, None, |e| matches!(e, E::ProbeStillClosed { .. })),
        (K::RapidContact, 1, None, |e| matches!(e, E::UnexpectedContact { .. })),
        (K::ProbeStuck, 6, None, |e| matches!(e, E::ProbeStillClosed { .. })),
        (K::ProbeDead, 1, None, |e| matches!(e, E::NoContact { .. })),
        (K::ForeignBody, 3, None, |e| matches!(e, E::UnexpectedContact { .. })),
        (K::SoftLimit, 3, None, |e| matches!(e, E::Alarm { code: 2, .. })),
        (K::PersonHolds, 3, None, |e| matches!(e, E::HeldAtControl { .. })),
        (K::Door, 3, None, |e| e.to_string().ends_with("Door:1")),
        (K::EStop, 3, None, |e| e.to_string() == "alarm 10: emergency stop"),
    ];
    for (kind, at_line, code, is_expected) in cases {
        let error = touch_with_fault(kind, at_line, code).await.unwrap_err();
        assert!(is_expected(&error), "{kind:?} {code:?}: {error}");
        assert!(!error.remedy().is_empty());
    }
    // Noise between lines causes no error.
    touch_with_fault(K::Garbage, 3, None).await.unwrap();
}

#[tokio::test]
async fn a_contact_during_a_positioning_move_holds_the_machine() {
    let mut rapid = false;
    let brushed = move |line: &str| {
        rapid |= line.contains("G53 G0");
        (rapid && line == "?").then(|| status_report("Run|MPos:{at}|Pn:P"))
    };
    let (error, sent) = touch_error_and_sent_text(brushed).await;
    assert!(matches!(error, ControllerError::UnexpectedContact { step: 3 }), "{error}");
    assert!(sent.ends_with('!') && sent.lines().count() == 2, "{sent}");
}

/// Until a touch has verified the position, a turn is a feed motion (planning `turn_feeds.rs`).
#[tokio::test]
async fn a_contact_during_a_turn_at_feed_holds_the_machine() {
    let to = position(&[(Axis::C, 90.0)]);
    let turn = MotionBlock { step: 3, repeat: 0, motions: vec![Motion::Feed { to, feed_mm_min: 600.0 }] };
    let mut turns = false;
    let brushed = move |line: &str| {
        turns |= line.contains("C90");
        (turns && line == "?").then(|| status_report("Run|MPos:{at}|Pn:P"))
    };
    let (error, sent) = block_error_and_sent_text(&turn, brushed).await;
    assert!(matches!(error, ControllerError::UnexpectedContact { step: 3 }), "{error}");
    assert!(sent.ends_with('!') && sent.lines().count() == 2, "{sent}");
}

#[tokio::test]
async fn a_changed_feed_override_during_a_motion_holds_the_machine() {
    let mut rapid = false;
    let turned = move |line: &str| {
        rapid |= line.contains("G53 G0");
        (rapid && line == "?").then(|| status_report("Run|MPos:{at}|Bf:100,1023|FS:0,0|Ov:200,100,100"))
    };
    let (error, sent) = touch_error_and_sent_text(turned).await;
    assert!(error.to_string().contains("feed 200 %"), "{error}");
    assert!(sent.ends_with('!') && sent.lines().count() == 2, "{sent}");
}

#[tokio::test]
async fn contact_during_a_rapid_stops_it() {
    let (ours, theirs) = tokio::io::duplex(4096);
    let world = testing::world_with_round_part();
    let fault = Fault { kind: FaultKind::RapidContact, at_line: 14, after_touch: 0, code: None };
    let options = SimulatedGrblOptions {
        faults: vec![fault],
        ..SimulatedGrblOptions::for_machine(&testing::five_axis_machine(), SimulationPace::RealTime)
    };
    let mut control = Firmware::new(world.clone(), options);
    let happened = control.occurred_faults();
    tokio::spawn(async move { control.serve(theirs).await });
    let (mut driver, _) = driver_with_short_timeouts(LineLink::from_stream("in process", ours));
    driver.prepare().await.unwrap();
    // Without a hold the move takes more than one second.
    let motions = vec![Motion::Rapid { to: position(&[(Axis::X, 400.0)]) }];
    let error = driver.execute(prove_block(&MotionBlock { step: 0, repeat: 0, motions })).await.unwrap_err();
    assert!(matches!(error, ControllerError::UnexpectedContact { step: 0 }), "{error}");
    tokio::time::sleep(Duration::from_millis(1500)).await;
    let at = world.lock().unwrap().displayed_position().get_or_zero(Axis::X);
    assert!(at < 300.0, "{at}");
    assert_eq!(*happened.lock().unwrap(), [FaultKind::RapidContact]);
}

#[tokio::test]
async fn implausible_time_stamp_gives_no_reading() {
    let stamped = |line: &str| {
        let touches = line.contains("G38") || line == "$#";
        touches.then(|| ">{told}\r\n[TIME:1e300]\r\nok\r\n".to_owned())
    };
    let error = execute_touch(stamped).await.0.unwrap_err();
    assert!(error.to_string().contains("1e300 s"), "{error}");
}

#[tokio::test]
async fn machine_moved_between_two_blocks_gets_no_motion() {
    let (mut driver, _, world) = prepared_driver_in_world(SimulationPace::Immediate).await;
    driver.execute(prove_block(&touch_block(0))).await.unwrap();
    let by_hand = position(&[(Axis::Y, 0.05)]);
    world.lock().unwrap().travel(&by_hand, Speed::Rapid);
    let before = world.lock().unwrap().displayed_position();
    let error = driver.execute(prove_block(&touch_block(1))).await.unwrap_err();
    let told = "the machine was moved by hand: it is at Y0.050, not at Y0.000";
    assert_eq!(error.to_string(), format!("the control is not ready: {told}"));
    // The error may occur when there is no run to resume.
    assert!(!error.remedy().contains("resume"), "{}", error.remedy());
    assert_eq!(world.lock().unwrap().displayed_position(), before);
}

#[tokio::test]
async fn block_for_other_start_or_transmission_is_not_executed() {
    let (mut driver, _, world) = prepared_driver_in_world(SimulationPace::Immediate).await;
    let before = world.lock().unwrap().displayed_position();
    let axes: Vec<Axis> = testing::five_axis_machine().axes.keys().copied().collect();
    let dialect = load_dialect("grbl").unwrap();
    let lines = TransmissionForm::Lines { max_line_bytes: usize::MAX };
    let elsewhere = position(&[(Axis::Y, 7.0)]);
    let block = prove_block_text_from(elsewhere, &touch_block(0), &axes, &dialect, &lines).unwrap();
    let error = driver.execute(block).await.unwrap_err();
    assert!(error.to_string().contains("it is at Y0.000, not at Y7.000"), "{error}");
    driver.prepare().await.unwrap();
    let block = prove_block_text(&touch_block(0), &axes, &dialect, &TransmissionForm::TableRows).unwrap();
    let error = driver.execute(block).await.unwrap_err();
    assert!(matches!(error, ControllerError::WrongTransmission { step: 0 }), "{error}");
    assert_eq!(world.lock().unwrap().displayed_position(), before);
}

#[tokio::test]
async fn one_corrupted_position_report_is_tolerated() {
    let mut altered = false;
    let once = move |line: &str| {
        let now = line == "?" && !std::mem::replace(&mut altered, true);
        now.then(|| status_report("Idle|MPos:0.000,0.900,0.000,0.000,0.000"))
    };
    assert!(execute_touch(once).await.0.is_ok());
}
