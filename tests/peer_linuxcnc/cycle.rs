//! The program itself, from one command to a stored estimate, against a running LinuxCNC whose true
//! axes it does not know.

use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;
use tempfile::TempDir;
use trued::record::estimate::Estimate;

use super::rig::{Rig, rig};

const MACHINE: &str = include_str!("../../config/linuxcnc-sim.toml");
/// Where the true C axis stands, and how far from there an answer may lie, µm.
const TRUTH_UM: [(&str, f64); 2] = [("EX0C", 50.0), ("EY0C", -30.0)];
const NEAR_UM: f64 = 1.0;

/// A person's desk: a machine file for this rig and an empty journal.
struct Desk(TempDir);

impl Desk {
    fn for_rig(rig: &Rig) -> Result<Self, Failed> {
        let (port, directory) = ("127.0.0.1:5007", "/tmp/trued-linuxcnc");
        if !MACHINE.contains(port) || !MACHINE.contains(directory) {
            return Err("the machine file names another port or directory".into());
        }
        let machine = MACHINE
            .replace(port, &format!("127.0.0.1:{}", rig.port))
            .replace(directory, &rig.directory.display().to_string());
        let desk = Self(TempDir::new()?);
        std::fs::write(desk.machine(), machine)?;
        Ok(desk)
    }

    fn machine(&self) -> PathBuf {
        self.0.path().join("machine.toml")
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).arg("--state").arg(self.0.path());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// What a command prints that must succeed.
    fn said(&self, arguments: &[&str]) -> Result<String, Failed> {
        let output = self.command(arguments).output()?;
        if !output.status.success() {
            return Err(complaint(&output).into());
        }
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }

    fn start(&self) -> Result<Child, Failed> {
        let machine = self.machine().display().to_string();
        Ok(self.command(&["run", "self-calibration", "--json", "--machine", &machine]).spawn()?)
    }

    /// Measure the whole cycle.
    fn measure(&self) -> Result<Estimate, Failed> {
        let started = Instant::now();
        let output = self.start()?.wait_with_output()?;
        let seconds = started.elapsed().as_secs_f64();
        if output.status.code() != Some(0) {
            return Err(complaint(&output).into());
        }
        let estimate: Estimate = serde_json::from_slice(&output.stdout)?;
        for (symbol, _) in TRUTH_UM {
            let (value, expanded) = result(&estimate, symbol)?;
            eprintln!("{symbol} = {value:.3} um, U = {expanded:.3} um");
        }
        eprintln!("the whole cycle took {seconds:.0} s");
        Ok(estimate)
    }
}

fn complaint(output: &Output) -> String {
    format!("{}: {}", output.status, String::from_utf8_lossy(&output.stderr))
}

/// Value and expanded uncertainty, µm.
fn result(estimate: &Estimate, symbol: &str) -> Result<(f64, f64), Failed> {
    let found = estimate.parameters.iter().find(|parameter| parameter.symbol == symbol);
    found.map(|parameter| (parameter.value, parameter.expanded)).ok_or_else(|| symbol.into())
}

/// Tests 1a, 1b, 1c, 2, 3 and the references with N = 8, twice: as the part stands, and with the
/// part moved by 1 mm.
pub fn finds_the_true_axis_wherever_the_part_stands() -> Result<(), Failed> {
    let rig = rig()?;
    let first = Desk::for_rig(&rig)?.measure()?;
    rig.make_true("ecc-x", 1.120)?;
    let second = Desk::for_rig(&rig)?.measure()?;
    for (symbol, truth) in TRUTH_UM {
        for estimate in [&first, &second] {
            let (value, expanded) = result(estimate, symbol)?;
            let error = (value - truth).abs();
            if error > NEAR_UM || error > expanded || expanded > 2.0 * NEAR_UM {
                return Err(format!("{symbol} = {value} um, U = {expanded} um").into());
            }
        }
        let change = result(&second, symbol)?.0 - result(&first, symbol)?.0;
        eprintln!("the part moved by 1 mm: {symbol} changes by {change:.3} um");
        if change.abs() > NEAR_UM {
            return Err(format!("{symbol} follows the part by {change} um").into());
        }
    }
    Ok(())
}

/// Ctrl-C while the table turns in Test 1a.
pub fn a_stop_holds_and_keeps_what_was_read() -> Result<(), Failed> {
    let rig = rig()?;
    let desk = Desk::for_rig(&rig)?;
    let mut run = desk.start()?;
    while rig.joint(4)?.abs() < 1.0 {
        if run.try_wait()?.is_some() {
            return Err(complaint(&run.wait_with_output()?).into());
        }
    }
    let stopped = Command::new("kill").args(["-INT", &run.id().to_string()]).status()?;
    let output = run.wait_with_output()?;
    if !stopped.success() || output.status.code() != Some(5) || !output.stdout.is_empty() {
        return Err(complaint(&output).into());
    }
    let stands = joints(&rig)?;
    eprintln!("held at C {:.2} deg", stands[4]);
    sleep(Duration::from_millis(500));
    if joints(&rig)? != stands {
        return Err(format!("it moves on from {stands:?}").into());
    }
    let runs = desk.said(&["runs", "--json"])?;
    if serde_json::from_str::<serde_json::Value>(&runs)?[0]["state"] != "held" {
        return Err(runs.into());
    }
    desk.said(&["export", "1", "--to", &desk.0.path().display().to_string()])?;
    let readings = std::fs::read_to_string(desk.0.path().join("run-1-readings.csv"))?;
    // Before the table turned: five to locate the part, four references, Test 1a at 0°.
    let kept = readings.lines().filter(|line| line.contains(",probe,")).count();
    eprintln!("{kept} readings kept");
    if (10..69).contains(&kept) { Ok(()) } else { Err(format!("{kept} readings").into()) }
}

fn joints(rig: &Rig) -> Result<Vec<f64>, Failed> {
    (0..5).map(|joint| rig.joint(joint)).collect()
}
