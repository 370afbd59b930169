//! `trued run multiprobe` on LinuxCNC: C turns at constant speed, the sampler reports its position, three sensors
//! report on separate serial ports.

use std::process::Output;

use libtest_mimic::Failed;
use machine::record::estimate::Estimate;

use super::data_streams::StreamsProcess;
use super::faults::wait_until;
use super::resume::release_stop_and_switch_machine_on;
use super::rig::{halcmd, lock_rig};
use super::run_workspace::{RunWorkspace, failure_text, value_and_expanded_u};

/// Error motions of C, order, cosine and sine along X and along Y, µm: the rig's pins.
const TRUE_ERROR_MOTION_HARMONICS: [(u32, [f64; 4]); 7] = [
    (2, [1.2, -0.4, 0.3, 0.9]),
    (3, [-0.5, 0.6, 0.8, 0.2]),
    (4, [0.7, 0.3, -0.6, 0.4]),
    (5, [0.3, 0.2, -0.2, 0.5]),
    (6, [-0.4, 0.1, 0.2, -0.3]),
    (7, [0.2, -0.3, 0.4, 0.1]),
    (8, [0.3, 0.2, -0.1, 0.4]),
];
/// Form of the cylinder: order, cosine and sine, µm.
const TRUE_CYLINDER_FORM_HARMONICS: [(u32, [f64; 2]); 4] =
    [(2, [2.0, 1.0]), (3, [-1.5, 0.5]), (5, [0.8, -0.6]), (8, [0.5, 0.4])];
/// Tolerance of a coefficient, µm.
const HARMONIC_TOLERANCE_UM: f64 = 0.1;

fn set_datum_pin_um(pin: &str, um: f64) -> Result<(), Failed> {
    halcmd(&["setp", &format!("datum.{pin}"), &format!("{:.9}", um * 1e-3)]).map(drop)
}

fn set_true_cylinder_and_error_motions() -> Result<(), Failed> {
    set_datum_pin_um("ecc-x", 6.0)?;
    set_datum_pin_um("ecc-y", -8.0)?;
    for (order, [xc, xs, yc, ys]) in TRUE_ERROR_MOTION_HARMONICS {
        for (name, um) in [("xc", xc), ("xs", xs), ("yc", yc), ("ys", ys)] {
            set_datum_pin_um(&format!("motion-{name}-{order}"), um)?;
        }
    }
    for (order, [c, s]) in TRUE_CYLINDER_FORM_HARMONICS {
        set_datum_pin_um(&format!("form-c-{order}"), c)?;
        set_datum_pin_um(&format!("form-s-{order}"), s)?;
    }
    Ok(())
}

/// Checks each coefficient against its true value.
fn check_estimated_error_motions(output: &Output) -> Result<(), Failed> {
    eprintln!("{}", failure_text(output));
    if output.status.code() != Some(0) {
        return Err(failure_text(output).into());
    }
    let estimate: Estimate = serde_json::from_slice(&output.stdout)?;
    let mut off = Vec::new();
    for (order, [xc, xs, yc, ys]) in TRUE_ERROR_MOTION_HARMONICS {
        let all = [("EXC_c", xc), ("EXC_s", xs), ("EYC_c", yc), ("EYC_s", ys)];
        for (symbol, truth) in all {
            let symbol = format!("{symbol}{order}");
            let (value, expanded) = value_and_expanded_u(&estimate, &symbol)?;
            eprintln!("{symbol} {value:.3} ± {expanded:.3}, truly {truth}");
            if (value - truth).abs() > HARMONIC_TOLERANCE_UM {
                off.push(format!("{symbol} {value:.3} ± {expanded:.3}, truly {truth}"));
            }
        }
    }
    if off.is_empty() { Ok(()) } else { Err(off.join("; ").into()) }
}

pub fn multiprobe_finds_the_true_error_motions() -> Result<(), Failed> {
    let rig = lock_rig()?;
    set_true_cylinder_and_error_motions()?;
    let streams = StreamsProcess::start(&rig)?;
    let workspace = RunWorkspace::with_multiprobe_sensors(&rig, &streams)?;
    check_estimated_error_motions(&workspace.start_run("multiprobe")?.wait_with_output()?)
}

/// An emergency stop during the forward turn: the data of that turn are discarded, all earlier data are kept, and
/// the resumed run has the same result.
pub fn emergency_stop_within_a_turn_loses_only_that_turn() -> Result<(), Failed> {
    let rig = lock_rig()?;
    set_true_cylinder_and_error_motions()?;
    let streams = StreamsProcess::start(&rig)?;
    let workspace = RunWorkspace::with_multiprobe_sensors(&rig, &streams)?;
    let mut run = workspace.start_run("multiprobe")?;
    // The turn for centring, the reference from its beginning to 90° further, the forward turn.
    wait_until(|rig| Ok(rig.joint_position(4)? > 300.0), &rig, &mut run)?;
    wait_until(|rig| Ok(rig.joint_position(4)? < 10.0), &rig, &mut run)?;
    wait_until(|rig| Ok(rig.joint_position(4)? > 180.0), &rig, &mut run)?;
    rig.press_emergency_stop()?;
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
    let (turns, before) = (
        workspace.first_run_reading_count_of_label_prefix("index/1")?,
        workspace.first_run_reading_count_of_label_prefix("reference/1")?,
    );
    if turns != 0 || before == 0 {
        return Err(format!("{turns} readings of the turn and {before} before it are kept").into());
    }
    release_stop_and_switch_machine_on(&rig)?;
    check_estimated_error_motions(&workspace.start_resume_of_first_run()?.wait_with_output()?)?;
    workspace.check_last_run_state("finished")
}
