//! The default self-calibration with a million Monte Carlo trials, from readings to estimate as in a run, compared
//! with vectorised numpy on two threads, which computes the trials alone.
//!
//! `cargo bench --bench monte_carlo`. numpy is installed into a separate venv in the target folder.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use faer::Mat;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use methods::identification::{DrawDistribution, ObservationEffect, UncertaintySource};
use methods::self_calibration::{FitWithSensitivity, FittedRun, SecondOrderCorrection, SelfCalibration};
use methods::{Method, RegisteredMethod};
use serde_json::{Value, json};
use trued::setup::{self, MachineFile};

#[path = "../tests/support/plan_player.rs"]
mod plan_player;

const MONTE_CARLO_TRIALS: usize = 1_000_000;
/// Minimum ratio of the time of numpy to the time of `trued`.
const MIN_SPEEDUP_OVER_NUMPY: f64 = 3.0;
const NUMPY_SCRIPT: &str = include_str!("monte_carlo_numpy.py");

fn main() -> Result<(), Box<dyn Error>> {
    let (method, plan, readings) = measure_built_in_machine()?;
    let (ours_s, estimate) = time_identification(&method, &plan, &readings)?;
    println!("trued: {ours_s:.3} s for {MONTE_CARLO_TRIALS} trials on {} threads", rayon::current_num_threads());
    let problem = trial_input_json(&method.fit_without_estimate(&plan, &readings)?);
    let (numpy_s, theirs) = match numpy_python().and_then(|python| time_numpy_trials(&python, &problem)) {
        Ok(found) => found,
        Err(why) if std::env::var_os("TRUED_REQUIRE_PEERS").is_none() => {
            println!("numpy: skipped, {why}");
            return Ok(());
        }
        Err(why) => return Err(why),
    };
    for (parameter, theirs_mm) in estimate.parameters.iter().zip(&theirs) {
        let by_trials = parameter.u_monte_carlo.ok_or("no trials")?;
        let theirs = parameter.unit.to_reported_value(*theirs_mm);
        println!("{}: u {:.5}, {by_trials:.5}, numpy {theirs:.5}", parameter.symbol, parameter.u);
        // Two standard deviations from a million trials each differ by 0.1 %.
        if (by_trials / theirs - 1.0).abs() > 6e-3 {
            return Err(format!("{}: {by_trials} against {theirs}", parameter.symbol).into());
        }
    }
    println!("numpy: {numpy_s:.3} s");
    let ratio = numpy_s / ours_s;
    println!("ratio: {ratio:.1}");
    if ratio < MIN_SPEEDUP_OVER_NUMPY {
        return Err(format!("less than {MIN_SPEEDUP_OVER_NUMPY} times as fast as numpy").into());
    }
    Ok(())
}

/// The readings of the built-in machine's default run.
fn measure_built_in_machine() -> Result<(SelfCalibration, Plan, Vec<Reading>), Box<dyn Error>> {
    let settings = format!("\n[method.self-calibration]\nmonte_carlo_trials = {MONTE_CARLO_TRIALS}\n");
    let text = include_str!("../config/simulated.toml").to_owned() + &settings;
    let file = MachineFile::parse("simulated.toml", text)?;
    let (method, plan) = setup::configure_method_and_plan_without_steps(&file, "self-calibration", None)?;
    let own = SelfCalibration::new(serde_json::from_value(method.settings())?);
    let (plan, readings) = plan_player::measure_all_stages(&mut setup::build_world(&file)?, method.as_ref(), plan);
    Ok((own, plan, readings))
}

/// Best of nine runs: seconds, and the estimate.
fn time_identification(
    method: &SelfCalibration,
    plan: &Plan,
    readings: &[Reading],
) -> Result<(f64, Estimate), Box<dyn Error>> {
    let (mut best, mut estimate) = (f64::INFINITY, method.identify(plan, readings)?);
    for _ in 0..9 {
        let start = Instant::now();
        estimate = method.identify(plan, readings)?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok((best, estimate))
}

/// Input of the trials, in the format of the script.
fn trial_input_json(fitted: &FittedRun) -> Value {
    let fit = &fitted.fit;
    let unknowns = fit.x.len();
    json!({
        "trials": MONTE_CARLO_TRIALS,
        "sensitivity": matrix_rows(&FitWithSensitivity::new(fit).sensitivity),
        "gain": matrix_rows(&fit.solution.gain),
        "x": fit.x,
        "radii": fit.observations.iter().map(|seen| seen.along_ray_mm).collect::<Vec<_>>(),
        "slopes": matrix_rows(&fitted.outputs.linear_parameter_slopes(unknowns)),
        "sources": fitted.sources.iter().map(source_json).collect::<Vec<_>>(),
        "bend": fit.second_order.as_ref().map(second_order_json),
    })
}

fn source_json(source: &UncertaintySource) -> Value {
    let is_normal = source.draw_distribution == DrawDistribution::Normal;
    match &source.effect {
        ObservationEffect::Independent(sizes) => json!({"normal": is_normal, "each": sizes}),
        ObservationEffect::Joint(columns) => json!({"normal": is_normal, "joint": columns}),
        ObservationEffect::Spans(_) => panic!("self-calibration has no source of spans"),
    }
}

fn second_order_json(bend: &SecondOrderCorrection) -> Value {
    let contacts = bend.contacts.iter();
    let contacts = contacts.map(|contact| {
        json!([
            contact.height_index,
            contact.normal.x,
            contact.normal.y,
            contact.ex_index,
            contact.ey_index,
            contact.theta_index,
            contact.across_ray_mm
        ])
    });
    let heights = bend.heights.iter();
    let heights = heights.map(|height| json!({"radius": height.radius_index, "forms": matrix_rows(&height.forms)}));
    json!({"contacts": contacts.collect::<Vec<_>>(), "heights": heights.collect::<Vec<_>>()})
}

fn matrix_rows(matrix: &Mat<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

fn numpy_folder() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench-numpy")
}

/// The python of a venv with numpy; the venv is created if it does not exist.
fn numpy_python() -> Result<PathBuf, Box<dyn Error>> {
    let python = numpy_folder().join("bin/python");
    if !python.exists() {
        run_and_read_stdout(Command::new("python3").args(["-m", "venv"]).arg(numpy_folder()))?;
    }
    if run_and_read_stdout(Command::new(&python).args(["-c", "import numpy"])).is_err() {
        run_and_read_stdout(Command::new(&python).args(["-m", "pip", "install", "--quiet", "numpy"]))?;
    }
    Ok(python)
}

/// Seconds that numpy takes for the trials, and the standard deviations of the parameters, mm and rad.
fn time_numpy_trials(python: &Path, problem: &Value) -> Result<(f64, Vec<f64>), Box<dyn Error>> {
    let (script, input) = (numpy_folder().join("bench.py"), numpy_folder().join("problem.json"));
    std::fs::write(&script, NUMPY_SCRIPT)?;
    std::fs::write(&input, problem.to_string())?;
    let output = run_and_read_stdout(
        Command::new(python).args([&script, &input]).envs([("OPENBLAS_NUM_THREADS", "1"), ("OMP_NUM_THREADS", "1")]),
    )?;
    let mut numbers = Vec::new();
    for line in output.lines() {
        match line.strip_prefix('#') {
            Some(comment) => println!("numpy:{comment}"),
            None => numbers.push(line.trim().parse::<f64>()?),
        }
    }
    let (seconds, deviations) = numbers.split_first().ok_or("the script printed nothing")?;
    Ok((*seconds, deviations.to_vec()))
}

fn run_and_read_stdout(command: &mut Command) -> Result<String, Box<dyn Error>> {
    let output = command.output().map_err(|error| format!("{command:?}: {error}"))?;
    if output.status.success() {
        Ok(String::from_utf8(output.stdout)?)
    } else {
        Err(format!("{command:?}: {}", String::from_utf8_lossy(&output.stderr)).into())
    }
}
