//! Planted mistakes between the machine and the program: ports, speeds, control types, registers, and settings of
//! the control.

use machine::record::question::{Answer, Question};
use trued::commissioning::{AnswerFuture, OperatorInterface, Summary};
use trued::setup::{MachineFile, Pace, ReopenableMachine};

use super::bench::{against, machine, runtime, through, with_control};
use super::mistakes::Mistake;

const fn row(name: &'static str, check: fn() -> Summary, phrase: &'static str) -> Mistake {
    Mistake { name, check, phrase }
}

const DIALECT: &str = "\ndialect = \"grbl-m19\"";
const PTY: &str = "wire = \"pty\"";
const MODBUS: &str = "speaks = \"modbus\"";
const PROGRAM: &str = "speaks = \"modbus-program\"";
const RTU: &str = "speaks = \"modbus\"\nwire = \"pty\"\nbaud = 19200";

/// The correct machine file, connected with `keys`, which are made from the address of the control.
fn reached(control: &str, more: &str, keys: impl Fn(String) -> String) -> Summary {
    let truth = with_control(control, &machine(&[])) + more;
    against(&machine(&[]), &truth, Pace::Fast, |served| keys(served) + DIALECT)
}

/// Replaces the value of a key in `[controller]`.
fn with(control: &str, old: &'static str, new: &'static str) -> Summary {
    reached(control, "", |served| {
        assert!(served.contains(old), "{served}");
        served.replace(old, new)
    })
}

/// Keeps the link, but states another type of control.
fn told_as(control: &str, kind: &'static str, more: &'static str) -> Summary {
    reached(control, "", |served| {
        let link = served.lines().find(|line| line.starts_with("serial") || line.starts_with("tcp"));
        format!("kind = \"{kind}\"\n{}{more}", link.unwrap())
    })
}

/// Changes every axis of the register map.
fn read_as(how: &str) -> Summary {
    let axes = |first: u16| {
        let axis = |(letter, place): (&str, u16)| format!("{letter} = {{ address = {}, {how} }}", first + 2 * place);
        [("X", 0), ("Y", 1), ("Z", 2), ("B", 4), ("C", 5)].map(axis).join(", ")
    };
    let map = format!("\nregisters.status.position = {{ {} }}\nregisters.status.latch = {{ {} }}", axes(32), axes(20));
    reached(MODBUS, "", |served| served + &map)
}

/// A register map from a manual that counts from 1.
fn counted_from_one() -> Summary {
    let items = [
        ("sequence_head", 1),
        ("version", 2),
        ("state", 3),
        ("alarm", 4),
        ("accepted", 5),
        ("executed", 6),
        ("error", 7),
        ("probe", 8),
        ("inputs", 9),
        ("latches", 11),
        ("heartbeat", 12),
        ("time_s", 13),
        ("latch_time_s", 17),
        ("sequence_tail", 45),
    ];
    let mut map: String = items.map(|(name, at)| format!("\nregisters.status.{name} = {{ address = {at} }}")).concat();
    for (name, first) in [("latch", 21), ("position", 33)] {
        for (axis, place) in [("X", 0), ("Y", 1), ("Z", 2), ("B", 4), ("C", 5)] {
            map += &format!("\nregisters.status.{name}.{axis} = {{ address = {} }}", first + 2 * place);
        }
    }
    reached(MODBUS, "", |served| served + &map)
}

fn in_the_other_space() -> Summary {
    let command = ["hold", "sequence", "heartbeat", "acknowledge", "crc", "length", "chunk"];
    let place = |(name, at)| format!("\nregisters.command.{name} = {{ address = {at} }}");
    let map: String = command.into_iter().zip(200..).map(place).collect();
    let space = "\nregisters.status.space = \"holding\"";
    reached(MODBUS, "", |served| served + space + &map)
}

/// An operator who allows every question; nothing moves there.
struct Agreeing;

impl OperatorInterface for Agreeing {
    fn wait_for_answer<'a>(&'a mut self, _: &'a Question) -> AnswerFuture<'a> {
        Box::pin(std::future::ready(Answer::Yes))
    }
}

/// A port with a device that sends nothing.
fn silence() -> Summary {
    let told = machine(&[("kind = \"simulated\"\n", ""), ("wire = \"memory\"\n", "@\n")]);
    runtime().block_on(async {
        let pty = link::create_pty().unwrap();
        let keys = format!("kind = \"grbl\"\nserial = \"{}\"{DIALECT}", pty.path);
        let file = MachineFile::parse("machine.toml", told.replace('@', &keys)).unwrap();
        let site = ReopenableMachine::new(&file).unwrap();
        through(&file, &site, &mut Agreeing).await
    })
}

/// The control allows X less travel than the machine file.
pub fn short_travel() -> Summary {
    set("130 = 400")
}

fn set(settings: &str) -> Summary {
    reached(&format!("{PTY}\nsettings = {{ {settings} }}"), "", |served| served)
}

/// Each row has words that occur for no other mistake.
pub const MISTAKES: &[Mistake] = &[
    row(
        "another baud rate",
        || with("wire = \"pty\"\nbaud = 115200", "115200", "9600"),
        "the control communicates at 115200 baud, not at 9600",
    ),
    row("another baud rate, Modbus", || with(RTU, "19200", "9600"), "the device replies at 19200 baud, not at 9600"),
    row(
        "a port that is not there",
        || reached(PTY, "", |_| "kind = \"grbl\"\nserial = \"/dev/trued-nowhere\"".to_owned()),
        "wrong port: this computer has no /dev/trued-nowhere",
    ),
    row(
        "a port where nobody listens",
        || reached(MODBUS, "", |_| "kind = \"modbus\"\ntcp = \"127.0.0.1:1\"".to_owned()),
        "no server answers at 127.0.0.1:1",
    ),
    row("a port that says nothing", silence, "is off, not wired, or not a supported control"),
    row("another kind, TCP", || told_as(MODBUS, "grbl", ""), "the device is of kind `modbus`, not `grbl`"),
    row(
        "another kind, serial",
        || told_as(PTY, "modbus", "\nbaud = 115200\nparity = \"none\""),
        "the device is of kind `grbl`, not `modbus`",
    ),
    row(
        "another unit",
        || reached(RTU, "", |served| served + "\nunit = 7"),
        "a device replies as unit 1, no device as unit 7",
    ),
    row("words the other way", || read_as("order = \"cdab\""), "wrong word order of the positions"),
    row(
        "a scale too small",
        || read_as("scale = 0.00005"),
        "the display of the control does not show the reported position",
    ),
    row("a scale too large", || read_as("scale = 0.1"), "wrong scale of the positions"),
    row("whole numbers read as floating", || read_as("type = \"f32\""), "wrong type of the positions"),
    row("addresses from 1", counted_from_one, "addresses off by one"),
    row(
        "the input registers read as holding ones",
        in_the_other_space,
        "wrong space: the status is in the input registers",
    ),
    row(
        "the control's program stopped",
        || reached(MODBUS, "\n[[simulated.fault]]\nkind = \"frozen\"\n", |served| served),
        "the control's program is stopped",
    ),
    row("another number of the program", || with(PROGRAM, "number = 1", "number = 2"), "the program number is unknown"),
    row(
        "another tool of the program",
        || with(PROGRAM, "number = 1", "number = 1, tool = 5"),
        "another tool is in the spindle",
    ),
    row(
        "words of a row the other way",
        || with(PROGRAM, "number = 1", "number = 1, row = { X = { order = \"cdab\" } }"),
        "or cannot execute a row",
    ),
    row(
        "the call's sequence elsewhere",
        || with(PROGRAM, "number = 1", "number = 1, parameters = { sequence = { address = 7 } }"),
        "or cannot execute a row",
    ),
    row(
        "a program taken for lines",
        || with(PROGRAM, "\nprogram = { number = 1 }", ""),
        "the control runs a resident program, but [controller.program] is missing",
    ),
    row(
        "lines taken for a program",
        || reached(MODBUS, "", |served| served + "\nprogram = { number = 1 }"),
        "the control accepts lines and runs no resident program",
    ),
    row("reports in inches", || set("13 = 1"), "the control reports positions in inches"),
    row("reports without the probe", || set("10 = 495"), "the status reports do not contain the probe"),
    row("homing off", || set("22 = 0"), "homing is off"),
    row("soft limits off", || set("20 = 0"), "soft limits are off"),
    row("a travel that is shorter there", short_travel, "X has a travel of 500 in the machine file"),
    row("a rapid that is slower there", || set("112 = 5000"), "the rapid speed of Z exceeds the value of the control"),
];
