use std::f64::consts::{PI, TAU};

use super::rs274::{self, DeclaredCommands, MotionFrame, MotionKind, ReadError, ReadMotion};
use super::*;
use machine::record::motion::{Motion, MotionBlock};
use machine::{Axis, Position};

const AXES: [Axis; 5] = [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C];

fn position_from_mm_or_deg(words: &[(Axis, f64)]) -> Position {
    words.iter().map(|(axis, edge)| (*axis, axis.to_mm_or_rad(*edge))).collect()
}

/// Motions of a measurement, with values that are hard to format.
fn hard_to_format_blocks(has_orientation: bool) -> Vec<MotionBlock> {
    use Axis::*;
    let mut first = vec![
        Motion::Rapid { to: position_from_mm_or_deg(&[(Z, 200.0)]) },
        Motion::Rapid { to: position_from_mm_or_deg(&[(B, -1e-9), (C, 120.0)]) },
        Motion::Guarded { to: position_from_mm_or_deg(&[(X, 60.0), (Y, -0.000_000_1)]), feed_mm_min: 2000.0 },
        Motion::Guarded { to: position_from_mm_or_deg(&[(Z, 50.123_456_7)]), feed_mm_min: 300.0 },
        Motion::Probe { to: position_from_mm_or_deg(&[(X, 46.0), (Y, -7.0 / 3.0)]), feed_mm_min: 29.7 },
        Motion::BackOff { to: position_from_mm_or_deg(&[(X, 50.0), (Y, -0.0)]), feed_mm_min: 600.0 },
    ];
    if has_orientation {
        first.insert(1, Motion::OrientSpindle { s: -PI / 2.0 });
    }
    let second = vec![
        Motion::Dwell { seconds: 0.25 },
        Motion::Feed { to: position_from_mm_or_deg(&[(Y, 12.3456), (Z, 1.0 / 3.0)]), feed_mm_min: 120.0 },
        Motion::Rapid { to: position_from_mm_or_deg(&[(X, -150.5), (Y, 99.999_99), (C, -359.999)]) },
    ];
    vec![MotionBlock { step: 0, repeat: 0, motions: first }, MotionBlock { step: 99_999, repeat: 2, motions: second }]
}

fn read_program_without_declared_commands(text: &str, zero_slot: Option<&str>) -> Result<Vec<ReadMotion>, ReadError> {
    rs274::read_program(text, zero_slot, &DeclaredCommands::default())
}

/// Checks that `text`, a whole program, means exactly the motions of `blocks`.
pub(super) fn check_program_equals_blocks(
    dialect: &Dialect,
    text: &str,
    blocks: &[MotionBlock],
) -> Result<(), Box<dyn std::error::Error>> {
    let mut read = dialect.read_back(text)?;
    for block in blocks {
        let after = read.split_off(block.motions.len().min(read.len()));
        dialect.check_read_motions(block.step, &block.motions, &read)?;
        read = after;
    }
    if read.is_empty() { Ok(()) } else { Err("the program has surplus motions".into()) }
}

const TESTED_DIALECTS: [&str; 3] = ["grbl", "grbl-m19", "linuxcnc"];

fn render_golden_program(name: &str) -> String {
    let program =
        HeadAndFootValues { title: "golden (50%)", axes: &AXES, result_log_path: Some("/var/tmp/golden.log") };
    Dialect::from_name(name).unwrap().render_program(&program, &hard_to_format_blocks(name != "grbl")).unwrap()
}

#[test]
fn the_text_of_each_dialect_is_its_golden_output() {
    for name in TESTED_DIALECTS {
        let extension = Dialect::from_name(name).unwrap().program_file_extension().to_owned();
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
        let path = format!("{root}/gcode-templates/{name}/golden.{extension}");
        if std::env::var_os("TRUED_BLESS").is_some() {
            std::fs::write(&path, render_golden_program(name)).unwrap();
        }
        assert_eq!(render_golden_program(name), std::fs::read_to_string(&path).unwrap(), "{name}");
    }
}

#[test]
fn rendered_text_reads_back_as_the_same_motions() {
    for name in TESTED_DIALECTS {
        let dialect = Dialect::from_name(name).unwrap();
        check_program_equals_blocks(&dialect, &render_golden_program(name), &hard_to_format_blocks(name != "grbl"))
            .unwrap();
    }
}

#[test]
fn change_in_one_line_of_a_program_is_detected() {
    let dialect = Dialect::from_name("linuxcnc").unwrap();
    let text = render_golden_program("linuxcnc");
    for (from, to) in [
        ("X46.000000", "X46.000002"),
        ("C120.000000", "C121.000000"),
        ("F29.700", "F297.00"),
        ("N0 G38.3 Z", "N0 G1 Z"),
        ("G59.3\n", "G54\n"),
        ("G49 ", ""),
        ("G92.2\n", ""),
        ("G21 ", "G20 "),
        ("N99999 G4 P0.250\n", ""),
        ("R270.000", "R90.000"),
    ] {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "{from} is not in the program");
        assert!(
            check_program_equals_blocks(&dialect, &changed, &hard_to_format_blocks(true)).is_err(),
            "{from} -> {to}"
        );
    }
}

#[test]
fn the_error_of_an_unknown_dialect_lists_the_known_ones() {
    let error = Dialect::from_name("fanuc").unwrap_err().to_string();
    assert!(error.contains("grbl, grbl-m19, linuxcnc"), "{error}");
}

#[test]
fn unrenderable_motions_are_refused_with_a_typed_error() {
    let dialect = Dialect::from_name("grbl").unwrap();
    let render = |motion| dialect.render_block(&MotionBlock { step: 1, repeat: 0, motions: vec![motion] });
    let nan = Motion::Rapid { to: position_from_mm_or_deg(&[(Axis::X, f64::NAN)]) };
    assert!(matches!(render(nan), Err(RenderError::ValueNotFinite(v)) if v.is_nan()));
    let feed = Motion::Probe { to: position_from_mm_or_deg(&[(Axis::X, 1.0)]), feed_mm_min: f64::INFINITY };
    assert_eq!(render(feed), Err(RenderError::ValueNotFinite(f64::INFINITY)));
    assert!(matches!(
        render(Motion::OrientSpindle { s: 0.0 }),
        Err(RenderError::MissingTemplate { missing_template: "orient", .. })
    ));
    let spindle = Motion::Rapid { to: position_from_mm_or_deg(&[(Axis::S, 0.0)]) };
    assert!(matches!(render(spindle), Err(RenderError::NoWordForAxis { axis: Axis::S, .. })));
    assert_eq!(render(Motion::Rapid { to: Position::new() }), Err(RenderError::MotionWithoutTargetAxis));
    let late = MotionBlock { step: 100_000, repeat: 0, motions: vec![] };
    assert_eq!(dialect.render_block(&late), Err(RenderError::StepNumberTooLarge(100_000)));
}

#[test]
fn a_template_cannot_print_a_bare_number_or_an_undefined_value() {
    let mut environment = super::template_environment::template_environment();
    environment.add_template("bare", "X{{ x }}").unwrap();
    environment.add_template("typo", "X{{ xx }}").unwrap();
    let context = minijinja::value::Value::from_pairs([("x", 0.1)]);
    for name in ["bare", "typo"] {
        assert!(environment.get_template(name).unwrap().render(context.clone()).is_err(), "{name}");
    }
}

const MODE_LINES: &str = "G21 G90 G94 G17 G40 G49 G80 G61\nG92.1\nG54\n";

fn read_motions_after_mode_lines(text: &str) -> Vec<rs274::ReadMotion> {
    read_program_without_declared_commands(&format!("{MODE_LINES}{text}"), Some("G54")).unwrap()
}

#[test]
fn the_reader_follows_modal_state() {
    let read = read_motions_after_mode_lines("G1 X1 F100\nY2\nG91 X2 (still G1)\nG20 X1 F1\nG90 G0 C90\n");
    let kinds: Vec<_> = read.iter().map(|m| m.kind).collect();
    assert_eq!(kinds, [MotionKind::Feed, MotionKind::Feed, MotionKind::Feed, MotionKind::Feed, MotionKind::Rapid]);
    assert_eq!(read[1].target, position_from_mm_or_deg(&[(Axis::Y, 2.0)]));
    assert_eq!(read[2].target, position_from_mm_or_deg(&[(Axis::X, 3.0)]));
    assert!((read[3].target.get_or_zero(Axis::X) - 28.4).abs() < 1e-12, "X1 in inches is 25.4 mm further");
    assert_eq!(read[3].feed_mm_min, Some(25.4));
    assert!((read[4].target.get_or_zero(Axis::C) - TAU / 4.0).abs() < 1e-12);
    assert_eq!(read[4].line, 8);
}

#[test]
fn target_is_in_machine_frame_only_with_known_zero_offsets() {
    let frame = |text: &str, slot| read_program_without_declared_commands(text, slot).unwrap().pop().unwrap().frame;
    let work = |slot: &str| MotionFrame::Work(slot.to_owned());
    let with_g55 = format!("{MODE_LINES}G55\nG0 X1");
    assert_eq!(frame(&with_g55, Some("G54")), work("G55"));
    assert_eq!(frame(&with_g55, Some("G55")), MotionFrame::Machine);
    assert_eq!(frame(&format!("{MODE_LINES}G55\nG53 G0 X1"), None), MotionFrame::Machine);
    assert_eq!(frame("G21 G90 G94 G61 G54 G49\nG0 X1", Some("G54")), work("G54"), "G92 may be active");
    assert_eq!(frame("G21 G90 G94 G61 G49 G92.1\nG0 X1", Some("G54")), work("an unknown work offset"));
    let zeroed = format!("{MODE_LINES}G10 L2 P6 X0 Y0\nG59\n");
    assert_eq!(frame(&format!("{zeroed}G0 X1"), None), MotionFrame::Machine);
    assert_eq!(frame(&format!("{zeroed}G0 Z1"), None), work("G59"), "Z was not set to zero");
}

#[test]
fn the_reader_refuses_unsupported_words_with_their_line() {
    for (text, reason) in [
        ("G2 X1 I1 F1", "G2 "),
        ("G0 X1 G1 F1", "G1 "),
        ("G0 X#5", "not a word"),
        ("G0 X[1+2]", "not a word"),
        ("G0 X1 X2", "two X"),
        ("G0 X1 P2", "P2"),
        ("G43 H1", "G43"),
        ("M3 S100", "M3"),
        ("/G0 X1", "not supported"),
        ("G38.4 X1 F1", "G38.4"),
        ("G1 X1", "no feed"),
        ("G91 G0 X1", "is unknown"),
        ("G53 G38.3 X1 F1", "G53"),
        ("X1", "no motion"),
        ("G10 L2 P1 X5", "offset"),
        ("G10 L20 P1 X0", "L2"),
        ("M66 P0 L3 Q1", "L0"),
        ("G0 X1 (open", "comment"),
        ("o100 while [1]", "conditions"),
        ("o<a> if [1]\nG0 X1\no<a> endif", ""),
        ("M72\nG0 X1", "G20"),
        ("M72\nG21 G90 G94\nG0 X1", "neither G61"),
        ("M72\nG21 G90 G61.1\nG0 X1", "G94 is not set"),
        ("G64\nG0 X1", "G64 rounds corners"),
        ("G64 P0.01", "G64 rounds corners"),
        ("G95", "G95"),
    ] {
        let error = read_program_without_declared_commands(&format!("{MODE_LINES}{text}"), None).unwrap_err();
        assert!(error.line >= 4 && error.to_string().contains(reason), "{text}: {error}");
    }
    let unset = |text| read_program_without_declared_commands(text, None).unwrap_err();
    assert!(unset("G90\nG0 X1").to_string().contains("G20"));
    assert!(unset("G21\nG0 X1").to_string().contains("G90"));
    assert!(unset("G21 G90 G94\nG0 X1").to_string().contains("neither G61"));
    assert!(unset("G21 G90 G61\nG0 X1").to_string().contains("G94"));
    assert_eq!(read_program_without_declared_commands("G21 G90 G94 G61.1\nG0 X1", None).unwrap().len(), 1);
    assert!(
        read_program_without_declared_commands(&format!("{MODE_LINES}M2\nG0 X1"), None)
            .unwrap_err()
            .to_string()
            .contains("end")
    );
    assert!(
        read_program_without_declared_commands(&format!("{MODE_LINES}o<a> if [1]\nM2"), None)
            .unwrap_err()
            .to_string()
            .contains("no end")
    );
    assert!(
        read_program_without_declared_commands(&format!("{MODE_LINES}o<a> if [1]\nM72\no<a> endif"), None).is_err(),
        "a branch that ends without M2 is refused"
    );
    assert!(
        read_program_without_declared_commands(&format!("{MODE_LINES}o<a> if [1]\nM2\no<a> endif\n"), None)
            .unwrap()
            .is_empty()
    );
}

#[test]
fn an_incremental_move_after_a_probing_move_is_refused() {
    let error = read_program_without_declared_commands(&format!("{MODE_LINES}G0 X0\nG38.3 X9 F1\nG91 G0 X1"), None)
        .unwrap_err();
    assert!(error.to_string().contains("is unknown"), "{error}");
}

#[test]
fn prompt_is_rendered_as_message_and_m0() {
    for name in TESTED_DIALECTS {
        let dialect = Dialect::from_name(name).unwrap();
        let asked = dialect.render_prompt(7, "turn it by 45° (clamp it) %").unwrap();
        assert_eq!(asked, ["(MSG,turn it by 45   clamp it   )", "N7 M0"], "{name}");
        let read = dialect.read_back(&asked.join("\n")).unwrap();
        let read: Vec<_> = read.iter().map(|read| (read.step_number, read.kind)).collect();
        assert_eq!(read, [(Some(7), super::rs274::MotionKind::ProgramStop)], "{name}");
    }
}
