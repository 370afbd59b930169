//! What a control may report before its first motion, and is refused for. Texts of a real grblHAL (Linux
//! build of August 2026).

use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::bench::Tape;
use super::*;
use crate::controllers::grbl::message::Message;

/// A link to `control`, and the text that was sent over it.
fn taped(mut control: Firmware) -> (Link, Tape) {
    let (ours, middle) = tokio::io::duplex(4096);
    let (onward, theirs) = tokio::io::duplex(4096);
    tokio::spawn(async move { control.serve(theirs).await });
    let tape = Tape::default();
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
    (Link::over("in process", ours), tape)
}

/// Lines that move something: G0, G1, G38, G28, G30, homing and jogs.
fn motions(sent: &str) -> Vec<&str> {
    let moves = |line: &&str| {
        let mut words = line.split_whitespace();
        words.any(|word| matches!(word, "G0" | "G1" | "G28" | "G30") || word.starts_with("G38"))
            || line.starts_with("$H")
            || line.starts_with("$J")
    };
    sent.lines().filter(|line| !line.starts_with('(')).filter(moves).collect()
}

type Made = fn(&mut Options);

/// How the control is made, what the message names, and its remedy.
const UNREADY: [(Made, &str, &str); 10] = [
    (
        |o| {
            o.settings.insert(13, 1.0);
        },
        "in inches ($13=1)",
        "$13=0",
    ),
    (|o| o.homed = false, "X, Y, Z, B, C are not homed", "$H"),
    (|o| o.overrides = [200, 100], "feed 200 %, rapid 100 %", "100 %"),
    (|o| o.overrides = [100, 25], "feed 100 %, rapid 25 %", "100 %"),
    (
        |o| {
            o.settings.insert(20, 0.0);
        },
        "soft limits are off",
        "$20=1",
    ),
    (
        |o| {
            o.settings.insert(131, 0.0);
        },
        "do not limit Y",
        "$131",
    ),
    (
        |o| {
            o.settings.insert(22, 0.0);
        },
        "homing is off",
        "$22=1",
    ),
    (
        |o| {
            o.settings.insert(10, 510.0);
        },
        "hide the machine position",
        "$10=511",
    ),
    (
        |o| {
            o.settings.insert(10, 447.0);
        },
        "the overrides ($10=447)",
        "$10=511",
    ),
    (|o| o.settings.clear(), "does not tell its settings", "grblHAL"),
];

#[tokio::test]
async fn regress_a_control_that_is_not_ready_is_sent_no_motion() {
    for (made, state, remedy) in UNREADY {
        let mut options = Options::of(&testing::machine(), Pace::Fast);
        made(&mut options);
        let (link, tape) = taped(Firmware::new(testing::world(), options));
        let (mut driver, _) = grbl(link);
        let error = driver.prepare().await.unwrap_err();
        assert!(error.to_string().contains(state), "{error}");
        assert!(error.remedy().contains(remedy), "{}", error.remedy());
        let refused = driver.execute(proven(&touch(0))).await.unwrap_err();
        assert!(matches!(refused, ControllerError::NotReady { .. }), "{refused}");
        let sent = tape.lock().unwrap().clone();
        assert_eq!(motions(&sent), Vec::<&str>::new(), "{state}");
    }
    let (link, tape) = taped(firmware());
    let (mut driver, _) = grbl(link);
    driver.prepare().await.unwrap();
    driver.execute(proven(&touch(0))).await.unwrap();
    assert!(!motions(&tape.lock().unwrap()).is_empty());
}

/// `check` names all that `prepare` refuses.
#[tokio::test]
async fn an_introduction_has_the_whole_list() {
    let mut options = Options::of(&testing::machine(), Pace::Fast);
    options.settings.insert(13, 1.0);
    options.settings.insert(20, 0.0);
    (options.homed, options.overrides) = (false, [110, 50]);
    let (link, _) = taped(Firmware::new(testing::world(), options));
    let said = grbl(link).0.introduce().await.unwrap();
    let hinders: Vec<String> =
        said.remarks.iter().filter(|r| r.hinders).map(|r| r.what.clone()).collect();
    assert_eq!(hinders.len(), 4, "{hinders:?}");
}

#[tokio::test]
async fn regress_an_override_during_a_touch_makes_no_reading() {
    let mut touched = false;
    let (link, _) = odd(move |line| {
        touched |= line.contains("G38");
        (touched && line == "?").then(|| status("Idle|MPos:{at}|Bf:100,1023|FS:0,0|Ov:200,100,100"))
    });
    let (mut driver, _) = grbl(link);
    driver.prepare().await.unwrap();
    let error = driver.execute(proven(&touch(3))).await.unwrap_err();
    assert!(error.to_string().contains("feed 200 %"), "{error}");
}

/// A reset forgets that the axes were homed, and all that was set.
#[tokio::test]
async fn regress_a_control_that_was_reset_is_not_ready_until_it_is_homed() {
    let (ours, theirs) = tokio::io::duplex(4096);
    let mut control = firmware();
    tokio::spawn(async move { control.serve(theirs).await });
    let (mut driver, _) = grbl(Link::over("in process", ours));
    driver.prepare().await.unwrap();
    driver.wire.ask("\x18").await.unwrap_err();
    let error = driver.prepare().await.unwrap_err();
    assert!(error.to_string().contains("not homed"), "{error}");
    driver.wire.ask("$H").await.unwrap();
    driver.prepare().await.unwrap();
}

/// Somebody enters words at the control between two preparations.
#[tokio::test]
async fn regress_modes_changed_by_hand_are_set_again_and_the_first_ones_restored() {
    let (ours, theirs) = tokio::io::duplex(4096);
    let mut control = firmware();
    tokio::spawn(async move { control.serve(theirs).await });
    let (mut driver, _) = grbl(Link::over("in process", ours));
    driver.wire.wake().await.unwrap();
    driver.wire.ask("G55 G90").await.unwrap();
    driver.prepare().await.unwrap();
    driver.wire.ask("G54 G91 G20").await.unwrap();
    driver.prepare().await.unwrap();
    let modes = |said: Vec<Message>| format!("{said:?}");
    let set = modes(driver.wire.ask("$G").await.unwrap());
    assert!(["G59", "G21", "G90"].iter().all(|word| set.contains(word)), "{set}");
    driver.execute(proven(&touch(0))).await.unwrap();
    driver.finish().await.unwrap();
    let left = modes(driver.wire.ask("$G").await.unwrap());
    assert!(left.contains("G55") && left.contains("G90"), "{left}");
}
