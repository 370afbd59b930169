//! Multiprobe with eight sensors at 10 kHz over 60 s of continuous rotation. The filtering to equal angles, as in a
//! run, is compared with the same filter in numpy; then follows the identification from these readings, Monte Carlo
//! included (JCGM 101 sets the number of trials).
//!
//! `cargo bench --bench multiprobe`. numpy is installed into a separate venv in the target folder.

use std::error::Error;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use estimation::random;
use estimation::revolutions::{
    AngleSample, ResampleFilter, ResampledChannel, Resampler, common_and_rejected_revolutions,
};
use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};
use methods::Method;
use rand_distr::{Distribution, StandardNormal};
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

mod peer;

use peer::{run_and_read_numbers, scipy_folder, scipy_python};

/// Number of equal angles in one revolution.
const POSITIONS_PER_REVOLUTION: usize = 360;
/// Number of revolutions at each of the two mountings: 30 s at 120°/s.
const REVOLUTIONS_PER_MOUNTING: i64 = 10;
const SAMPLE_RATE_HZ: f64 = 1e4;
const FEED_DEG_MIN: f64 = 7200.0;
const NOISE_STD_MM: f64 = 5e-5;
const MAX_IDENTIFICATION_S: f64 = 1.0;
/// Maximum difference of the resampled values from those of numpy, which interpolates the same kernel, mm.
const MAX_NUMPY_DIFFERENCE_MM: f64 = 1e-10;
const NUMPY_SCRIPT: &str = include_str!("multiprobe_numpy.py");

/// Samples of one sensor in one rotation step of the plan.
struct RotationSamples<'a> {
    step: &'a Step,
    /// Index of the sensor in the plan.
    channel_index: usize,
    /// Index of the mounting of the artefact on its stage.
    mounting_index: usize,
    samples: Vec<AngleSample>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let file = eight_sensor_machine_file()?;
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, "multiprobe", None)?;
    let (plan, _) = methods::plan_nominal_stages(method.as_ref(), header)?;
    let turns = simulate_rotations(&plan);
    let samples: usize = turns.iter().map(|turn| turn.samples.len()).sum();
    let channels = plan.sensors.len();
    println!("{channels} channels, {} samples each", samples / channels);

    let filter = ResampleFilter::new(POSITIONS_PER_REVOLUTION);
    let start = Instant::now();
    let all: Vec<ResampledChannel> = turns.iter().map(|turn| resample_rotation(&filter, turn)).collect();
    let resampling_s = start.elapsed().as_secs_f64();
    println!("trued: {resampling_s:.3} s to filter");
    let kept = turns.iter().zip(&all).flat_map(|(turn, of)| rotation_readings(&plan, turn, of));
    let kept: Vec<Reading> = kept.collect();
    println!("{} readings of {samples} samples", kept.len());

    let (seconds, estimate) = time_identification(method.as_ref(), &plan, &kept)?;
    println!("trued: {seconds:.3} s to identify {} parameters", estimate.parameters.len());
    if seconds > MAX_IDENTIFICATION_S {
        return Err(format!("the identification takes more than {MAX_IDENTIFICATION_S} s").into());
    }
    match scipy_python().and_then(|python| time_numpy_resampling(&python, &turns)) {
        Ok((numpy_s, theirs)) => {
            println!("numpy: {numpy_s:.3} s to filter, ratio {:.1}", numpy_s / resampling_s);
            check_against_numpy(&all, &theirs)
        }
        Err(why) if std::env::var_os("TRUED_REQUIRE_PEERS").is_none() => {
            println!("numpy: skipped, {why}");
            Ok(())
        }
        Err(why) => Err(why),
    }
}

fn resample_rotation(filter: &ResampleFilter, turn: &RotationSamples) -> ResampledChannel {
    let ends_rad = [&turn.step.from, &turn.step.to].map(|end| end.get_or_zero(Axis::C));
    Resampler::resample_scan(filter, ends_rad, &turn.samples)
}

/// Best of three runs: seconds, and the estimate.
fn time_identification(
    method: &dyn Method,
    plan: &Plan,
    readings: &[Reading],
) -> Result<(f64, Estimate), Box<dyn Error>> {
    let (mut best, mut last) = (f64::INFINITY, None);
    for _ in 0..3 {
        let start = Instant::now();
        last = Some(method.identify(plan, readings)?);
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok((best, last.ok_or("no estimate")?))
}

/// The built-in machine with an eighth sensor, fast turns and two mountings.
fn eight_sensor_machine_file() -> Result<MachineFile, Box<dyn Error>> {
    let mut table: Table = include_str!("../config/multiprobe.toml").parse()?;
    let sensors = table["sensor"].as_array_mut().ok_or("no sensors")?;
    let mut eighth = sensors[0].as_table().ok_or("no sensor")?.clone();
    let (sin, cos) = 150f64.to_radians().sin_cos();
    eighth.insert("name".to_owned(), "s1".into());
    eighth.insert("zero_mm".to_owned(), vec![30.0 * cos, 30.0 * sin, 60.0].into());
    eighth.insert("direction".to_owned(), vec![-cos, -sin, 0.0].into());
    sensors.push(eighth.into());
    let limits = table["axes"]["C"].as_table_mut().ok_or("no axis C")?;
    limits.insert("min".to_owned(), (-60.0).into());
    limits.insert("max".to_owned(), 3700.0.into());
    let settings = table["method"]["multiprobe"].as_table_mut().ok_or("no settings")?;
    let changes: [(&str, Value); 8] = [
        ("indexes", 2.into()),
        ("revolutions", REVOLUTIONS_PER_MOUNTING.into()),
        ("both_directions", false.into()),
        ("positions", (POSITIONS_PER_REVOLUTION as i64).into()),
        ("sampling", "continuous".into()),
        ("rate_hz", SAMPLE_RATE_HZ.into()),
        ("feed_deg_min", FEED_DEG_MIN.into()),
        ("monte_carlo_trials", 0.into()),
    ];
    settings.extend(changes.map(|(key, value)| (key.to_owned(), value)));
    Ok(MachineFile::parse("multiprobe.toml", toml::to_string(&table)?)?)
}

/// Simulated samples of every rotation step, for each sensor.
fn simulate_rotations(plan: &Plan) -> Vec<RotationSamples<'_>> {
    let mut normal = StandardNormal.sample_iter(random::seeded_stream(1, &[1]));
    let steps = plan.steps.iter().filter(|step| step.label.starts_with("index/"));
    let mut turns = Vec::new();
    for (index, step) in steps.enumerate() {
        let [from, to] = [&step.from, &step.to].map(|end| end.get_or_zero(Axis::C));
        let angle_per_sample = (step.feed_mm_min / 60.0).to_radians() / SAMPLE_RATE_HZ;
        let count = ((to - from) / angle_per_sample) as usize;
        for (channel, sensor) in plan.sensors.iter().enumerate() {
            let sample = |i: usize| {
                let angle_rad = from + i as f64 * angle_per_sample;
                let deviation = displacement_towards_sensor_mm(sensor.zero_mm, sensor.direction, angle_rad, index);
                let noise: f64 = normal.next().unwrap_or_default();
                AngleSample { angle_rad, value: NOISE_STD_MM * noise - deviation, is_valid: true }
            };
            let samples = (0..=count).map(sample).collect();
            turns.push(RotationSamples { step, channel_index: channel, mounting_index: index, samples });
        }
    }
    turns
}

/// The readings that a run stores of a rotation.
fn rotation_readings(plan: &Plan, turn: &RotationSamples, of: &ResampledChannel) -> Vec<Reading> {
    let angle_per_s = (turn.step.feed_mm_min / 60.0).to_radians();
    let from = turn.step.from.get_or_zero(Axis::C);
    let reading = |(angle, value_mm): (f64, Option<f64>)| Reading {
        step: turn.step.id,
        repeat: 0,
        position: turn.step.from.clone().with(Axis::C, angle),
        value_mm,
        sensor: plan.sensors[turn.channel_index].name.clone(),
        t_s: (angle - from) / angle_per_s + 40.0 * turn.mounting_index as f64,
        flag: ReadingFlag::None,
        temperatures_c: Default::default(),
    };
    of.angles_and_values().map(reading).collect()
}

/// Displacement of the surface towards a sensor, mm: motions of the table, which rotates clockwise, and form of the
/// artefact. `q`: angle of the table, rad; `index`: index of the mounting.
fn displacement_towards_sensor_mm(zero_mm: [f64; 3], direction: [f64; 3], q: f64, index: usize) -> f64 {
    let gamma = zero_mm[1].atan2(zero_mm[0]);
    let on_artefact = gamma + q - index as f64 * std::f64::consts::PI;
    if direction[2] < -0.5 {
        return 7e-4 * (2.0 * q).cos() + 5e-4 * (3.0 * on_artefact).cos();
    }
    let x = 1.2e-3 * (2.0 * q).cos() - 4e-4 * (2.0 * q).sin();
    let y = 8e-4 * (3.0 * q).sin();
    let form = 1e-3 * (2.0 * on_artefact).cos() + 5e-4 * (7.0 * on_artefact).sin();
    x * gamma.cos() + y * gamma.sin() + form
}

/// Seconds of numpy, and the first revolution of each rotation of each channel.
fn time_numpy_resampling(python: &Path, turns: &[RotationSamples]) -> Result<(f64, Vec<f64>), Box<dyn Error>> {
    let mut bytes = Vec::new();
    for turn in turns {
        bytes.extend((turn.samples.len() as f64).to_le_bytes());
        turn.samples.iter().for_each(|sample| bytes.extend(sample.angle_rad.to_le_bytes()));
        turn.samples.iter().for_each(|sample| bytes.extend(sample.value.to_le_bytes()));
    }
    let (script, input) = (scipy_folder().join("multiprobe.py"), scipy_folder().join("multiprobe.bin"));
    std::fs::write(&script, NUMPY_SCRIPT)?;
    std::fs::write(&input, bytes)?;
    let mut command = Command::new(python);
    let mut numbers = run_and_read_numbers(command.arg(&script).arg(&input).arg(POSITIONS_PER_REVOLUTION.to_string()))?;
    let seconds = numbers.remove(0);
    Ok((seconds, numbers))
}

fn check_against_numpy(all: &[ResampledChannel], theirs: &[f64]) -> Result<(), Box<dyn Error>> {
    let blocks = all.iter().flat_map(|of| common_and_rejected_revolutions(0, std::slice::from_ref(of)).0);
    let ours: Vec<f64> = blocks.flat_map(|row| row.revolutions[0].clone()).collect();
    let differences: Vec<f64> = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).collect();
    if differences.len() != theirs.len() {
        return Err(format!("{} values, {} of numpy", differences.len(), theirs.len()).into());
    }
    let worst = differences.iter().copied().fold(0.0, f64::max);
    println!("largest difference from numpy: {worst:.1e} mm");
    match worst <= MAX_NUMPY_DIFFERENCE_MM {
        true => Ok(()),
        false => Err(format!("more than {MAX_NUMPY_DIFFERENCE_MM:e} mm from numpy").into()),
    }
}
