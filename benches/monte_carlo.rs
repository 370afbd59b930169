//! One million Monte Carlo runs of the self-calibration of a rotary axis (N = 8, φ_b = 45°, 1 µm on
//! each of the 32 differences), each with its circle fit, against numpy at its best on two threads.
//!
//! `cargo bench --bench monte_carlo`. numpy comes into a venv of its own in the target folder.

use std::error::Error;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use estimation::circle_lanes::fit_circles;
use estimation::linear::{LinearProblem, RANK_THRESHOLD, solve};
use estimation::monte_carlo::{BLOCK, LinearPropagation};
use faer::Mat;

const N: usize = 8;
const TRIALS: usize = 1_000_000;
const STEPS: usize = 4;
const U_MM: f64 = 1e-3;
/// Axis position, mm (paper 1, table 4).
const AXIS_MM: [f64; 2] = [3.0e-3, 5.1e-3];
const SCRIPT: &str = include_str!("monte_carlo_numpy.py");

fn main() -> Result<(), Box<dyn Error>> {
    let gain = gain()?;
    let estimate = estimate(gain.nrows());
    let (ours_s, ours) = ours(&gain, &estimate)?;
    println!(
        "trued: {ours_s:.3} s for {TRIALS} trials on {} threads",
        rayon::current_num_threads()
    );
    for (found, exact) in ours.iter().zip(exact(&gain)) {
        check(*found, exact, "covariance")?;
    }
    let numpy = numpy_python().and_then(|python| numpy(&python, &gain, &estimate));
    let (numpy_s, theirs) = match numpy {
        Ok(found) => found,
        Err(why) if std::env::var_os("TRUED_REQUIRE_PEERS").is_none() => {
            println!("numpy: skipped, {why}");
            return Ok(());
        }
        Err(why) => return Err(why),
    };
    for (found, theirs) in ours.iter().zip(&theirs) {
        check(*found, *theirs, "numpy")?;
    }
    println!("numpy: {numpy_s:.3} s");
    println!("ratio: {:.1}", numpy_s / ours_s);
    Ok(())
}

/// Best of five: seconds, and the standard deviations (mm) of 26 unknowns, centre and radius.
fn ours(gain: &Mat<f64>, estimate: &[f64]) -> Result<(f64, Vec<f64>), Box<dyn Error>> {
    let sigma = vec![U_MM; gain.ncols()];
    let propagation = LinearPropagation::new(gain.as_ref(), &sigma, estimate)?;
    let origin = [0.0; BLOCK];
    let circle = |x: &[f64], out: &mut [f64]| {
        let column = |j: usize| &x[j * BLOCK..][..BLOCK];
        let points = |first: usize| -> [&[f64]; N] {
            std::array::from_fn(|i| if i == 0 { &origin[..] } else { column(first + i - 1) })
        };
        let (cx, rest) = out.split_at_mut(BLOCK);
        let (cy, radius) = rest.split_at_mut(BLOCK);
        fit_circles(&points(0), &points(N - 1), STEPS, [cx, cy, radius]);
    };
    let mut best = f64::INFINITY;
    let mut deviations = Vec::new();
    for _ in 0..5 {
        let start = Instant::now();
        let moments = propagation.run(TRIALS, 1, 3, circle);
        best = best.min(start.elapsed().as_secs_f64());
        deviations = moments.iter().map(|moments| moments.standard_deviation()).collect();
    }
    Ok((best, deviations))
}

fn exact(gain: &Mat<f64>) -> Vec<f64> {
    gain.row_iter().map(|row| U_MM * row.norm_l2()).collect()
}

/// Two standard deviations from a million trials each differ by 0.1 % (the circle's, with their
/// heavier tails, by somewhat more).
fn check(found: f64, other: f64, whose: &str) -> Result<(), String> {
    let off = (found / other - 1.0).abs();
    if off < 6e-3 { Ok(()) } else { Err(format!("{found} against {other} of {whose}")) }
}

/// METHODS section 1 in the paper's form: Tests 1a, 1b, 2, 3, each row less r_1a(0); unknowns
/// E_x(C_1..7), E_y(C_1..7), E_r without 0°, 180° and −90° (equal to 90°), W(θ_1..7).
fn gain() -> Result<Mat<f64>, Box<dyn Error>> {
    let one_a = (0..N).map(|i| (0, i));
    let one_b = (0..N).map(|i| (1, i));
    let two = (0..N).map(|i| (i, 0));
    let three = (0..N).map(|i| ((N - i) % N, i));
    let rows: Vec<_> = one_a.chain(one_b).chain(two).chain(three).collect();
    let fixed = [0, N, 2 * N, 2 * N + 4, 2 * N + 6, 3 * N];
    let kept: Vec<usize> = (0..4 * N).filter(|j| !fixed.contains(j)).collect();
    let a = Mat::from_fn(rows.len(), kept.len(), |i, j| {
        let merged = if kept[j] == 2 * N + 2 { coefficient(rows[i], 2 * N + 6) } else { 0.0 };
        coefficient(rows[i], kept[j]) + merged
    });
    let (y, sigma) = (vec![0.0; rows.len()], vec![U_MM; rows.len()]);
    let problem = LinearProblem {
        a: a.as_ref(),
        y: &y,
        sigma: &sigma,
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    Ok(solve(&problem)?.gain)
}

/// Of r = E(C)·n(φ) + W(φ+C) − E_r(φ), φ and C in steps.
fn coefficient((phi, c): (usize, usize), unknown: usize) -> f64 {
    let angle = phi as f64 * TAU / N as f64;
    match (unknown / N, unknown % N) {
        (0, k) if k == c => angle.cos(),
        (1, k) if k == c => angle.sin(),
        (2, k) if k == phi => -1.0,
        (3, k) if k == (phi + c) % N => 1.0,
        _ => 0.0,
    }
}

/// E_total(C) = (I − R(−C))·axis; everything else 0.
fn estimate(unknowns: usize) -> Vec<f64> {
    let mut x = vec![0.0; unknowns];
    let [cx, cy] = AXIS_MM;
    for i in 1..N {
        let (sin, cos) = (i as f64 * TAU / N as f64).sin_cos();
        x[i - 1] = cx - (cos * cx + sin * cy);
        x[N - 1 + i - 1] = cy - (-sin * cx + cos * cy);
    }
    x
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench-numpy")
}

/// The python of a venv with numpy, made if it is not there.
fn numpy_python() -> Result<PathBuf, Box<dyn Error>> {
    let python = folder().join("bin/python");
    if !python.exists() {
        run(Command::new("python3").args(["-m", "venv"]).arg(folder()))?;
    }
    if run(Command::new(&python).args(["-c", "import numpy"])).is_err() {
        run(Command::new(&python).args(["-m", "pip", "install", "--quiet", "numpy"]))?;
    }
    Ok(python)
}

fn numpy(
    python: &Path,
    gain: &Mat<f64>,
    estimate: &[f64],
) -> Result<(f64, Vec<f64>), Box<dyn Error>> {
    let mut text = String::new();
    for (row, estimate) in gain.row_iter().zip(estimate) {
        write!(text, "{estimate:e}")?;
        for value in row.iter() {
            write!(text, " {:e}", value * U_MM)?;
        }
        text.push('\n');
    }
    let (script, input) = (folder().join("bench.py"), folder().join("gain.txt"));
    std::fs::write(&script, SCRIPT)?;
    std::fs::write(&input, text)?;
    let output = run(Command::new(python)
        .arg(script)
        .args([&input.display().to_string(), &TRIALS.to_string(), &STEPS.to_string()])
        .envs([("OPENBLAS_NUM_THREADS", "1"), ("OMP_NUM_THREADS", "1")]))?;
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

fn run(command: &mut Command) -> Result<String, Box<dyn Error>> {
    let output = command.output().map_err(|error| format!("{command:?}: {error}"))?;
    if output.status.success() {
        Ok(String::from_utf8(output.stdout)?)
    } else {
        Err(format!("{command:?}: {}", String::from_utf8_lossy(&output.stderr)).into())
    }
}
