//! One solution of 613 ball measurements (32 balls of the dome, 24 indexations, thirteen machine errors, the
//! stylus), compared with `scipy.optimize.least_squares(method="lm")` with the analytic Jacobian, vectorised, on
//! the same data; and 10 000 repeated solutions for Monte Carlo.
//!
//! `cargo bench --bench samba`. scipy is installed into a separate venv in the target folder.

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use estimation::nonlinear_least_squares::NonlinearSolution;
use estimation::random;
use machine::kinematics::{ErrorTerm, KinematicChain};
use machine::record::machine::Machine;
use machine::{Axis, Position, frame::Point};
use methods::samba::{
    GeometryEquations, GeometryModel, GeometryProblem, LengthConstraint, NonlinearFit, ObservedValues,
    PlannedBallMeasurement,
};
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

mod peer;

use peer::{run_and_read_numbers, scipy_folder, scipy_python};

const B_ANGLES_DEG: [f64; 6] = [0.0, 30.0, -30.0, 60.0, -60.0, 85.0];
const NOISE_STD_MM: f64 = 1e-3;
const BAR_STD_U_MM: f64 = 1e-4;
const MEASUREMENT_COUNT: usize = 613;
const MONTE_CARLO_TRIALS: usize = 10_000;
/// Minimum ratio of the time of scipy to the time of `trued`, for one solution.
const MIN_SPEEDUP_OVER_SCIPY: f64 = 20.0;
/// Maximum time of all repeated solutions together, s.
const MAX_TOTAL_TRIAL_TIME_S: f64 = 5.0;
const TRUE_TOOL_TIP_MM: Vector3<f64> = Vector3::new(-0.012, -0.012, -326.746);
const NOMINAL_TOOL_TIP_MM: Vector3<f64> = Vector3::new(0.0, 0.0, -326.717);
const SCIPY_SCRIPT: &str = include_str!("samba_scipy.py");

/// Errors of the simulated machine, mm and rad: paper 4, table 2.
const TRUE_MACHINE_ERRORS: [(&str, f64); 13] = [
    ("EA0B", -11e-6),
    ("EC0B", -8e-6),
    ("EX0C", -0.105),
    ("EA0C", -11e-6),
    ("EB0C", -8e-6),
    ("EB0Z", -13e-6),
    ("EA0Y", -18e-6),
    ("EC0Y", 21e-6),
    ("EY0S", 0.020),
    ("EX0S", -0.106),
    ("EXX1", -16e-6),
    ("EYY1", 11e-6),
    ("EZZ1", 21e-6),
];

struct SimulatedMeasurements {
    problem: GeometryProblem,
    observed_values: ObservedValues,
    /// For each measurement: B, C, S (rad), X, Y, Z (mm); index of the ball.
    measurement_rows: Vec<([f64; 6], usize)>,
    ball_count: usize,
}

fn main() -> Result<(), Box<dyn Error>> {
    let data = simulate_measurements()?;
    let (ours_s, NonlinearSolution { x: ours, jacobian_evaluation_count: factors, .. }) = time_solve(&data)?;
    println!("trued: {:.3} ms for one solve of {} unknowns with {factors} Jacobians", ours_s * 1e3, ours.len());
    let trials_s = time_repeated_solves(&data)?;
    println!("trued: {trials_s:.2} s for {MONTE_CARLO_TRIALS} re-solves on {} threads", rayon::current_num_threads());
    if trials_s > MAX_TOTAL_TRIAL_TIME_S {
        return Err(format!("the re-solves take more than {MAX_TOTAL_TRIAL_TIME_S} s").into());
    }
    let scipy = scipy_python().and_then(|python| time_scipy_solve(&python, &data));
    let (scipy_s, theirs) = match scipy {
        Ok(found) => found,
        Err(why) if std::env::var_os("TRUED_REQUIRE_PEERS").is_none() => {
            println!("scipy: skipped, {why}");
            return Ok(());
        }
        Err(why) => return Err(why),
    };
    for (j, (found, theirs)) in ours.iter().zip(&theirs).enumerate() {
        // 1 nm or 1 nrad: a thousandth of the noise.
        if (found - theirs).abs() > 1e-6 {
            return Err(format!("unknown {j}: {found} against {theirs} of scipy").into());
        }
    }
    println!("scipy: {:.1} ms", scipy_s * 1e3);
    let ratio = scipy_s / ours_s;
    println!("ratio: {ratio:.1}");
    if ratio < MIN_SPEEDUP_OVER_SCIPY {
        return Err(format!("less than {MIN_SPEEDUP_OVER_SCIPY} times as fast as scipy").into());
    }
    Ok(())
}

/// Best of twenty runs: seconds, and the solution.
fn time_solve(data: &SimulatedMeasurements) -> Result<(f64, NonlinearSolution), Box<dyn Error>> {
    let solve = || data.problem.solve(&data.observed_values, data.problem.initial_values(&data.observed_values));
    let (mut best, minimum) = (f64::INFINITY, solve()?);
    for _ in 0..20 {
        let start = Instant::now();
        solve()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok((best, minimum))
}

/// Seconds for the repeated solutions; checks also that their scatter equals the covariance.
fn time_repeated_solves(data: &SimulatedMeasurements) -> Result<f64, Box<dyn Error>> {
    let SimulatedMeasurements { problem, observed_values: measured, .. } = data;
    let minimum = problem.solve(measured, problem.initial_values(measured))?;
    let model = NonlinearFit { equation: &GeometryEquations { problem, measured }, minimum: &minimum };
    let start = Instant::now();
    let squares: f64 = (0..MONTE_CARLO_TRIALS)
        .into_par_iter()
        .map(|trial| {
            let mut normal = StandardNormal.sample_iter(random::seeded_stream(trial as u64, &[2]));
            let mut next = |size: f64| {
                let unit: f64 = normal.next().unwrap_or_default();
                unit * size
            };
            let centres = 3 * measured.centre_axes_mm.len();
            let mut change: Vec<f64> = (0..centres).map(|_| next(NOISE_STD_MM)).collect();
            change.extend(measured.lengths_mm.iter().map(|_| next(BAR_STD_U_MM)));
            (model.unknowns_for_changed_observations(&change)[0] - minimum.x[0]).powi(2)
        })
        .sum();
    let seconds = start.elapsed().as_secs_f64();
    let ratio = (squares / MONTE_CARLO_TRIALS as f64 / minimum.factorisation.covariance()[(0, 0)]).sqrt();
    if (ratio - 1.0).abs() > 0.03 {
        return Err(format!("the trials scatter {ratio} times what the covariance says").into());
    }
    Ok(seconds)
}

/// Simulates a measurement of the highest balls of the dome at 24 indexations on the machine of paper 4.
fn simulate_measurements() -> Result<SimulatedMeasurements, Box<dyn Error>> {
    let machine: Machine = serde_json::from_str(
        r#"{"name":"paper 4","topology":"w-C-B-X-F-Z-Y-S-t","axes":{
            "X":{"min":-900,"max":900},"Y":{"min":-900,"max":900},"Z":{"min":-900,"max":900},
            "B":{"min":-120,"max":120},"C":{"min":-360,"max":360},"S":{"min":-360,"max":360}}}"#,
    )?;
    let terms: Vec<ErrorTerm> = TRUE_MACHINE_ERRORS
        .iter()
        .map(|(name, value)| Ok(ErrorTerm { parameter: name.parse()?, value: *value }))
        .collect::<Result<_, Box<dyn Error>>>()?;
    let (chain, balls) = (KinematicChain::new(&machine)?, read_ball_centres()?);
    let mut normal = StandardNormal.sample_iter(random::seeded_stream(1, &[1]));
    let mut next = || -> f64 { normal.next().unwrap_or_default() };
    let (mut places, mut seen, mut table) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..24_usize {
        let angles = [B_ANGLES_DEG[k / 4], (k % 4) as f64 * 90.0, ((k + k / 4) % 4) as f64 * 90.0].map(f64::to_radians);
        let place: Position = [Axis::B, Axis::C, Axis::S].into_iter().zip(angles).collect();
        let mut stands = Vec::new();
        for (ball, centre) in balls.iter().enumerate() {
            let (target, tip) = (Point::from_vec(*centre), Point::from_vec(TRUE_TOOL_TIP_MM));
            let linear = chain.solve_linear_axes(target, tip, &place, &terms)?;
            stands.push((ball, linear.xyz_or_zero()));
        }
        stands.sort_by(|a, b| b.1[2].total_cmp(&a.1[2]));
        stands.truncate(MEASUREMENT_COUNT / 24 + usize::from(k < MEASUREMENT_COUNT % 24));
        for (ball, xyz) in stands {
            let xyz = xyz.map(|value| value + next() * NOISE_STD_MM);
            seen.push(PlannedBallMeasurement {
                rotary_position_index: k,
                ball_index: ball,
                whitening: Matrix3::identity() / NOISE_STD_MM,
            });
            table.push(([angles[0], angles[1], angles[2], xyz[0], xyz[1], xyz[2]], ball));
        }
        places.push(place);
    }
    let parameters: Vec<_> = terms.iter().map(|term| term.parameter).collect();
    let model = GeometryModel::new(&machine, &parameters)?;
    let bars = vec![LengthConstraint { from_ball: 0, to_ball: 7, u_mm: BAR_STD_U_MM }];
    let measured = ObservedValues {
        centre_axes_mm: table.iter().map(|(row, _)| Vector3::new(row[3], row[4], row[5])).collect(),
        lengths_mm: vec![balls[0].metric_distance(&balls[7])],
    };
    let problem = GeometryProblem::new(model, places, seen, bars, balls.len(), NOMINAL_TOOL_TIP_MM);
    Ok(SimulatedMeasurements { problem, observed_values: measured, measurement_rows: table, ball_count: balls.len() })
}

/// Ball centres of the dome, mm: paper 4, table 3.
fn read_ball_centres() -> Result<Vec<Vector3<f64>>, Box<dyn Error>> {
    let text = include_str!("../tests/data/paper4-table3.csv");
    let lines = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    lines
        .map(|line| {
            let numbers: Vec<f64> = line.split(',').map(str::parse).collect::<Result<_, _>>()?;
            Ok(Vector3::from_column_slice(&numbers[1..4]))
        })
        .collect()
}

/// Seconds of scipy, and its unknowns in our order; BLAS on one thread or on all, whichever is faster.
fn time_scipy_solve(python: &Path, data: &SimulatedMeasurements) -> Result<(f64, Vec<f64>), Box<dyn Error>> {
    let mut text = String::new();
    writeln!(text, "{:?} {BAR_STD_U_MM:e} {NOISE_STD_MM:e} {}", data.observed_values.lengths_mm[0], data.ball_count)?;
    for (row, ball) in &data.measurement_rows {
        for value in row {
            write!(text, "{value:?} ")?;
        }
        writeln!(text, "{ball}")?;
    }
    let (script, input) = (scipy_folder().join("bench.py"), scipy_folder().join("data.txt"));
    std::fs::write(&script, SCIPY_SCRIPT)?;
    std::fs::write(&input, text)?;
    let command = || {
        let mut command = Command::new(python);
        command.arg(&script).arg(&input);
        command
    };
    let one = run_and_read_numbers(command().env("OPENBLAS_NUM_THREADS", "1"))?;
    let all = run_and_read_numbers(&mut command())?;
    let numbers = if one[0] < all[0] { one } else { all };
    let (seconds, theirs) = numbers.split_first().ok_or("the script printed nothing")?;
    let mut x = vec![0.0; theirs.len()];
    let common = x.len() - 3 * data.ball_count;
    x[..common].copy_from_slice(&theirs[..common]);
    for ball in 0..data.ball_count {
        let at = data.problem.ball_unknown_index(ball);
        x[at..at + 3].copy_from_slice(&theirs[common + 3 * ball..][..3]);
    }
    Ok((*seconds, x))
}
