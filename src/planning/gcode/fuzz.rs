//! Fuzz tests: arbitrary text as a program.

use super::rs274::{self, DeclaredCommands, ReadMotion};
use testing::fuzz::fuzz_parser;

const GRBL_GOLDEN_PROGRAM: &[u8] = include_bytes!("../../../gcode-templates/grbl/golden.nc");
const LINUXCNC_GOLDEN_PROGRAM: &[u8] = include_bytes!("../../../gcode-templates/linuxcnc/golden.ngc");

#[test]
fn reader_gives_finite_motions_or_an_error_for_any_text() {
    let words = [
        "G0 ",
        "G1",
        "G38.3",
        "G53 ",
        "G90",
        "G91",
        "G20",
        "G21 ",
        "G10 L2 P6 ",
        "G4 P",
        "M19 R",
        "M66 P0 L0",
        "M72",
        "M30",
        "N",
        "X",
        "Y",
        "C",
        "F100 ",
        "o<a> if [",
        "o<a> endif",
        "(ABORT,",
        "%",
        "1",
        "-2.5 ",
        "\n",
        "\n",
    ];
    fuzz_parser("gcode-rs274", &[GRBL_GOLDEN_PROGRAM, LINUXCNC_GOLDEN_PROGRAM], &words, |input| {
        let text = String::from_utf8_lossy(input);
        let read = || rs274::read_program(&text, Some("G59.3"), &DeclaredCommands::default());
        assert_eq!(read(), read());
        let Ok(motions) = read() else { return 0 };
        for motion in &motions {
            assert!(has_only_finite_values(motion), "{motion:?}");
        }
        assert!(motions.len() <= text.lines().count());
        size_of_val(motions.as_slice())
    });
}

fn has_only_finite_values(motion: &ReadMotion) -> bool {
    let of_kind = match motion.kind {
        rs274::MotionKind::Dwell { seconds } => seconds,
        rs274::MotionKind::OrientSpindle { s } => s,
        rs274::MotionKind::Rapid
        | rs274::MotionKind::Feed
        | rs274::MotionKind::Probe { .. }
        | rs274::MotionKind::ProgramStop => 0.0,
    };
    let target = motion.target.iter().map(|(_, value)| value);
    target.chain(motion.feed_mm_min).chain([of_kind]).all(f64::is_finite)
}
