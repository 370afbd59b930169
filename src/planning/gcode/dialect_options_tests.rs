//! Options that a machine adds to its dialect, tested with the dialects grbl and linuxcnc.

use serde_json::json;

use super::tests::check_program_equals_blocks;
use super::*;
use machine::record::machine::{Machine, Probe};
use machine::record::motion::{Motion, MotionBlock};
use machine::{Axis, Position};

const AXES: [Axis; 5] = [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C];

fn machine_with_clamps() -> Machine {
    let axis = |clamp: Option<u32>| {
        let clamp = clamp.map(|output| json!({"close": format!("M65 P{output}"), "open": format!("M64 P{output}")}));
        json!({"min": -360, "max": 360, "clamp": clamp})
    };
    serde_json::from_value(json!({
        "name": "m", "topology": "w-C-B-X-F-Z-Y-S-t",
        "axes": {"X": axis(None), "Y": axis(None), "Z": axis(None), "B": axis(Some(2)),
                 "C": axis(Some(3))}
    }))
    .unwrap()
}

fn probe_with_health_inputs(error_input: &str, battery_input: &str) -> Probe {
    serde_json::from_value(json!({
        "ball_radius_mm": 3, "on": "M64 P1", "off": "M65 P1", "error_input": error_input,
        "battery_input": battery_input
    }))
    .unwrap()
}

fn dialect_with_options(name: &str) -> Dialect {
    let inputs = if name == "grbl" { ("O", "E") } else { ("0", "3") };
    Dialect::from_name(name)
        .unwrap()
        .with_machine_options(&machine_with_clamps(), &probe_with_health_inputs(inputs.0, inputs.1))
        .unwrap()
}

fn blocks_with_clamped_axes() -> Vec<MotionBlock> {
    use Axis::*;
    let at = |words: &[(Axis, f64)]| -> Position {
        words.iter().map(|(axis, edge)| (*axis, axis.to_mm_or_rad(*edge))).collect()
    };
    let motions = vec![
        Motion::Rapid { to: at(&[(Z, 200.0)]) },
        Motion::Rapid { to: at(&[(B, 30.0), (C, 120.0)]) },
        Motion::Guarded { to: at(&[(Z, 50.0)]), feed_mm_min: 300.0 },
        Motion::Dwell { seconds: 0.2 },
        Motion::Probe { to: at(&[(X, 46.0)]), feed_mm_min: 30.0 },
        Motion::BackOff { to: at(&[(X, 50.0)]), feed_mm_min: 600.0 },
        Motion::Rapid { to: at(&[(C, 0.0)]) },
        Motion::Feed { to: at(&[(C, 10.0)]), feed_mm_min: 600.0 },
    ];
    vec![MotionBlock { step: 7, repeat: 0, motions }]
}

fn render_program_with_options(dialect: &Dialect) -> String {
    let program = HeadAndFootValues { title: "options", axes: &AXES, result_log_path: Some("/var/tmp/golden.log") };
    dialect.render_program(&program, &blocks_with_clamped_axes()).unwrap()
}

#[test]
fn the_text_with_options_is_its_golden_output() {
    for name in ["grbl", "linuxcnc"] {
        let dialect = dialect_with_options(name);
        let (root, extension) = (concat!(env!("CARGO_MANIFEST_DIR"), "/../.."), dialect.program_file_extension());
        let path = format!("{root}/gcode-templates/{name}/golden-options.{extension}");
        if std::env::var_os("TRUED_BLESS").is_some() {
            std::fs::write(&path, render_program_with_options(&dialect)).unwrap();
        }
        assert_eq!(render_program_with_options(&dialect), std::fs::read_to_string(&path).unwrap(), "{name}");
    }
}

#[test]
fn text_rendered_with_options_reads_back_as_the_same_motions() {
    for name in ["grbl", "linuxcnc"] {
        let dialect = dialect_with_options(name);
        check_program_equals_blocks(&dialect, &render_program_with_options(&dialect), &blocks_with_clamped_axes())
            .unwrap();
        let plain = Dialect::from_name(name).unwrap().read_back(&render_program_with_options(&dialect)).unwrap_err();
        assert!(plain.to_string().contains("M64 is not supported"), "{plain}");
    }
}

#[test]
fn missing_or_misplaced_switch_command_is_refused() {
    for (from, to, reason) in [
        ("M64 P1\n", "", "the probe is not switched on"),
        ("M64 P1\n", "M65 P1\n", "the probe is not switched on"),
        ("M64 P3\n", "", "C moves while its clamp is not open"),
        ("N7 G53 G0 B30", "M65 P2\nN7 G53 G0 B30", "B moves while its clamp is not open"),
        ("N7 G38.3 Z", "M64 P3\nN7 G38.3 Z", "the clamp of C is not closed"),
        ("M64 P1\n", "M64 P4\n", "M64 is not supported"),
        ("M64 P1\n", "M64 P1 X5\n", "M64 is not supported"),
        ("M64 P1\n", "M64 P1 M64\n", "M64 is not supported"),
    ] {
        for name in ["grbl", "linuxcnc"] {
            let dialect = dialect_with_options(name);
            let text = render_program_with_options(&dialect).replacen(from, to, 1);
            assert_ne!(text, render_program_with_options(&dialect), "{from}");
            let refused =
                check_program_equals_blocks(&dialect, &text, &blocks_with_clamped_axes()).unwrap_err().to_string();
            assert!(refused.contains(reason), "{name}, {to:?} for {from:?}: {refused}");
        }
    }
}

#[test]
fn invalid_switch_commands_are_refused_with_their_key() {
    for (word, reason) in [
        ("G0 X10", "one M word"),
        ("M64 P1 X10", "one M word"),
        ("M64 P1 M65 P1", "one M word"),
        ("M64 P1)", "one M word"),
        ("M64 P1\nG0 X10", "one M word"),
        ("", "one M word"),
        ("M0", "M0 pauses the program"),
        ("M1", "pauses the program"),
        ("M2", "ends the program"),
        ("M30", "ends the program"),
        ("M3", "turns or stops the spindle"),
        ("M4", "turns or stops the spindle"),
        ("M6", "changes the tool"),
        ("M98 P1", "calls or repeats a program"),
        ("M99", "calls or repeats a program"),
        ("M128", "switches the kinematics"),
        ("M129", "switches the kinematics"),
        ("M130", "switches the kinematics"),
        ("M428", "switches the kinematics"),
        ("M429", "switches the kinematics"),
        ("M430", "M430 switches the kinematics"),
        ("M62 P1", "takes effect only with the next move"),
        ("m65 p1", "declared for another function as well"),
    ] {
        let probe = Probe { on: Some(word.to_owned()), ..probe_with_health_inputs("0", "1") };
        let refused =
            Dialect::from_name("linuxcnc").unwrap().with_machine_options(&machine_with_clamps(), &probe).unwrap_err();
        // `off` is declared after `on`: if both have the same command, `off` is refused.
        let key = if word == "m65 p1" { "[probe] off = " } else { "[probe] on = " };
        let text = refused.to_string();
        assert!(text.starts_with(key) && text.contains(reason), "{word}: {text}");
    }
}

#[test]
fn input_name_that_the_control_does_not_use_is_refused() {
    for (name, input) in [("grbl", "3"), ("grbl", "P"), ("linuxcnc", "O"), ("linuxcnc", "64")] {
        let probe = Probe { off: None, on: None, ..probe_with_health_inputs(input, input) };
        let refused =
            Dialect::from_name(name).unwrap().with_machine_options(&machine_with_clamps(), &probe).unwrap_err();
        assert!(refused.to_string().starts_with("[probe] error_input"), "{refused}");
    }
}
