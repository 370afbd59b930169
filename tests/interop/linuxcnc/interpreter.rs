//! LinuxCNC's interpreter alone (`rs274 -g`): compares its canonical calls with our reading of the same text.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::{Mutex, PoisonError};

use estimation::random::seeded_stream;
use libtest_mimic::Failed;
use machine::record::motion::{Motion, MotionBlock};
use machine::record::plan::Plan;
use machine::{Axis, Position};
use planning::SafeHeights;
use planning::gcode::rs274::{DeclaredCommands, MotionKind, ReadMotion, read_program};
use planning::gcode::{Dialect, HeadAndFootValues};
use rand::RngExt;

const AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
/// Half a unit of the last printed decimal.
const PRINTED_TOLERANCE_MM: f64 = 0.000_051;
/// Back-off of a hundredth of an inch after a probing move without contact.
const MISSED_PROBE_BACK_OFF_MM: f64 = 0.255;

/// A canonical call: name and numbers.
type CanonicalCall = (String, Vec<f64>);

/// If several interpreters run at once, one in a hundred fails with a bus error (LinuxCNC 2.9): they run one at a
/// time, and are repeated after a failure.
static INTERPRETER_LOCK: Mutex<()> = Mutex::new(());

fn run_rs274(file: &Path) -> Result<Output, Failed> {
    let _turn = INTERPRETER_LOCK.lock().unwrap_or_else(PoisonError::into_inner);
    let run = || Command::new("rs274").arg("-g").arg(file).output();
    let output = run()?;
    Ok(if output.status.signal().is_some() { run()? } else { output })
}

fn run_and_parse_canonical_calls(text: &str) -> Result<Vec<CanonicalCall>, Failed> {
    let mut file = tempfile::Builder::new().suffix(".ngc").tempfile()?;
    file.write_all(text.as_bytes())?;
    let output = run_rs274(file.path())?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    if !said.contains("FINISH()") {
        let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
        return Err(format!("rs274 does not end the program:\n{said}{complaint}").into());
    }
    Ok(said.lines().filter_map(parse_canonical_call).collect())
}

/// `   22 N17    STRAIGHT_TRAVERSE(10.0000, ..)`
fn parse_canonical_call(line: &str) -> Option<CanonicalCall> {
    let (before, arguments) = line.split_once('(')?;
    let name = before.split_whitespace().last()?;
    if name == "USE_LENGTH_UNITS" {
        return Some((format!("{name}:{}", arguments.trim_end_matches(')')), Vec::new()));
    }
    let numbers = arguments.trim_end_matches(')').split([',', ' ']).filter(|s| !s.is_empty());
    Some((name.to_owned(), numbers.filter_map(|number| number.parse().ok()).collect()))
}

/// State of LinuxCNC's calls before the next move.
#[derive(Default)]
struct ModalState {
    feed_mm_min: f64,
    /// Offsets between work and machine coordinates.
    offsets: BTreeMap<String, Vec<f64>>,
    is_inch: bool,
}

impl ModalState {
    /// Returns the call of the next move, dwell or orientation.
    fn next_motion(&mut self, calls: &mut impl Iterator<Item = CanonicalCall>) -> Option<CanonicalCall> {
        calls.find(|(name, numbers)| {
            match name.as_str() {
                "SET_FEED_RATE" => self.feed_mm_min = numbers[0],
                // The first number is the index of the coordinate system.
                "SET_G5X_OFFSET" => drop(self.offsets.insert(name.clone(), numbers[1..].to_vec())),
                "SET_G92_OFFSET" | "SET_XY_ROTATION" | "USE_TOOL_LENGTH_OFFSET" => {
                    self.offsets.insert(name.clone(), numbers.clone());
                }
                "USE_LENGTH_UNITS:CANON_UNITS_MM" => self.is_inch = false,
                "USE_LENGTH_UNITS:CANON_UNITS_INCHES" => self.is_inch = true,
                _ => {}
            }
            name.starts_with("STRAIGHT") || name == "DWELL" || name == "ORIENT_SPINDLE"
        })
    }
}

/// Checks that LinuxCNC's `theirs` and our reading of `ours` are the same motions; returns their number.
fn compare_interpreters(ours: &str, theirs: &str) -> Result<usize, Failed> {
    let ours = read_program(ours, Some("G59.3"), &DeclaredCommands::default())?;
    let mut calls = run_and_parse_canonical_calls(theirs)?.into_iter();
    let (mut at, mut slack) = (vec![0.0; 6], vec![PRINTED_TOLERANCE_MM; 6]);
    let mut standing = ModalState::default();
    for motion in &ours {
        let (name, numbers) = standing.next_motion(&mut calls).ok_or("LinuxCNC ends before us")?;
        let differ = |why: String| Failed::from(format!("{motion:?}: {name} {numbers:?}: {why}"));
        let expected = match motion.kind {
            MotionKind::Rapid => "STRAIGHT_TRAVERSE",
            MotionKind::Feed => "STRAIGHT_FEED",
            MotionKind::Probe { .. } => "STRAIGHT_PROBE",
            MotionKind::Dwell { .. } => "DWELL",
            MotionKind::OrientSpindle { .. } => "ORIENT_SPINDLE",
            MotionKind::ProgramStop => "PROGRAM_STOP",
        };
        if name != expected {
            return Err(differ(format!("{expected} was expected")));
        }
        if standing.is_inch || standing.offsets.values().flatten().any(|offset| *offset != 0.0) {
            return Err(differ("not in machine coordinates and mm".to_owned()));
        }
        if motion.feed_mm_min.is_some_and(|ours| (ours - standing.feed_mm_min).abs() > PRINTED_TOLERANCE_MM) {
            return Err(differ(format!("their feed is {}", standing.feed_mm_min)));
        }
        check_same_motion_values(motion, &numbers, &mut at, &mut slack).map_err(differ)?;
    }
    match standing.next_motion(&mut calls) {
        Some(more) => Err(format!("LinuxCNC moves on: {more:?}").into()),
        None => Ok(ours.len()),
    }
}

/// `at` and `slack`: position before the motion, and its tolerance, by axis.
fn check_same_motion_values(
    motion: &ReadMotion,
    numbers: &[f64],
    at: &mut [f64],
    slack: &mut [f64],
) -> Result<(), String> {
    let near = |ours: f64, theirs: f64, tolerance: f64| (ours - theirs).abs() <= tolerance;
    match motion.kind {
        MotionKind::Dwell { seconds } => {
            return if near(seconds, numbers[0], PRINTED_TOLERANCE_MM) { Ok(()) } else { Err("dwell".into()) };
        }
        MotionKind::OrientSpindle { s } => {
            let same = near(Axis::S.to_mm_or_deg(s), numbers[1], PRINTED_TOLERANCE_MM);
            return if same { Ok(()) } else { Err("orientation".into()) };
        }
        _ => {}
    }
    for (i, axis) in AXES.into_iter().enumerate() {
        let named = motion.target.get(axis).map(|value| axis.to_mm_or_deg(value));
        let (expected, tolerance) = named.map_or((at[i], slack[i]), |value| (value, PRINTED_TOLERANCE_MM));
        if !near(expected, numbers[i], tolerance) {
            return Err(format!("{axis} should be {expected}"));
        }
        let probing = matches!(motion.kind, MotionKind::Probe { .. });
        slack[i] = if probing && named.is_some() { MISSED_PROBE_BACK_OFF_MM } else { PRINTED_TOLERANCE_MM };
        at[i] = numbers[i];
    }
    Ok(())
}

fn random_position(rng: &mut impl RngExt, axes: &[Axis]) -> Position {
    axes.iter().map(|axis| (*axis, axis.to_mm_or_rad(rng.random_range(-150.0..150.0)))).collect()
}

/// A touch as in the cycle, with arbitrary numbers.
fn random_touch_block(step: u32) -> MotionBlock {
    use Axis::*;
    let rng = &mut seeded_stream(7, &[u64::from(step)]);
    let mut feed = |high: f64| rng.random_range(1.0..high);
    let feeds = [feed(3000.0), feed(60.0), feed(1000.0)];
    let motions = vec![
        Motion::Rapid { to: random_position(rng, &[Z]) },
        Motion::OrientSpindle { s: rng.random_range(0.0..std::f64::consts::TAU) },
        Motion::Rapid { to: random_position(rng, &[A, B, C]) },
        Motion::Guarded { to: random_position(rng, &[X, Y]), feed_mm_min: feeds[0] },
        Motion::Guarded { to: random_position(rng, &[Z]), feed_mm_min: feeds[0] },
        Motion::Probe { to: random_position(rng, &[X, Y, Z]), feed_mm_min: feeds[1] },
        Motion::BackOff { to: random_position(rng, &[X, Y]), feed_mm_min: feeds[2] },
        Motion::Dwell { seconds: rng.random_range(0.01..2.0) },
    ];
    MotionBlock { step, repeat: step % 3, motions }
}

fn render_program(blocks: &[MotionBlock]) -> Result<String, Failed> {
    let dialect = Dialect::from_name("linuxcnc")?;
    let program = HeadAndFootValues { title: "peer test", axes: &AXES, result_log_path: Some("/var/tmp/none.log") };
    let text = dialect.render_program(&program, blocks)?;
    let mut read = dialect.read_back(&text)?;
    for block in blocks {
        let after = read.split_off(block.motions.len().min(read.len()));
        dialect.check_read_motions(block.step, &block.motions, &read)?;
        read = after;
    }
    if !read.is_empty() {
        return Err(format!("{} surplus motions", read.len()).into());
    }
    Ok(text)
}

pub fn random_programs_are_read_as_linuxcnc_reads_them() -> Result<(), Failed> {
    let all: Vec<MotionBlock> = (0..40).map(random_touch_block).collect();
    let whole = render_program(&all)?;
    let read = compare_interpreters(&whole, &whole)?;
    if read != 40 * 8 {
        return Err(format!("only {read} motions").into());
    }
    for one in &all[..3] {
        let text = render_program(std::slice::from_ref(one))?;
        compare_interpreters(&text, &text)?;
    }
    Ok(())
}

/// The printed program of a whole plan, and the program of each touch as the driver runs it, for a LinuxCNC machine
/// and for one with other axes.
pub fn whole_plans_are_read_as_linuxcnc_reads_them() -> Result<(), Failed> {
    for file in ["linuxcnc-sim.toml", "simulated.toml"] {
        let whole = trued_plan_stdout(file, &["--gcode", "linuxcnc"])?;
        let plan: Plan = serde_json::from_str(&trued_plan_stdout(file, &["--json"])?)?;
        let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
        let (blocks, _) = planning::plan_blocks_and_time_s(&plan, &SafeHeights::above_plan_artefact(&plan)?)?;
        let motions = |blocks: &[MotionBlock]| blocks.iter().map(|b| b.motions.len()).sum::<usize>();
        let read = compare_interpreters(&whole, &whole)?;
        eprintln!("{file}: {} touches, {read} motions", blocks.len());
        if blocks.len() < 60 || read != motions(&blocks) {
            return Err(format!("{read} motions in {} touches", blocks.len()).into());
        }
        for block in &blocks {
            let blocks = std::slice::from_ref(block);
            let program = HeadAndFootValues { title: "touch", axes: &axes, result_log_path: Some("/var/tmp/none.log") };
            let text = Dialect::from_name("linuxcnc")?.render_program(&program, blocks)?;
            if compare_interpreters(&text, &text)? != motions(blocks) {
                return Err(text.into());
            }
        }
    }
    Ok(())
}

/// Output of `trued plan self-calibration` for a machine file of this repository.
fn trued_plan_stdout(file: &str, form: &[&str]) -> Result<String, Failed> {
    let machine = format!("{}/config/{file}", env!("CARGO_MANIFEST_DIR"));
    let output = Command::new(env!("CARGO_BIN_EXE_trued"))
        .args(["plan", "self-calibration", "--machine", &machine])
        .args(form)
        .output()?;
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned().into());
    }
    Ok(String::from_utf8(output.stdout)?)
}

/// Checks that the comparison can fail: LinuxCNC reads a different text.
pub fn changed_program_is_read_differently() -> Result<(), Failed> {
    let text = render_program(&[random_touch_block(1)])?;
    for (from, to) in [
        ("G21 ", "G20 "),
        ("G59.3\n", "G10 L2 P1 X1\nG54\n"),
        ("G92.2\n", "G92 X1\n"),
        ("G92.2\n", "G92.2\nG43.1 Z1\n"),
        ("G53 G0 Z", "G53 G0 Z1"),
        ("G38.3 Z", "G1 Z"),
        ("(LOG,END)\n", "G0 X0\n"),
        ("G4 P", "G4 P1"),
    ] {
        let other = text.replacen(from, to, 1);
        if other == text || compare_interpreters(&text, &other).is_ok() {
            return Err(format!("{from} -> {to} is not seen").into());
        }
    }
    Ok(())
}
