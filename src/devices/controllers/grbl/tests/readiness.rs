//! States before the first motion for which a control is refused. Texts of a real grblHAL (Linux build of
//! August 2026).

use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::scripted_peer::{FULL_REPORT, SentText};
use super::*;
use crate::controllers::grbl::message::GrblMessage;

/// Driver of a simulated control with the options `made`, and the text that the driver has sent.
fn driver_with_sent_text(made: SimulatedGrblOptions) -> (GrblDriver, SentText) {
    let mut control = Firmware::new(testing::world_with_round_part(), made);
    let (ours, middle) = tokio::io::duplex(4096);
    let (onward, theirs) = tokio::io::duplex(4096);
    tokio::spawn(async move { control.serve(theirs).await });
    let tape = SentText::default();
    let copy = tape.clone();
    let (mut from_us, mut to_us) = tokio::io::split(middle);
    let (mut from_it, mut to_it) = tokio::io::split(onward);
    tokio::spawn(async move { tokio::io::copy(&mut from_it, &mut to_us).await });
    tokio::spawn(async move {
        while let Ok(byte) = from_us.read_u8().await {
            copy.lock().unwrap().push(byte as char);
            if to_it.write_u8(byte).await.is_err() {
                break;
            }
        }
    });
    (driver_with_short_timeouts(LineLink::from_stream("in process", ours)).0, tape)
}

/// Lines that command a motion: G0, G1, G38, G28, G30, homing and jogs.
fn sent_motion_lines(sent: &str) -> Vec<&str> {
    let moves = |line: &&str| {
        let mut words = line.split_whitespace();
        words.any(|word| matches!(word, "G0" | "G1" | "G28" | "G30") || word.starts_with("G38"))
            || line.starts_with("$H")
            || line.starts_with("$J")
    };
    sent.lines().filter(|line| !line.starts_with('(')).filter(moves).collect()
}

/// Settings with which a control is refused: number, value, text of the error, text of its remedy.
const UNREADY_SETTINGS: [(u16, f64, &str, &str); 7] = [
    (13, 1.0, "in inches ($13=1)", "$13=0"),
    (20, 0.0, "soft limits are off", "$20=1"),
    (131, 0.0, "do not limit Y", "$131"),
    (22, 0.0, "homing is off", "$22=1"),
    (10, 510.0, "do not contain the machine position", "$10=511"),
    (10, 447.0, "the overrides ($10=447)", "$10=511"),
    (10, 495.0, "do not contain the probe", "$10=511"),
];

fn ready_grbl_options() -> SimulatedGrblOptions {
    SimulatedGrblOptions::for_machine(&testing::five_axis_machine(), SimulationPace::Immediate)
}

#[tokio::test]
async fn a_control_that_is_not_ready_is_sent_no_motion() {
    for (number, value, state, remedy) in UNREADY_SETTINGS {
        let mut made = ready_grbl_options();
        made.settings_by_number.insert(number, value);
        assert_refused(made, state, remedy).await;
    }
    assert_refused(
        SimulatedGrblOptions { is_homed: false, ..ready_grbl_options() },
        "X, Y, Z, B, C are not homed",
        "$H",
    )
    .await;
    for (overrides, state) in [([200, 100], "feed 200 %"), ([100, 25], "rapid 25 %")] {
        assert_refused(
            SimulatedGrblOptions { feed_and_rapid_override_percent: overrides, ..ready_grbl_options() },
            state,
            "100 %",
        )
        .await;
    }
    assert_refused(
        SimulatedGrblOptions { is_pendant_in_control: true, ..ready_grbl_options() },
        "a pendant",
        "pendant off",
    )
    .await;
    assert_refused(
        SimulatedGrblOptions { reported_tool_length_mm: 50.0, ..ready_grbl_options() },
        "tool length",
        "G49",
    )
    .await;
    let silent = SimulatedGrblOptions { settings_by_number: [].into(), ..ready_grbl_options() };
    assert_refused(silent, "does not report its settings", "grblHAL").await;

    let (mut driver, tape) = driver_with_sent_text(ready_grbl_options());
    driver.prepare().await.unwrap();
    driver.execute(prove_block(&touch_block(0))).await.unwrap();
    assert!(!sent_motion_lines(&tape.lock().unwrap()).is_empty());
}

async fn assert_refused(made: SimulatedGrblOptions, state: &str, remedy: &str) {
    let (mut driver, tape) = driver_with_sent_text(made);
    let error = driver.prepare().await.unwrap_err();
    assert!(error.to_string().contains(state), "{error}");
    assert!(error.remedy().contains(remedy), "{}", error.remedy());
    let refused = driver.execute(prove_block(&touch_block(0))).await.unwrap_err();
    assert!(matches!(refused, ControllerError::NotReady { .. }), "{refused}");
    let sent = tape.lock().unwrap().clone();
    assert_eq!(sent_motion_lines(&sent), Vec::<&str>::new(), "{state}");
}

/// B and C have no switch, and `homing = "none"` declares it.
#[tokio::test]
async fn axis_without_homing_switch_must_be_declared() {
    let mut made = ready_grbl_options();
    made.settings_by_number.extend([(22, 1.0), (44, 7.0)]);
    assert_refused(made.clone(), "does not home B, C", "homing = \"none\"").await;
    let (mut driver, _) = driver_with_sent_text(made);
    driver.required_homed_axes.retain(|axis| axis.is_linear());
    driver.prepare().await.unwrap();
}

/// `check` lists all that `prepare` refuses.
#[tokio::test]
async fn device_info_lists_all_findings_that_block_prepare() {
    let mut made =
        SimulatedGrblOptions { is_homed: false, feed_and_rapid_override_percent: [110, 50], ..ready_grbl_options() };
    made.settings_by_number.extend([(13, 1.0), (20, 0.0)]);
    let said = driver_with_sent_text(made).0.identify_device().await.unwrap();
    let blocking: Vec<String> = said.findings.iter().filter(|r| r.is_blocking).map(|r| r.description.clone()).collect();
    assert_eq!(blocking.len(), 4, "{blocking:?}");
}

/// Modal words as a real grblHAL reports them.
#[tokio::test]
async fn a_turning_spindle_and_scaled_axes_are_refused() {
    for (words, state) in [("M3", "spindle"), ("M4", "spindle"), ("G51:XY", "scaled")] {
        let (link, tape) = spawn_peer_with_odd_replies(move |line| {
            let modes = format!("[GC:G0 G59 G17 G21 G90 G94 G49 G98 {words} M9 T0 F0 S0.]\r\nok\r\n");
            (line == "$G").then_some(modes)
        });
        let (mut driver, _) = driver_with_short_timeouts(link);
        let error = driver.prepare().await.unwrap_err();
        assert!(error.to_string().contains(state), "{error}");
        assert_eq!(sent_motion_lines(&tape.lock().unwrap()), Vec::<&str>::new());
    }
}

#[tokio::test]
async fn a_changed_feed_override_during_a_touch_gives_no_reading() {
    let mut touched = false;
    let (link, tape) = spawn_peer_with_odd_replies(move |line| {
        // 30 mm/min is the feed of the touch, not of the guarded approach.
        touched |= line.contains("G38") && line.contains("F30.");
        (touched && line == "?").then(|| status_report("Idle|MPos:{at}|Bf:100,1023|FS:0,0|Ov:200,100,100"))
    });
    let (mut driver, _) = driver_with_short_timeouts(link);
    driver.prepare().await.unwrap();
    let error = driver.execute(prove_block(&touch_block(3))).await.unwrap_err();
    assert!(error.to_string().contains("feed 200 %"), "{error}");
    tokio::time::sleep(Duration::from_millis(30)).await;
    let tape = tape.lock().unwrap().clone();
    let (_, after) = tape.rsplit_once('\n').unwrap();
    assert!(tape.lines().rev().nth(1).unwrap().contains("F30."), "{tape}");
    assert!(after.contains('!') && after.chars().all(|sent| matches!(sent, '?' | '!')), "{after}");
}

/// The head must not be sent first: it writes an offset and switches outputs.
#[tokio::test]
async fn unready_control_is_refused_before_the_head_lines_are_sent() {
    let head_sent = |driver: &GrblDriver, tape: &SentText| {
        let tape = tape.lock().unwrap();
        let head = driver.mode_text.head_lines().iter().filter(|line| !line.starts_with('('));
        head.filter(|line| tape.lines().any(|sent| sent.ends_with(line.as_str()))).count()
    };
    let (mut driver, tape) = driver_with_sent_text(SimulatedGrblOptions { is_homed: false, ..ready_grbl_options() });
    let error = driver.prepare().await.unwrap_err();
    assert!(error.to_string().contains("not homed"), "{error}");
    assert_eq!(head_sent(&driver, &tape), 0);
    for words in ["M3 G50", "M5 G51:XY"] {
        let (link, tape) = spawn_peer_with_odd_replies(move |line| {
            let modes = format!("[GC:G0 G54 G17 G21 G90 G94 G49 G98 {words} M9 T0 F0 S0.]\r\nok\r\n");
            (line == "$G").then_some(modes)
        });
        let (mut driver, _) = driver_with_short_timeouts(link);
        driver.prepare().await.unwrap_err();
        assert_eq!(head_sent(&driver, &tape), 0, "{words}");
    }
    let (mut driver, tape) = driver_with_sent_text(ready_grbl_options());
    driver.prepare().await.unwrap();
    assert!(head_sent(&driver, &tape) > 0);
}

/// Reported properties of a control with axes of 400 mm travel and these settings.
async fn device_info_with_settings(settings: &[(u16, f64)]) -> crate::controllers::DeviceInfo {
    let all = [(10, 511.0), (13, 0.0), (20, 1.0), (27, 2.0), (133, 0.0), (134, 0.0)];
    let travels = [(130, 400.0), (131, 400.0), (132, 400.0)];
    let settings = all.iter().chain(&travels).chain(settings).copied().collect();
    driver_with_sent_text(SimulatedGrblOptions { settings_by_number: settings, ..ready_grbl_options() })
        .0
        .identify_device()
        .await
        .unwrap()
}

#[tokio::test]
async fn travel_of_a_homed_control_follows_its_homing_settings() {
    // Homing by hand; by hand axis by axis; by cycles that the control does not list; with a zero at the
    // switch. By hand, the zero of a rotary axis is its position at that time: the owner decides whether it
    // is confirmed.
    for (settings, has_homing) in [
        (&[(21, 0.0), (22, 33.0), (23, 0.0), (44, 0.0)][..], None),
        (&[(21, 1.0), (22, 35.0), (23, 1.0), (44, 0.0)], None),
        (&[(21, 0.0), (22, 1.0), (23, 0.0)], Some(true)),
    ] {
        let said = device_info_with_settings(settings).await;
        let x = said.axes[&Axis::X];
        assert_eq!((x.travel_min, format!("{:?}", x.travel_max)), (Some(-400.0), "Some(0.0)".to_owned()));
        assert_eq!(said.axes[&Axis::B].has_homing, has_homing, "{settings:?}");
    }
    let said = device_info_with_settings(&[(21, 0.0), (22, 41.0), (23, 1.0), (44, 0.0)]).await;
    assert_eq!((said.axes[&Axis::X].travel_min, said.axes[&Axis::X].travel_max), (Some(0.0), Some(400.0)));
    assert_eq!(said.axes[&Axis::Y].travel_min, Some(-400.0));
    let off = device_info_with_settings(&[(21, 0.0), (22, 0.0), (44, 7.0)]).await;
    assert_eq!((off.axes[&Axis::X].travel_min, off.axes[&Axis::B].has_homing), (None, None));
}

#[tokio::test]
async fn moving_control_is_refused_with_the_advice_to_wait() {
    let (link, _) = spawn_peer_with_odd_replies(|line| match line {
        "?" => Some(status_report("Run|MPos:{at}|FS:500,0")),
        "$I" => Some("error:8\r\n".to_owned()),
        _ => None,
    });
    let error = driver_with_short_timeouts(link).0.identify_device().await.unwrap_err();
    assert!(error.remedy().contains("wait until the machine is at rest"), "{}", error.remedy());
}

/// The answer to an earlier `?` arrives after 0x87 was sent, as on a busy computer.
#[tokio::test]
async fn a_late_report_is_not_taken_for_the_full_one() {
    let (link, _) = spawn_peer_with_odd_replies(|line| {
        let late = "<Idle|MPos:{at}|Bf:100,1023|FS:0,0>\r\n";
        match line {
            "?" => Some(late.to_owned()),
            "0x87" => Some(format!("{late}{FULL_REPORT}")),
            _ => None,
        }
    });
    driver_with_short_timeouts(link).0.prepare().await.unwrap();
}

/// grblHAL at compatibility level 2 leaves out the field that marks a full report.
#[tokio::test]
async fn full_report_without_the_fw_field_is_accepted() {
    let (link, _) =
        spawn_peer_with_odd_replies(|line| (line == "0x87").then(|| FULL_REPORT.replace("|FW:grblHAL", "")));
    driver_with_short_timeouts(link).0.prepare().await.unwrap();
}

/// After a reset the axes are not homed, and all modes are lost.
#[tokio::test]
async fn a_control_that_was_reset_is_not_ready_until_it_is_homed() {
    let (mut driver, _) = driver_with_sent_text(ready_grbl_options());
    driver.prepare().await.unwrap();
    driver.connection.send_line("\x18").await.unwrap_err();
    let error = driver.prepare().await.unwrap_err();
    assert!(error.to_string().contains("not homed"), "{error}");
    driver.connection.send_line("$H").await.unwrap();
    driver.prepare().await.unwrap();
}

/// An operator enters modal words at the control between two preparations.
#[tokio::test]
async fn modes_changed_by_hand_are_set_again_and_the_first_ones_restored() {
    let (mut driver, _) = driver_with_sent_text(ready_grbl_options());
    driver.connection.synchronize_and_read_status().await.unwrap();
    driver.connection.send_line("G55 G90").await.unwrap();
    driver.prepare().await.unwrap();
    driver.connection.send_line("G54 G91 G20").await.unwrap();
    driver.prepare().await.unwrap();
    let modes = |said: Vec<GrblMessage>| format!("{said:?}");
    let set = modes(driver.connection.send_line("$G").await.unwrap());
    assert!(["G59", "G21", "G90"].iter().all(|word| set.contains(word)), "{set}");
    driver.execute(prove_block(&touch_block(0))).await.unwrap();
    driver.restore_modes().await.unwrap();
    let left = modes(driver.connection.send_line("$G").await.unwrap());
    assert!(left.contains("G55") && left.contains("G90"), "{left}");
}
