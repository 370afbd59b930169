//! Fuzz tests of the parser: arbitrary text from a control.

use super::message::{Message, Status};
use testing::fuzz::fuzz;

const TALK: &[u8] = b"GrblHAL 1.1f ['$' or '$HELP' for help]
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
fn the_reply_parser_bears_anything() {
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
    fuzz("grbl-replies", &[TALK], &words, |input| {
        let text = String::from_utf8_lossy(input);
        text.lines().map(|line| size(&Message::parse(line))).sum()
    });
}

/// Memory size of a message. Every number in the message must be finite.
fn size(message: &Message) -> usize {
    let numbers = |values: &[f64]| {
        assert!(values.iter().all(|value| value.is_finite()), "{message:?}");
        size_of_val(values)
    };
    let heap = match message {
        Message::Touch { values, .. } | Message::Offset { values, .. } => numbers(values),
        Message::Time(t_s) => numbers(&[*t_s]),
        Message::Status(Status { state, substate, position, t_s, pins, .. }) => {
            let words = state.len() + substate.as_ref().map_or(0, String::len) + pins.len();
            words + numbers(position.as_deref().unwrap_or_default()) + numbers(t_s.as_slice())
        }
        Message::Banner(text)
        | Message::Version(text)
        | Message::Axes(text)
        | Message::Other(text) => text.len(),
        Message::Modes(words) => words.iter().map(|word| word.len() + size_of::<String>()).sum(),
        Message::Ok
        | Message::Error(_)
        | Message::Alarm(_)
        | Message::Buffer(_)
        | Message::Homed(_)
        | Message::Setting(..) => 0,
    };
    heap + size_of::<Message>()
}
