//! Planted mistakes between the machine and the program: ports, speeds, control types, registers, and settings of
//! the control.

use machine::record::question::{OperatorAnswer, OperatorQuestion};
use trued::commissioning::{AnswerFuture, CheckSummary, OperatorInterface};
use trued::setup::{MachineFile, ReopenableMachine, SimulationPace};

use super::machine_mistakes::PlantedMistake;
use super::simulated_machine_checks::{
    changed_machine_toml, check_against_other_machine, check_with_operator, runtime, toml_with_control_keys,
};

const fn mistake(name: &'static str, check: fn() -> CheckSummary, phrase: &'static str) -> PlantedMistake {
    PlantedMistake { name, run_check: check, expected_phrase: phrase }
}

const DIALECT_KEY: &str = "\ndialect = \"grbl-m19\"";
const PTY_KEY: &str = "wire = \"pty\"";
const MODBUS_KEY: &str = "speaks = \"modbus\"";
const RESIDENT_PROGRAM_KEY: &str = "speaks = \"modbus-program\"";
const RTU_KEYS: &str = "speaks = \"modbus\"\nwire = \"pty\"\nbaud = 19200";

/// The correct machine file, connected with `keys`, which are made from the address of the control.
fn check_over_link(control_keys: &str, more_sections: &str, keys: impl Fn(String) -> String) -> CheckSummary {
    let truth = toml_with_control_keys(control_keys, &changed_machine_toml(&[])) + more_sections;
    check_against_other_machine(&changed_machine_toml(&[]), &truth, SimulationPace::Immediate, |served| {
        keys(served) + DIALECT_KEY
    })
}

/// Replaces the value of a key in `[controller]`.
fn check_with_replaced_key(control: &str, old: &'static str, new: &'static str) -> CheckSummary {
    check_over_link(control, "", |served| {
        assert!(served.contains(old), "{served}");
        served.replace(old, new)
    })
}

/// Keeps the link, but states another type of control.
fn check_declared_as(control: &str, kind: &'static str, more: &'static str) -> CheckSummary {
    check_over_link(control, "", |served| {
        let link = served.lines().find(|line| line.starts_with("serial") || line.starts_with("tcp"));
        format!("kind = \"{kind}\"\n{}{more}", link.unwrap())
    })
}

/// Adds these keys to every axis of the register map.
fn check_with_axis_register_keys(keys: &str) -> CheckSummary {
    let axes = |first: u16| {
        let axis = |(letter, place): (&str, u16)| format!("{letter} = {{ address = {}, {keys} }}", first + 2 * place);
        [("X", 0), ("Y", 1), ("Z", 2), ("B", 4), ("C", 5)].map(axis).join(", ")
    };
    let map = format!("\nregisters.status.position = {{ {} }}\nregisters.status.latch = {{ {} }}", axes(32), axes(20));
    check_over_link(MODBUS_KEY, "", |served| served + &map)
}

/// A register map from a manual that counts from 1.
fn check_addresses_from_one() -> CheckSummary {
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
    check_over_link(MODBUS_KEY, "", |served| served + &map)
}

fn check_status_in_holding_registers() -> CheckSummary {
    let command = ["hold", "sequence", "heartbeat", "acknowledge", "crc", "length", "chunk"];
    let place = |(name, at)| format!("\nregisters.command.{name} = {{ address = {at} }}");
    let map: String = command.into_iter().zip(200..).map(place).collect();
    let space = "\nregisters.status.space = \"holding\"";
    check_over_link(MODBUS_KEY, "", |served| served + space + &map)
}

/// An operator who answers every question with yes. The device replies nothing, so nothing moves.
struct AgreeingOperator;

impl OperatorInterface for AgreeingOperator {
    fn wait_for_answer<'a>(&'a mut self, _: &'a OperatorQuestion) -> AnswerFuture<'a> {
        Box::pin(std::future::ready(OperatorAnswer::Yes))
    }
}

/// A port with a device that sends nothing.
fn check_silent_control() -> CheckSummary {
    let told = changed_machine_toml(&[("kind = \"simulated\"\n", ""), ("wire = \"memory\"\n", "@\n")]);
    runtime().block_on(async {
        let pty = link::create_pty().unwrap();
        let keys = format!("kind = \"grbl\"\nserial = \"{}\"{DIALECT_KEY}", pty.path);
        let file = MachineFile::parse("machine.toml", told.replace('@', &keys)).unwrap();
        let site = ReopenableMachine::new(&file).unwrap();
        check_with_operator(&file, &site, &mut AgreeingOperator).await
    })
}

/// The control allows X less travel than the machine file.
pub fn check_short_travel() -> CheckSummary {
    check_grbl_settings("130 = 400")
}

fn check_grbl_settings(settings: &str) -> CheckSummary {
    check_over_link(&format!("{PTY_KEY}\nsettings = {{ {settings} }}"), "", |served| served)
}

/// Each row has words that occur for no other mistake.
pub const LINK_MISTAKES: &[PlantedMistake] = &[
    mistake(
        "another baud rate",
        || check_with_replaced_key("wire = \"pty\"\nbaud = 115200", "115200", "9600"),
        "the control communicates at 115200 baud, not at 9600",
    ),
    mistake(
        "another baud rate, Modbus",
        || check_with_replaced_key(RTU_KEYS, "19200", "9600"),
        "the device replies at 19200 baud, not at 9600",
    ),
    mistake(
        "a port that is not there",
        || check_over_link(PTY_KEY, "", |_| "kind = \"grbl\"\nserial = \"/dev/trued-nowhere\"".to_owned()),
        "wrong port: this computer has no /dev/trued-nowhere",
    ),
    mistake(
        "a port where nobody listens",
        || check_over_link(MODBUS_KEY, "", |_| "kind = \"modbus\"\ntcp = \"127.0.0.1:1\"".to_owned()),
        "no server answers at 127.0.0.1:1",
    ),
    mistake("a port that says nothing", check_silent_control, "is off, not wired, or not a supported control"),
    mistake(
        "another kind, TCP",
        || check_declared_as(MODBUS_KEY, "grbl", ""),
        "the device is of kind `modbus`, not `grbl`",
    ),
    mistake(
        "another kind, serial",
        || check_declared_as(PTY_KEY, "modbus", "\nbaud = 115200\nparity = \"none\""),
        "the device is of kind `grbl`, not `modbus`",
    ),
    mistake(
        "another unit",
        || check_over_link(RTU_KEYS, "", |served| served + "\nunit = 7"),
        "a device replies as unit 1, no device as unit 7",
    ),
    mistake(
        "words the other way",
        || check_with_axis_register_keys("order = \"cdab\""),
        "wrong word order of the positions",
    ),
    mistake(
        "a scale too small",
        || check_with_axis_register_keys("scale = 0.00005"),
        "the display of the control does not show the reported position",
    ),
    mistake("a scale too large", || check_with_axis_register_keys("scale = 0.1"), "wrong scale of the positions"),
    mistake(
        "whole numbers read as floating",
        || check_with_axis_register_keys("type = \"f32\""),
        "wrong type of the positions",
    ),
    mistake("addresses from 1", check_addresses_from_one, "addresses off by one"),
    mistake(
        "the input registers read as holding ones",
        check_status_in_holding_registers,
        "wrong space: the status is in the input registers",
    ),
    mistake(
        "the control's program stopped",
        || check_over_link(MODBUS_KEY, "\n[[simulated.fault]]\nkind = \"frozen\"\n", |served| served),
        "the control's program is stopped",
    ),
    mistake(
        "another number of the program",
        || check_with_replaced_key(RESIDENT_PROGRAM_KEY, "number = 1", "number = 2"),
        "the program number is unknown",
    ),
    mistake(
        "another tool of the program",
        || check_with_replaced_key(RESIDENT_PROGRAM_KEY, "number = 1", "number = 1, tool = 5"),
        "another tool is in the spindle",
    ),
    mistake(
        "words of a row the other way",
        || {
            check_with_replaced_key(
                RESIDENT_PROGRAM_KEY,
                "number = 1",
                "number = 1, row = { X = { order = \"cdab\" } }",
            )
        },
        "or cannot execute a row",
    ),
    mistake(
        "the call's sequence elsewhere",
        || {
            check_with_replaced_key(
                RESIDENT_PROGRAM_KEY,
                "number = 1",
                "number = 1, parameters = { sequence = { address = 7 } }",
            )
        },
        "or cannot execute a row",
    ),
    mistake(
        "a program taken for lines",
        || check_with_replaced_key(RESIDENT_PROGRAM_KEY, "\nprogram = { number = 1 }", ""),
        "the control runs a resident program, but [controller.program] is missing",
    ),
    mistake(
        "lines taken for a program",
        || check_over_link(MODBUS_KEY, "", |served| served + "\nprogram = { number = 1 }"),
        "the control accepts lines and runs no resident program",
    ),
    mistake("reports in inches", || check_grbl_settings("13 = 1"), "the control reports positions in inches"),
    mistake(
        "reports without the probe",
        || check_grbl_settings("10 = 495"),
        "the status reports do not contain the probe",
    ),
    mistake("homing off", || check_grbl_settings("22 = 0"), "homing is off"),
    mistake("soft limits off", || check_grbl_settings("20 = 0"), "soft limits are off"),
    mistake("a travel that is shorter there", check_short_travel, "X has a travel of 500 in the machine file"),
    mistake(
        "a rapid that is slower there",
        || check_grbl_settings("112 = 5000"),
        "the rapid speed of Z exceeds the value of the control",
    ),
];
