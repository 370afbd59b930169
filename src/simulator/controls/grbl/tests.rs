//! Compares the simulated control with transcripts of a real grblHAL (Linux build of August 2026, five axes
//! XYZBC): the expected bytes are those of grblHAL.

use super::*;

fn grblhal_firmware(change: impl FnOnce(&mut SimulatedGrblOptions)) -> Firmware {
    let mut options = SimulatedGrblOptions::for_machine(&testing::five_axis_machine(), SimulationPace::Immediate);
    options.has_time_stamps = false;
    change(&mut options);
    Firmware::new(testing::world_with_round_part(), options)
}

fn send_at(firmware: &mut Firmware, seconds: f64, bytes: &str) -> Vec<String> {
    let now = Duration::from_secs_f64(seconds);
    firmware.advance_and_return_wake_time(now);
    firmware.receive_bytes(bytes.as_bytes(), now);
    firmware.advance_and_return_wake_time(now);
    let out = String::from_utf8(std::mem::take(&mut firmware.send_buffer)).unwrap();
    out.split_terminator("\r\n").map(str::to_owned).collect()
}

fn send(firmware: &mut Firmware, bytes: &str) -> Vec<String> {
    send_at(firmware, 0.0, bytes)
}

const MOVE_BESIDE_PART: &str = "G53 G0 X40 Y0\nG53 G0 Z-150\n";

#[test]
fn version_and_first_status_are_those_of_grblhal() {
    let mut firmware = grblhal_firmware(|_| {});
    assert_eq!(
        send(&mut firmware, "$I\n"),
        ["[VER:1.1f.20260817:]", "[OPT:VNML+,100,1024,5,0]", "[AXS:5:XYZBC]", "ok"]
    );
    assert_eq!(
        send(&mut firmware, "?"),
        ["<Idle|MPos:0.000,0.000,0.000,0.000,0.000|Bf:100,1023|FS:0,0|Ov:100,100,100|A:|TLR:0>"]
    );
}

#[test]
fn banner_depends_on_the_compatibility_level() {
    let mut native = grblhal_firmware(|_| {});
    assert_eq!(send(&mut native, "\x18"), ["", "GrblHAL 1.1f ['$' or '$HELP' for help]"]);
    let mut classic = grblhal_firmware(|options| options.is_compatibility_level_0 = false);
    assert_eq!(send(&mut classic, "\x18"), ["", "Grbl 1.1f ['$' for help]"]);
}

#[test]
fn touch_miss_and_closed_probe_are_reported() {
    let mut firmware = grblhal_firmware(|_| {});
    send(&mut firmware, MOVE_BESIDE_PART);
    let touch = send(&mut firmware, "N7 G38.2 X0 F30\n");
    assert_eq!(touch, ["[PRB:28.000,0.000,-150.000,0.000,0.000:1]", "ok"]);
    // The probe still reads closed after the overshoot.
    let status = send(&mut firmware, "?").join("");
    assert!(status.contains("|Pn:P"), "{status}");
    assert_eq!(send(&mut firmware, "G38.3 X0\n"), ["ALARM:4", "ok"]);
    assert_eq!(send(&mut firmware, "G0 X3\n"), ["error:9"]);
    assert_eq!(send(&mut firmware, "$X\n"), ["[MSG:Caution: Unlocked]", "ok"]);
    send(&mut firmware, "G0 X40\n");
    let guarded = send(&mut firmware, "G38.3 X35\n");
    assert_eq!(guarded, ["[PRB:35.000,0.000,-150.000,0.000,0.000:0]", "ok"]);
    assert_eq!(
        send(&mut firmware, "G38.2 X30\nG0 X33\n"),
        ["ALARM:5", "[PRB:30.000,0.000,-150.000,0.000,0.000:0]", "ok", "error:9"]
    );
}

#[test]
fn level_0_latches_errors_and_level_10_does_not() {
    let mut native = grblhal_firmware(|_| {});
    assert_eq!(send(&mut native, "G5\nG21\n\nG21\n"), ["error:20", "error:20", "ok", "ok"]);
    let mut classic = grblhal_firmware(|options| options.is_compatibility_level_0 = false);
    assert_eq!(send(&mut classic, "G5\nG21\n"), ["error:20", "ok"]);
}

#[test]
fn soft_limit_while_idle_locks_until_a_reset() {
    let mut firmware = grblhal_firmware(|_| {});
    let answer = send(&mut firmware, "G0 X500\n");
    assert_eq!(answer[..2], ["ALARM:2", "[MSG:Reset to continue]"]);
    assert_eq!(send(&mut firmware, "G0 X0\n"), ["error:9"]);
    send(&mut firmware, "\n");
    assert_eq!(send(&mut firmware, "$X\n"), ["error:79"]);
    send(&mut firmware, "\x18");
    assert_eq!(send(&mut firmware, "G0 X0\n"), ["ok"]);
}

#[test]
fn soft_limit_while_moving_leaves_lines_unanswered_until_a_reset() {
    let mut firmware = grblhal_firmware(|options| options.pace = SimulationPace::RealTime);
    let answer = send(&mut firmware, "G0 X100\nG0 X500\nG0 X0\n");
    assert_eq!(answer, ["ok", "ALARM:2"]);
    assert_eq!(send_at(&mut firmware, 9.0, "G0 X0\n$X\n"), [""; 0]);
    send(&mut firmware, "\x18");
    assert!(send_at(&mut firmware, 10.0, "?").join("").contains("<Idle"));
}

#[test]
fn feed_hold_stops_a_move_and_cycle_start_completes_it() {
    let mut firmware = grblhal_firmware(|options| options.pace = SimulationPace::RealTime);
    assert_eq!(send(&mut firmware, "G1 X60 F60\n"), ["ok"]);
    assert!(send_at(&mut firmware, 20.0, "?").join("").starts_with("<Run|"));
    let held = send_at(&mut firmware, 30.0, "!?").join("");
    assert!(held.starts_with("<Hold:0|MPos:2") || held.starts_with("<Hold:0|MPos:3"), "{held}");
    let stays = send_at(&mut firmware, 500.0, "?").join("");
    assert_eq!(held.split('|').nth(1), stays.split('|').nth(1));
    send_at(&mut firmware, 500.0, "~");
    let done = send_at(&mut firmware, 600.0, "?").join("");
    assert!(done.starts_with("<Idle|MPos:60.000,"), "{done}");
}

#[test]
fn soft_reset_in_motion_raises_alarm_3_and_locks() {
    let mut firmware = grblhal_firmware(|options| options.pace = SimulationPace::RealTime);
    send(&mut firmware, "G1 X60 F60\nG4 P1\nG0 X0\n");
    assert_eq!(
        send_at(&mut firmware, 10.0, "\x18"),
        ["ALARM:3", "", "GrblHAL 1.1f ['$' or '$HELP' for help]", "[MSG:'$H'|'$X' to unlock]"]
    );
    assert_eq!(send_at(&mut firmware, 11.0, "G0 X0\n"), ["error:9"]);
}

#[test]
fn lines_get_the_ok_or_error_code_of_grblhal() {
    for (line, answer) in [
        ("(comment) G21 ; more", "ok"),
        ("N12 G53 G1 X1 F100", "ok"),
        ("G53 G38.2 X1 F100", "error:30"),
        ("G38.2 F100", "error:26"),
        ("G1 X1", "error:22"),
        ("G20 G21", "error:21"),
        ("X1 X2", "error:25"),
        ("G0 A5", "error:20"),
        ("G0 X--1", "error:2"),
        ("9", "error:1"),
        ("G4", "error:28"),
        ("G0 X1 P3", "error:36"),
        ("G80 X1", "error:31"),
        ("G10 L2 P9 X0", "error:29"),
        ("M19 R90", "ok"),
        (&"X".repeat(300), "error:11"),
    ] {
        assert_eq!(send(&mut grblhal_firmware(|_| {}), &format!("{line}\n")), [answer], "{line}");
    }
}

#[test]
fn offsets_inches_and_relative_moves_are_executed() {
    let mut firmware = grblhal_firmware(|_| {});
    send(&mut firmware, "G10 L2 P6 X10\nG59\nG0 X5 Z-30\nG20 G91\nG0 Y1\nG53 G0 B-90\n");
    let status = send(&mut firmware, "?").join("");
    assert!(status.contains("MPos:15.000,25.400,-30.000,-90.000,0.000|"), "{status}");
    send(&mut firmware, "G21 G90\nG92 Y0\nG0 Y1\nG92.1\n");
    let status = send(&mut firmware, "?").join("");
    assert!(status.contains("MPos:15.000,26.400,"), "{status}");
}
