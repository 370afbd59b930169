//! Answers to the program that reads the tool centre; `tests/interop/linuxcnc` runs it on a LinuxCNC.

use super::tests::prepared_driver;
use super::{ToolCentreCommands, ToolCentreSettings};
use crate::controllers::{ControllerDriver, ControllerError};
use machine::Axis;
use machine::record::tool_centre::ToolCentreReading;

/// First lines of the log; identity is the kinematics type 0.
const BEFORE: &str = "kinematics 0\naxes 1.5 0.0 0.0 0.0 25.0 40.0\nkinematics 1\n";

/// What the driver reads where a program without motion writes `log`, and the machine is then at `end_x_mm`.
async fn read(log: &'static str, end_x_mm: f64) -> Result<Option<ToolCentreReading>, ControllerError> {
    let directory = tempfile::tempdir().unwrap();
    let (driver, ..) = prepared_driver(&directory, Some((log, end_x_mm)), |_, _| None).await;
    let mut driver = driver.with_tool_centre(Some(settings()));
    let result = driver.read_tool_centre().await;
    assert_eq!(driver.read_tool_centre().await.is_err(), result.is_err(), "not prepared after a fault");
    result
}

#[tokio::test]
async fn tool_centre_and_axis_positions_are_read() {
    let log = with_start("tool_centre 1.25 -2.5 110.0 9 0 0 0 0 0 0 0\nkinematics 0\nEND\n");
    let reading = read(log, 0.0).await.unwrap().unwrap();
    assert_eq!(reading.tool_centre_mm, [1.25, -2.5, 110.0]);
    assert_eq!((reading.position.get(Axis::X), reading.position.get(Axis::A)), (Some(1.5), None));
    assert!((reading.position.get_or_zero(Axis::C) - 40_f64.to_radians()).abs() < 1e-12);
}

#[tokio::test]
async fn moved_machine_and_other_modes_are_faults() {
    let good = with_start("tool_centre 1 2 3 9 0 0 0 0 0 0 0\nkinematics 0\nEND\n");
    assert!(read(good, 0.0).await.is_ok());
    let exchanged = good.replace("kinematics 1", "kinematics 0").leak();
    for (log, end_x_mm, expected) in [
        (good, 0.5, "moved by hand"),
        (with_start("tool_centre 1 2 3 9 0 0.1 0 0 0 0 0\nkinematics 0\nEND\n"), 0.0, "G59.3 is not zero"),
        (with_start("tool_centre 1 2 3 2 0 0 0 0 0 0 0\nkinematics 0\nEND\n"), 0.0, "another work offset than G59.3"),
        (with_start("tool_centre 1 2 3 9\nkinematics 0\nEND\n"), 0.0, "offsets of G59.3"),
        // With the rotary axes at zero the positions do not show the mode.
        (with_start("tool_centre 1 2 3 9 0 0 0 0 0 0 0\nkinematics 1\nEND\n"), 0.0, "was 0, then 1, then 1"),
        (exchanged, 0.0, "was 0, then 0, then 0"),
        (with_start("kinematics 0\nEND\n"), 0.0, "log of the tool centre"),
        (with_start("END\n"), 0.0, "modes of the kinematics"),
    ] {
        let error = read(log, end_x_mm).await.unwrap_err();
        assert!(error.to_string().contains(expected), "{expected}: {error}");
        if let ControllerError::NotReady { remedy, .. } = error {
            assert!(remedy.contains("to identity and enter G49"), "{remedy}");
        }
    }
}

/// Otherwise `run` would start the program that another client has opened.
#[tokio::test]
async fn program_of_another_client_is_not_started() {
    let directory = tempfile::tempdir().unwrap();
    let mut is_prepared = false;
    let odd = move |_: usize, line: &str| {
        is_prepared |= line == "set run";
        (is_prepared && line == "get PROGRAM").then_some("PROGRAM /tmp/other.ngc\r\n")
    };
    let log = with_start("tool_centre 1 2 3 9 0 0 0 0 0 0 0\nkinematics 0\nEND\n");
    let (driver, ..) = prepared_driver(&directory, Some((log, 0.0)), odd).await;
    let mut driver = driver.with_tool_centre(Some(settings()));
    let error = driver.read_tool_centre().await.unwrap_err().to_string();
    assert!(error.contains("another program is open"), "{error}");
}

/// Text of a log: `BEFORE`, then `rest`.
fn with_start(rest: &str) -> &'static str {
    format!("{BEFORE}{rest}").leak()
}

fn settings() -> ToolCentreSettings {
    let commands: ToolCentreCommands = serde_json::from_str(r#"{"on": "M428", "off": "M429"}"#).unwrap();
    ToolCentreSettings { commands, stylus_length_mm: 40.0 }
}

#[test]
fn commands_are_single_m_words_that_can_switch_kinematics() {
    let parse = |on: &str| serde_json::from_value::<ToolCentreCommands>(serde_json::json!({"on": on, "off": "M429"}));
    for accepted in ["M428", "M68 E3 Q1", "M128"] {
        assert!(parse(accepted).is_ok(), "{accepted}");
    }
    for refused in ["G0 X0", "M3 S100", "M428 G1 X5", "M2", "M62 P1", "M428\nG0 X0", "o<sub> call", "M429"] {
        assert!(parse(refused).is_err(), "{refused}");
    }
}
