//! LinuxCNC's interpreter alone (`rs274 -g`): compares its canonical calls with our reading of the same text.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::{Mutex, PoisonError};

use estimation::random::seeded_stream;
use libtest_mimic::Failed;
use machine::record::motion::{Block, Motion};
use machine::record::plan::Plan;
use machine::{Axis, Position};
use planning::SafeHeights;
use planning::gcode::rs274::{MotionKind, ReadMotion, read_program};
use planning::gcode::{Dialect, ProgramHeader};
use rand::RngExt;

const AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
/// Half a unit of the last printed decimal.
const PRINTED: f64 = 0.000_051;
/// Back-off of a hundredth of an inch after a probing move without contact.
const PROBE_BACK_OFF: f64 = 0.255;

/// A canonical call: name and numbers.
type Canonical = (String, Vec<f64>);

/// If several interpreters run at once, one in a hundred fails with a bus error (LinuxCNC 2.9): they run one at a
/// time, and are repeated after a failure.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn interpreted(file: &Path) -> Result<Output, Failed> {
    let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let run = || Command::new("rs274").arg("-g").arg(file).output();
    let output = run()?;
    Ok(if output.status.signal().is_some() { run()? } else { output })
}

fn canonical(text: &str) -> Result<Vec<Canonical>, Failed> {
    let mut file = tempfile::Builder::new().suffix(".ngc").tempfile()?;
    file.write_all(text.as_bytes())?;
    let output = interpreted(file.path())?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    if !said.contains("FINISH()") {
        let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
        return Err(format!("rs274 does not end the program:\n{said}{complaint}").into());
    }
    Ok(said.lines().filter_map(call).collect())
}

/// `   22 N17    STRAIGHT_TRAVERSE(10.0000, ..)`
fn call(line: &str) -> Option<Canonical> {
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
struct Standing {
    feed: f64,
    /// Offsets between work and machine coordinates.
    offsets: BTreeMap<String, Vec<f64>>,
    inches: bool,
}

impl Standing {
    /// Returns the call of the next move, dwell or orientation.
    fn next(&mut self, calls: &mut impl Iterator<Item = Canonical>) -> Option<Canonical> {
        calls.find(|(name, numbers)| {
            match name.as_str() {
                "SET_FEED_RATE" => self.feed = numbers[0],
                // The first number is the index of the coordinate system.
                "SET_G5X_OFFSET" => drop(self.offsets.insert(name.clone(), numbers[1..].to_vec())),
                "SET_G92_OFFSET" | "SET_XY_ROTATION" | "USE_TOOL_LENGTH_OFFSET" => {
                    self.offsets.insert(name.clone(), numbers.clone());
                }
                "USE_LENGTH_UNITS:CANON_UNITS_MM" => self.inches = false,
                "USE_LENGTH_UNITS:CANON_UNITS_INCHES" => self.inches = true,
                _ => {}
            }
            name.starts_with("STRAIGHT") || name == "DWELL" || name == "ORIENT_SPINDLE"
        })
    }
}

/// Checks that LinuxCNC's `theirs` and our reading of `ours` are the same motions; returns their number.
fn agree(ours: &str, theirs: &str) -> Result<usize, Failed> {
    let ours = read_program(ours, Some("G59.3"))?;
    let mut calls = canonical(theirs)?.into_iter();
    let (mut at, mut slack) = (vec![0.0; 6], vec![PRINTED; 6]);
    let mut standing = Standing::default();
    for motion in &ours {
        let (name, numbers) = standing.next(&mut calls).ok_or("LinuxCNC ends before us")?;
        let differ = |why: String| Failed::from(format!("{motion:?}: {name} {numbers:?}: {why}"));
        let expected = match motion.kind {
            MotionKind::Rapid => "STRAIGHT_TRAVERSE",
            MotionKind::Feed => "STRAIGHT_FEED",
            MotionKind::Probe { .. } => "STRAIGHT_PROBE",
            MotionKind::Dwell { .. } => "DWELL",
            MotionKind::Orient { .. } => "ORIENT_SPINDLE",
            MotionKind::Stop => "PROGRAM_STOP",
        };
        if name != expected {
            return Err(differ(format!("{expected} was expected")));
        }
        if standing.inches || standing.offsets.values().flatten().any(|offset| *offset != 0.0) {
            return Err(differ("not in machine coordinates and mm".to_owned()));
        }
        if motion.feed_mm_min.is_some_and(|ours| (ours - standing.feed).abs() > PRINTED) {
            return Err(differ(format!("their feed is {}", standing.feed)));
        }
        same_numbers(motion, &numbers, &mut at, &mut slack).map_err(differ)?;
    }
    match standing.next(&mut calls) {
        Some(more) => Err(format!("LinuxCNC moves on: {more:?}").into()),
        None => Ok(ours.len()),
    }
}

/// `at` and `slack`: position before the motion, and its tolerance, by axis.
fn same_numbers(motion: &ReadMotion, numbers: &[f64], at: &mut [f64], slack: &mut [f64]) -> Result<(), String> {
    let near = |ours: f64, theirs: f64, tolerance: f64| (ours - theirs).abs() <= tolerance;
    match motion.kind {
        MotionKind::Dwell { seconds } => {
            return if near(seconds, numbers[0], PRINTED) { Ok(()) } else { Err("dwell".into()) };
        }
        MotionKind::Orient { s } => {
            let same = near(Axis::S.to_mm_or_deg(s), numbers[1], PRINTED);
            return if same { Ok(()) } else { Err("orientation".into()) };
        }
        _ => {}
    }
    for (i, axis) in AXES.into_iter().enumerate() {
        let named = motion.target.get(axis).map(|value| axis.to_mm_or_deg(value));
        let (expected, tolerance) = named.map_or((at[i], slack[i]), |value| (value, PRINTED));
        if !near(expected, numbers[i], tolerance) {
            return Err(format!("{axis} should be {expected}"));
        }
        let probing = matches!(motion.kind, MotionKind::Probe { .. });
        slack[i] = if probing && named.is_some() { PROBE_BACK_OFF } else { PRINTED };
        at[i] = numbers[i];
    }
    Ok(())
}

fn some(rng: &mut impl RngExt, axes: &[Axis]) -> Position {
    axes.iter().map(|axis| (*axis, axis.to_mm_or_rad(rng.random_range(-150.0..150.0)))).collect()
}

/// A touch as in the cycle, with arbitrary numbers.
fn block(step: u32) -> Block {
    use Axis::*;
    let rng = &mut seeded_stream(7, &[u64::from(step)]);
    let mut feed = |high: f64| rng.random_range(1.0..high);
    let feeds = [feed(3000.0), feed(60.0), feed(1000.0)];
    let motions = vec![
        Motion::Rapid { to: some(rng, &[Z]) },
        Motion::Orient { s: rng.random_range(0.0..std::f64::consts::TAU) },
        Motion::Rapid { to: some(rng, &[A, B, C]) },
        Motion::Guarded { to: some(rng, &[X, Y]), feed_mm_min: feeds[0] },
        Motion::Guarded { to: some(rng, &[Z]), feed_mm_min: feeds[0] },
        Motion::Probe { to: some(rng, &[X, Y, Z]), feed_mm_min: feeds[1] },
        Motion::BackOff { to: some(rng, &[X, Y]), feed_mm_min: feeds[2] },
        Motion::Dwell { seconds: rng.random_range(0.01..2.0) },
    ];
    Block { step, repeat: step % 3, motions }
}

fn program(blocks: &[Block]) -> Result<String, Failed> {
    let dialect = Dialect::from_name("linuxcnc")?;
    let program = ProgramHeader { title: "peer test", axes: &AXES, log: Some("/var/tmp/none.log") };
    let text = dialect.render_program(&program, blocks)?;
    dialect.check_program(&text, blocks)?;
    Ok(text)
}

pub fn reads_as_we_do() -> Result<(), Failed> {
    let all: Vec<Block> = (0..40).map(block).collect();
    let whole = program(&all)?;
    let read = agree(&whole, &whole)?;
    if read != 40 * 8 {
        return Err(format!("only {read} motions").into());
    }
    for one in &all[..3] {
        let text = program(std::slice::from_ref(one))?;
        agree(&text, &text)?;
    }
    Ok(())
}

/// The printed program of a whole plan, and the program of each touch as the driver runs it, for a LinuxCNC machine
/// and for one with other axes.
pub fn reads_whole_plans_as_we_do() -> Result<(), Failed> {
    for file in ["linuxcnc-sim.toml", "simulated.toml"] {
        let whole = plan(file, &["--gcode", "linuxcnc"])?;
        let plan: Plan = serde_json::from_str(&plan(file, &["--json"])?)?;
        let axes: Vec<Axis> = plan.machine.axes.keys().copied().collect();
        let (blocks, _) = planning::plan_blocks(&plan, &SafeHeights::above_plan_artefact(&plan)?)?;
        let motions = |blocks: &[Block]| blocks.iter().map(|b| b.motions.len()).sum::<usize>();
        let read = agree(&whole, &whole)?;
        eprintln!("{file}: {} touches, {read} motions", blocks.len());
        if blocks.len() < 60 || read != motions(&blocks) {
            return Err(format!("{read} motions in {} touches", blocks.len()).into());
        }
        for block in &blocks {
            let blocks = std::slice::from_ref(block);
            let program = ProgramHeader { title: "touch", axes: &axes, log: Some("/var/tmp/none.log") };
            let text = Dialect::from_name("linuxcnc")?.render_program(&program, blocks)?;
            if agree(&text, &text)? != motions(blocks) {
                return Err(text.into());
            }
        }
    }
    Ok(())
}

/// Output of `trued plan self-calibration` for a machine file of this repository.
fn plan(file: &str, form: &[&str]) -> Result<String, Failed> {
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
pub fn another_disagrees() -> Result<(), Failed> {
    let text = program(&[block(1)])?;
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
        if other == text || agree(&text, &other).is_ok() {
            return Err(format!("{from} -> {to} is not seen").into());
        }
    }
    Ok(())
}
