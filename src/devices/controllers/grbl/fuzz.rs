//! Fuzz tests of the parser: arbitrary text from a control.

use super::message::{GrblMessage, GrblStatus};
use testing::fuzz::fuzz_parser;

const SAMPLE_REPLIES: &[u8] = b"GrblHAL 1.1f ['$' or '$HELP' for help]
[VER:1.1f.20260817:]
[OPT:VNM,100,1024,5,0]
[AXS:5:XYZBC]
[GC:G0 G54 G17 G21 G90 G94 G49 G98 G50 M5 M9 T0 F0 S0.]
$10=511
<Idle|MPos:-47.990,0.000,12.500,0.000,45.000|Bf:100,1023|FS:0,0|Pn:P|Time:12.25>
<Hold:0|MPos:1.000,2.000,3.000|WCO:0.000,0.000,0.000>
[PRB:-47.990,0.000,12.500,0.000,45.000:1]
[TIME:13.5]
[G59:0.000,0.000,0.000,0.000,0.000]
[TLO:0.000,0.000,0.000]
ok
error:9
ALARM:5
";

#[test]
fn fuzz_reply_parser() {
    let words = [
        "ok",
        "error:",
        "ALARM:",
        "<Idle",
        "|MPos:",
        "|Pn:P",
        "|Time:",
        "[PRB:",
        ":1]",
        "[TIME:",
        "[OPT:",
        "[AXS:",
        "[GC:",
        "$10=",
        "1.000,",
        ">",
        "]",
        "\n",
        "Grbl 1.1h help",
    ];
    fuzz_parser("grbl-replies", &[SAMPLE_REPLIES], &words, |input| {
        let text = String::from_utf8_lossy(input);
        text.lines().map(|line| memory_size_of_message(&GrblMessage::parse(line))).sum()
    });
}

/// Memory size of a message. Every number in the message must be finite.
fn memory_size_of_message(message: &GrblMessage) -> usize {
    let numbers = |values: &[f64]| {
        assert!(values.iter().all(|value| value.is_finite()), "{message:?}");
        size_of_val(values)
    };
    let heap = match message {
        GrblMessage::ProbeResult { values, .. } | GrblMessage::Offset { values, .. } => numbers(values),
        GrblMessage::ContactTime(t_s) => numbers(&[*t_s]),
        GrblMessage::Status(GrblStatus {
            state,
            substate,
            machine_position: position,
            control_time_s: t_s,
            active_inputs,
            ..
        }) => {
            let words = state.len() + substate.as_ref().map_or(0, String::len) + active_inputs.len();
            words + numbers(position.as_deref().unwrap_or_default()) + numbers(t_s.as_slice())
        }
        GrblMessage::Banner(text)
        | GrblMessage::Version(text)
        | GrblMessage::AxisLetters(text)
        | GrblMessage::Unknown(text) => text.len(),
        GrblMessage::ModalWords(words) => words.iter().map(|word| word.len() + size_of::<String>()).sum(),
        GrblMessage::Ok
        | GrblMessage::Error(_)
        | GrblMessage::Alarm(_)
        | GrblMessage::MaxLineBytes(_)
        | GrblMessage::HomedAxesMask(_)
        | GrblMessage::Setting(..) => 0,
    };
    heap + size_of::<GrblMessage>()
}
