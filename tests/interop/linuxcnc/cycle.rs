//! The program itself, from one command to a stored estimate, with a running LinuxCNC whose true axes it does not
//! have.

use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;
use machine::record::estimate::Estimate;

use super::desk::{Desk, complaint, result};
use super::rig::{Rig, rig};

/// Location of the true C axis, and the tolerance of a result, µm.
pub const TRUTH_UM: [(&str, f64); 2] = [("EX0C", 50.0), ("EY0C", -30.0)];
const NEAR_UM: f64 = 1.0;

/// Measures a whole cycle.
fn measure(desk: &Desk) -> Result<Estimate, Failed> {
    let started = Instant::now();
    let output = desk.start()?.wait_with_output()?;
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

/// Tests 1a, 1b, 1c, 2, 3 and the references with N = 8: with the part in its original position, and moved by 1 mm.
pub fn finds_the_true_axis_wherever_the_part_stands() -> Result<(), Failed> {
    let rig = rig()?;
    let first = measure(&Desk::for_rig(&rig)?)?;
    rig.make_true("ecc-x", 1.120)?;
    let second = measure(&Desk::for_rig(&rig)?)?;
    near_the_truth(&first)?;
    near_the_truth(&second)?;
    for (symbol, _) in TRUTH_UM {
        let change = result(&second, symbol)?.0 - result(&first, symbol)?.0;
        eprintln!("the part moved by 1 mm: {symbol} changes by {change:.3} um");
        if change.abs() > NEAR_UM {
            return Err(format!("{symbol} follows the part by {change} um").into());
        }
    }
    Ok(())
}

fn near_the_truth(estimate: &Estimate) -> Result<(), Failed> {
    for (symbol, truth) in TRUTH_UM {
        let (value, expanded) = result(estimate, symbol)?;
        let error = (value - truth).abs();
        if error > NEAR_UM || error > expanded || expanded > 2.0 * NEAR_UM {
            return Err(format!("{symbol} = {value} um, U = {expanded} um").into());
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
    desk.is("held")?;
    // Readings before the table turns: five to locate the part, four references, Test 1a at 0°.
    let kept = desk.kept()?;
    eprintln!("{kept} readings kept");
    if (10..69).contains(&kept) { Ok(()) } else { Err(format!("{kept} readings").into()) }
}

/// The communication and the files of a run, and a replay of the run from them. (`tests/peers/linuxcnc/thin.py`
/// reduces such a capture; `tests/data/linuxcnc/` was created this way.)
pub fn a_capture_replays() -> Result<(), Failed> {
    let rig = rig()?;
    let desk = Desk::in_a_hurry(&rig)?;
    let machine = desk.machine();
    let capture = machine.with_file_name("a.capture").display().to_string();
    let machine = machine.display().to_string();
    let run = |how: &str| -> Result<Estimate, Failed> {
        let said = ["run", "self-calibration", "--json", "--machine", &machine, how, &capture];
        Ok(serde_json::from_str(&desk.said(&said)?)?)
    };
    let (measured, touches) = (run("--capture")?, rig.touches()?);
    let replayed = run("--replay")?;
    if rig.touches()? != touches {
        return Err("the replay moved the machine".into());
    }
    for parameter in &measured.parameters {
        let (again, _) = result(&replayed, &parameter.symbol)?;
        if (again - parameter.value).abs() > 1e-4 {
            return Err(format!("{} was {}, is {again}", parameter.symbol, parameter.value).into());
        }
    }
    Ok(())
}

fn joints(rig: &Rig) -> Result<Vec<f64>, Failed> {
    (0..5).map(|joint| rig.joint(joint)).collect()
}
