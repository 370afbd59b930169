//! Multiprobe with eight sensors at 10 kHz over 60 s of continuous turns: resampling to equal angles against the
//! same filter in numpy in one run, and the identification from the resampled revolutions, Monte Carlo included
//! (JCGM 101 sets the number of trials).
//!
//! `cargo bench --bench multiprobe`. numpy comes into a venv of its own in the target folder.

use std::error::Error;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use estimation::random;
use estimation::revolutions::{
    ResampleFilter, Resampled, Resampler, RowRevolutions, Sample, common_revolutions,
};
use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Sampling, Step};
use machine::record::reading::{Flag, Reading};
use methods::Method;
use rand_distr::{Distribution, StandardNormal};
use toml::{Table, Value};
use trued::setup::{self, MachineFile};

mod peer;

use peer::{answer, folder, scipy_python};

/// Equal angles in one revolution.
const POSITIONS: usize = 360;
/// In the turn at each of the two mountings: 30 s at 120° a second.
const REVOLUTIONS: i64 = 10;
const RATE_HZ: f64 = 1e4;
const FEED_DEG_MIN: f64 = 7200.0;
const NOISE_MM: f64 = 5e-5;
/// Of 83 samples a step, one in so many leaves two: the same revolutions from the fewest readings.
const THINNING: usize = 40;
const MAX_IDENTIFICATION_S: f64 = 1.0;
/// Largest difference of resampled values from numpy's, which interpolates the same kernel, mm.
const TOLERANCE_MM: f64 = 1e-10;
const SCRIPT: &str = include_str!("multiprobe_numpy.py");

/// One channel in one turn.
struct Turn {
    ends_rad: [f64; 2],
    samples: Vec<Sample>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let file = machine_file()?;
    let (method, header) = setup::header(&file, "multiprobe", None)?;
    let (plan, _) = methods::nominal(method.as_ref(), header)?;
    let readings = readings(&plan);
    let turns = turns(&plan, &readings);
    let samples: usize = turns.iter().map(|turn| turn.samples.len()).sum();
    let channels = plan.sensors.len();
    println!("{channels} channels, {} samples each, {} turns", samples / channels, turns.len());

    let filter = ResampleFilter::new(POSITIONS);
    let start = Instant::now();
    let all: Vec<Resampled> = turns.iter().map(|turn| resampled(&filter, turn)).collect();
    let resampling_s = start.elapsed().as_secs_f64();
    let blocks: Vec<_> = all.chunks(channels).map(|of| common_revolutions(0, of).0).collect();
    let revolutions = blocks.iter().flatten().flat_map(|row| &row.revolutions);
    let values: usize = revolutions.map(Vec::len).sum();
    println!("trued: {resampling_s:.3} s to resample");
    println!("resampled revolutions: {values} values, {:.2} MB", values as f64 * 8e-6);
    println!(
        "readings: {}, {:.0} MB without positions and names",
        readings.len(),
        (readings.len() * size_of::<Reading>()) as f64 * 1e-6
    );

    let (all_s, _) = identified(method.as_ref(), &plan, &readings)?;
    println!("trued: {all_s:.3} s to identify from all readings");
    let thinned = thinned(&readings, channels);
    let (few_s, estimate) = identified(method.as_ref(), &plan, &thinned)?;
    println!(
        "trued: {few_s:.3} s to identify from as many revolutions, made of {} readings ({} parameters)",
        thinned.len(),
        estimate.parameters.len()
    );
    if few_s > MAX_IDENTIFICATION_S {
        return Err(format!("the identification takes more than {MAX_IDENTIFICATION_S} s").into());
    }
    match scipy_python().and_then(|python| numpy(&python, &turns)) {
        Ok((numpy_s, theirs)) => {
            println!("numpy: {numpy_s:.3} s to resample, ratio {:.1}", numpy_s / resampling_s);
            compare(&blocks, &theirs)
        }
        Err(why) if std::env::var_os("TRUED_REQUIRE_PEERS").is_none() => {
            println!("numpy: skipped, {why}");
            Ok(())
        }
        Err(why) => Err(why),
    }
}

fn resampled(filter: &ResampleFilter, turn: &Turn) -> Resampled {
    let [from, to] = turn.ends_rad;
    let mut resampler = Resampler::new(filter, from, to);
    turn.samples.iter().for_each(|sample| resampler.push(*sample));
    resampler.finish()
}

/// Best of three: seconds, and the estimate.
fn identified(
    method: &dyn Method,
    plan: &Plan,
    readings: &[Reading],
) -> Result<(f64, Estimate), Box<dyn Error>> {
    let (mut best, mut last) = (f64::INFINITY, None);
    for _ in 0..3 {
        let start = Instant::now();
        last = Some(method.identify(plan, readings, &[])?);
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok((best, last.ok_or("no estimate")?))
}

/// The built-in machine with an eighth sensor, fast turns and two mountings.
fn machine_file() -> Result<MachineFile, Box<dyn Error>> {
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
        ("revolutions", REVOLUTIONS.into()),
        ("both_directions", false.into()),
        ("positions", (POSITIONS as i64).into()),
        ("sampling", "continuous".into()),
        ("rate_hz", RATE_HZ.into()),
        ("feed_deg_min", FEED_DEG_MIN.into()),
        ("monte_carlo_trials", 0.into()),
    ];
    settings.extend(changes.map(|(key, value)| (key.to_owned(), value)));
    Ok(MachineFile::parse("multiprobe.toml", toml::to_string(&table)?)?)
}

/// All samples of the turns, as a run keeps them.
fn readings(plan: &Plan) -> Vec<Reading> {
    let turns: Vec<&Step> =
        plan.steps.iter().filter(|step| step.label.starts_with("index/")).collect();
    let mut normal = StandardNormal.sample_iter(random::stream(1, &[1]));
    let mut readings = Vec::new();
    for (index, step) in turns.into_iter().enumerate() {
        let sampling = step.scan.as_ref().map(|scan| scan.sampling);
        let Some(Sampling::Continuous { rate_hz }) = sampling else { continue };
        let [from, to] = [&step.from, &step.to].map(|end| end.at(Axis::C));
        let angle_per_s = (step.feed_mm_min / 60.0).to_radians();
        let count = ((to - from) / angle_per_s * rate_hz) as usize;
        for i in 0..=count {
            let t_s = i as f64 / rate_hz;
            let angle = from + t_s * angle_per_s;
            for sensor in &plan.sensors {
                let noise: f64 = normal.next().unwrap_or_default();
                let deviation = deviation(sensor.zero_mm, sensor.direction, angle, index);
                readings.push(Reading {
                    step: step.id,
                    repeat: 0,
                    position: step.from.clone().with(Axis::C, angle),
                    value_mm: Some(-deviation + NOISE_MM * noise),
                    sensor: sensor.name.clone(),
                    t_s: t_s + 40.0 * index as f64,
                    flag: Flag::None,
                    temperatures_c: Default::default(),
                });
            }
        }
    }
    readings
}

/// Displacement of the surface towards a sensor, mm: motions of the table, which turns clockwise, and form of the
/// artefact.
fn deviation(zero_mm: [f64; 3], direction: [f64; 3], q: f64, index: usize) -> f64 {
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

/// Each turn of each channel, turn after turn.
fn turns(plan: &Plan, readings: &[Reading]) -> Vec<Turn> {
    let channels = plan.sensors.len();
    let sample = |reading: &Reading| Sample {
        angle_rad: reading.position.at(Axis::C),
        value: -reading.value_mm.unwrap_or(f64::NAN),
        is_valid: true,
    };
    let mut turns = Vec::new();
    for of_step in readings.chunk_by(|one, other| one.step == other.step) {
        let step = plan.steps.iter().find(|step| step.id == of_step[0].step);
        let Some(step) = step else { continue };
        turns.extend((0..channels).map(|channel| Turn {
            ends_rad: [&step.from, &step.to].map(|end| end.at(Axis::C)),
            samples: of_step.iter().skip(channel).step_by(channels).map(sample).collect(),
        }));
    }
    turns
}

/// Of each channel one reading in [`THINNING`], and the last of each turn.
fn thinned(readings: &[Reading], channels: usize) -> Vec<Reading> {
    let mut kept = Vec::new();
    for of_step in readings.chunk_by(|one, other| one.step == other.step) {
        let last = of_step.len() / channels - 1;
        let moments = of_step.chunks(channels).enumerate();
        let moments = moments.filter(|(i, _)| i % THINNING == 0 || *i == last);
        kept.extend(moments.flat_map(|(_, all)| all.iter().cloned()));
    }
    kept
}

/// Seconds of numpy, and the first revolution of each turn of each channel.
fn numpy(python: &Path, turns: &[Turn]) -> Result<(f64, Vec<f64>), Box<dyn Error>> {
    let mut bytes = Vec::new();
    for turn in turns {
        bytes.extend((turn.samples.len() as f64).to_le_bytes());
        turn.samples.iter().for_each(|sample| bytes.extend(sample.angle_rad.to_le_bytes()));
        turn.samples.iter().for_each(|sample| bytes.extend(sample.value.to_le_bytes()));
    }
    let (script, input) = (folder().join("multiprobe.py"), folder().join("multiprobe.bin"));
    std::fs::write(&script, SCRIPT)?;
    std::fs::write(&input, bytes)?;
    let mut command = Command::new(python);
    let mut numbers = answer(command.arg(&script).arg(&input).arg(POSITIONS.to_string()))?;
    let seconds = numbers.remove(0);
    Ok((seconds, numbers))
}

/// The first revolution of each turn of each channel.
fn compare(blocks: &[Vec<RowRevolutions>], theirs: &[f64]) -> Result<(), Box<dyn Error>> {
    let ours = blocks.iter().flatten().flat_map(|row| &row.revolutions[0]);
    let differences: Vec<f64> = ours.zip(theirs).map(|(a, b)| (a - b).abs()).collect();
    if differences.len() != theirs.len() {
        return Err(format!("{} values, {} of numpy", differences.len(), theirs.len()).into());
    }
    let worst = differences.iter().copied().fold(0.0, f64::max);
    println!("largest difference from numpy: {worst:.1e} mm");
    match worst <= TOLERANCE_MM {
        true => Ok(()),
        false => Err(format!("more than {TOLERANCE_MM:e} mm from numpy").into()),
    }
}
