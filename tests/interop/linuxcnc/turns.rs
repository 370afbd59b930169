//! `trued run multiprobe` on LinuxCNC: C turns at constant speed, the sampler reports its position, three sensors
//! report on separate serial ports.

use std::process::Output;

use libtest_mimic::Failed;
use machine::record::estimate::Estimate;

use super::desk::{RunWorkspace, failure_text, value_and_u};
use super::faults::wait_until;
use super::resume::release_emergency_stop;
use super::rig::{halcmd, lock_rig};
use super::streams::StreamsProcess;

/// Error motions of C, order, cosine and sine along X and along Y, µm: the rig's pins.
const TRUE_ERROR_MOTIONS: [(u32, [f64; 4]); 7] = [
    (2, [1.2, -0.4, 0.3, 0.9]),
    (3, [-0.5, 0.6, 0.8, 0.2]),
    (4, [0.7, 0.3, -0.6, 0.4]),
    (5, [0.3, 0.2, -0.2, 0.5]),
    (6, [-0.4, 0.1, 0.2, -0.3]),
    (7, [0.2, -0.3, 0.4, 0.1]),
    (8, [0.3, 0.2, -0.1, 0.4]),
];
/// Form of the cylinder: order, cosine and sine, µm.
const TRUE_FORM: [(u32, [f64; 2]); 4] = [(2, [2.0, 1.0]), (3, [-1.5, 0.5]), (5, [0.8, -0.6]), (8, [0.5, 0.4])];
/// Tolerance of a coefficient, µm.
const HARMONIC_TOLERANCE_UM: f64 = 0.1;

fn set_pin_um(pin: &str, um: f64) -> Result<(), Failed> {
    halcmd(&["setp", &format!("datum.{pin}"), &format!("{:.9}", um * 1e-3)]).map(drop)
}

fn place_cylinder() -> Result<(), Failed> {
    set_pin_um("ecc-x", 6.0)?;
    set_pin_um("ecc-y", -8.0)?;
    for (order, [xc, xs, yc, ys]) in TRUE_ERROR_MOTIONS {
        for (name, um) in [("xc", xc), ("xs", xs), ("yc", yc), ("ys", ys)] {
            set_pin_um(&format!("motion-{name}-{order}"), um)?;
        }
    }
    for (order, [c, s]) in TRUE_FORM {
        set_pin_um(&format!("form-c-{order}"), c)?;
        set_pin_um(&format!("form-s-{order}"), s)?;
    }
    Ok(())
}

/// Checks each coefficient against its true value.
fn check_motions(output: &Output) -> Result<(), Failed> {
    eprintln!("{}", failure_text(output));
    if output.status.code() != Some(0) {
        return Err(failure_text(output).into());
    }
    let estimate: Estimate = serde_json::from_slice(&output.stdout)?;
    let mut off = Vec::new();
    for (order, [xc, xs, yc, ys]) in TRUE_ERROR_MOTIONS {
        let all = [("EXC_c", xc), ("EXC_s", xs), ("EYC_c", yc), ("EYC_s", ys)];
        for (symbol, truth) in all {
            let symbol = format!("{symbol}{order}");
            let (value, expanded) = value_and_u(&estimate, &symbol)?;
            eprintln!("{symbol} {value:.3} ± {expanded:.3}, truly {truth}");
            if (value - truth).abs() > HARMONIC_TOLERANCE_UM {
                off.push(format!("{symbol} {value:.3} ± {expanded:.3}, truly {truth}"));
            }
        }
    }
    if off.is_empty() { Ok(()) } else { Err(off.join("; ").into()) }
}

pub fn turns_find_the_true_error_motions() -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_cylinder()?;
    let streams = StreamsProcess::start(&rig)?;
    let desk = RunWorkspace::with_sensors(&rig, &streams)?;
    check_motions(&desk.start_run("multiprobe")?.wait_with_output()?)
}

/// An emergency stop during the forward turn: the data of that turn are discarded, all earlier data are kept, and
/// the resumed run has the same result.
pub fn stop_within_a_turn_loses_only_that_turn() -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_cylinder()?;
    let streams = StreamsProcess::start(&rig)?;
    let desk = RunWorkspace::with_sensors(&rig, &streams)?;
    let mut run = desk.start_run("multiprobe")?;
    // The turn for centring, the reference from its beginning to 90° further, the forward turn.
    wait_until(|rig| Ok(rig.joint_position(4)? > 300.0), &rig, &mut run)?;
    wait_until(|rig| Ok(rig.joint_position(4)? < 10.0), &rig, &mut run)?;
    wait_until(|rig| Ok(rig.joint_position(4)? > 180.0), &rig, &mut run)?;
    rig.emergency_stop()?;
    let output = run.wait_with_output()?;
    let said = failure_text(&output);
    eprintln!("{said}");
    if output.status.code() != Some(5) || !said.contains("the emergency stop was pressed") {
        return Err(said.into());
    }
    let stands = rig.joint_position(4)?;
    if !(180.0..300.0).contains(&stands) {
        return Err(format!("C stands at {stands}").into());
    }
    let (turns, before) = (desk.reading_count("index/1")?, desk.reading_count("reference/1")?);
    if turns != 0 || before == 0 {
        return Err(format!("{turns} readings of the turn and {before} before it are kept").into());
    }
    release_emergency_stop(&rig)?;
    check_motions(&desk.start_resume()?.wait_with_output()?)?;
    desk.check_state("finished")
}
