//! Tests scans in motion with positions from LinuxCNC's sampler and a laser that has its own clock and delay.

use std::time::Duration;

use libtest_mimic::Failed;
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;
use machine::record::plan::{Plan, Sampling, Scan, Stage, Step, StepKind};
use machine::record::reading::Reading;
use machine::{Axis, Position};
use methods::{IdentifyError, Method, MethodRefusal, NextStage, ObjectPositionSource};
use nalgebra::{Matrix4, Vector3, Vector4};
use trued::run::{Run, RunError};
use trued::setup::{self, EarlierSessions, MachineFile, SimulationPace};
use trued::store::{Journal, NewRun};

use super::data_streams::StreamsProcess;
use super::driver::block_on;
use super::rig::{LinuxCncRig, lock_rig};
use super::run_workspace::RunWorkspace;
use super::samba::{BALL_CENTRES_MM, TILTED_AXES, place_balls_and_axis_errors, run_and_check_parameters};

/// The true position of the ball, its radius, and the laser's zero point from the spindle datum, mm.
const BALL_CENTRE_MM: Vector3<f64> = Vector3::new(BALL_CENTRES_MM[0][0], BALL_CENTRES_MM[0][1], BALL_CENTRES_MM[0][2]);
const BALL_RADIUS_MM: f64 = 10.0;
const LASER_ZERO_POINT_MM: Vector3<f64> = Vector3::new(0.3, -0.2, -100.05);
const BEAM_TILT_RAD: [f64; 2] = [400e-6, -250e-6];
/// Expected result of the laser R-test for the true axes; the same as for the ball measured by touch.
const TRUE_LASER_R_TEST_PARAMETERS: [(&str, f64, f64); 9] = [
    ("EX0C", 75.0, 2.0),
    ("EA0B", 40.0, 10.0),
    ("EB0B", 55.0, 10.0),
    ("EC0B", -30.0, 10.0),
    ("EA0C", -65.0, 10.0),
    ("zero_x", 0.265, 0.003),
    ("zero_y", -0.17, 0.003),
    ("zero_z", -99.99, 0.003),
    // ms: the 40 ms of streams.py, and [`ADDED_LASER_DELAY_MS`].
    ("latency", 46.0, 1.0),
];
/// Distance from the middle to the end of a pass, mm, and feeds, mm/min.
const PASS_HALF_LENGTH_MM: f64 = 4.0;
const PASS_FEEDS_MM_MIN: [f64; 2] = [600.0, 1800.0];
/// Additional delay of the laser, ms.
const ADDED_LASER_DELAY_MS: f64 = 6.0;
/// Delay error at which a sample counts as not agreeing, ms.
const MAX_SAMPLE_DELAY_ERROR_MS: f64 = 0.5;

/// Tolerance of the latency, ms, and of the ball position, mm.
struct FitTolerance {
    latency_ms: f64,
    ball_position_mm: f64,
}

/// Tolerance that holds under any load of the computer: an undetected delay gives an error of 6 ms, and agreeing
/// samples are 5 µm off if they come late at the slow feed.
const WIDE_TOLERANCE: FitTolerance = FitTolerance { latency_ms: 1.0, ball_position_mm: 0.005 };
/// Tolerance on an idle computer.
const NARROW_TOLERANCE: FitTolerance = FitTolerance { latency_ms: 0.5, ball_position_mm: 0.001 };

/// Four passes over the ball along X and along Y at each feed, in one stage.
struct PassesMethod;

impl PassesMethod {
    fn steps() -> Vec<Step> {
        let mut steps = Vec::new();
        for feed_mm_min in PASS_FEEDS_MM_MIN {
            for (axis, id) in [(Axis::X, 0), (Axis::Y, 1)] {
                let over = |by: f64| {
                    let middle = Position::new().with(Axis::X, 80.0).with(Axis::Y, 0.0);
                    let at = middle.get_or_zero(axis) + by;
                    let at = middle.with(axis, at).with(Axis::Z, 200.0);
                    at.with(Axis::B, 0.0).with(Axis::C, 0.0)
                };
                let path = [
                    -PASS_HALF_LENGTH_MM,
                    PASS_HALF_LENGTH_MM,
                    -PASS_HALF_LENGTH_MM,
                    PASS_HALF_LENGTH_MM,
                    -PASS_HALF_LENGTH_MM,
                ]
                .map(over)
                .to_vec();
                steps.push(Step {
                    id: 2 * u32::from(feed_mm_min > 1000.0) + id,
                    stage: 0,
                    kind: StepKind::Scan,
                    label: format!("pass/{axis}/{feed_mm_min}"),
                    from: over(-PASS_HALF_LENGTH_MM),
                    to: over(-PASS_HALF_LENGTH_MM),
                    feed_mm_min,
                    sensors: vec!["laser".to_owned()],
                    normal: [0.0, 0.0, 1.0],
                    scan: Some(Scan { path, sampling: Sampling::Continuous { rate_hz: 1000.0, per_revolution: None } }),
                    text: None,
                    mount: None,
                    watch: Vec::new(),
                });
            }
        }
        steps
    }
}

impl Method for PassesMethod {
    fn settings(&self) -> serde_json::Value {
        serde_json::json!({})
    }

    fn next_stage(&self, _: &Plan, done: &[Stage], _: ObjectPositionSource<'_>) -> Result<NextStage, MethodRefusal> {
        if !done.is_empty() {
            return Ok(NextStage::NoFurtherStage);
        }
        let new_steps = Self::steps();
        let steps = new_steps.iter().map(|step| step.id).collect();
        let stage = Stage { id: 0, name: "passes".to_owned(), repeat: 0, steps, found: None };
        Ok(NextStage::Stage { stage, new_steps })
    }

    fn identify(&self, _: &Plan, _: &[Reading]) -> Result<Estimate, IdentifyError> {
        Err(IdentifyError::IdentificationFailed("nobody asks for it".to_owned()))
    }
}

/// Runs [`PassesMethod`] on the machine of `workspace`. Returns the readings, whether the machine has moved, and the
/// result of the run.
async fn run_passes(workspace: &RunWorkspace) -> Result<(Vec<Reading>, bool, Result<(), RunError>), Failed> {
    let file = MachineFile::read(&workspace.machine_file_path())?;
    let devices = setup::open_devices(&file, SimulationPace::RealTime, EarlierSessions::default()).await?;
    let journal = Journal::open(workspace.machine_file_path().parent().ok_or("no folder")?)?;
    let mut plan = setup::plan_without_steps(&file, "laser-r-test", serde_json::json!({}));
    plan.sensors = file.sensors.iter().map(|entry| entry.sensor.clone()).collect();
    let new = NewRun { machine_file_text: file.text().to_owned(), plan: plan.clone() };
    let id = journal.begin_run(&new).await?;
    let mut tell = |event: &RunEvent| {
        if let RunEvent::OperatorMessage { text } = event {
            eprintln!("{text}");
        }
    };
    let mut run = Run::new(id, &PassesMethod, &devices, &journal, plan, &mut tell);
    let ended = run.execute().await;
    Ok((run.readings, run.may_have_moved, ended))
}

/// Readings of one step, in the order of time: time of the run, s; axis positions, mm; measured value, mm.
struct SampledPass(Vec<(f64, Vector3<f64>, f64)>);

impl SampledPass {
    /// Axis positions, interpolated between the readings before and after.
    fn interpolated_position(&self, t_s: f64) -> Option<Vector3<f64>> {
        let after = self.0.partition_point(|(time, ..)| *time < t_s);
        let (late, early) = (self.0.get(after)?, self.0.get(after.checked_sub(1)?)?);
        let part = (t_s - early.0) / (late.0 - early.0);
        (late.0 - early.0 < 0.02).then(|| early.1 + part * (late.1 - early.1))
    }
}

fn split_into_passes(readings: &[Reading]) -> Vec<SampledPass> {
    let mut passes: Vec<SampledPass> = PassesMethod::steps().iter().map(|_| SampledPass(Vec::new())).collect();
    for reading in readings {
        let at = reading.position.xyz_or_zero();
        if let Some(value) = reading.value_mm {
            passes[reading.step as usize].0.push((reading.t_s, at, value));
        }
    }
    passes
}

/// Result of the passes: X, Y and Z at which the zero point is in the ball's centre, mm; delay of a value after its
/// position, s; number of agreeing samples, of all samples.
#[derive(Debug)]
struct PassFit {
    position_at_ball_centre_mm: Vector3<f64>,
    latency_s: f64,
    residual_rms_um: f64,
    used_sample_count: usize,
}

/// Error of a sample that is [`MAX_SAMPLE_DELAY_ERROR_MS`] too late, at the end of a fast pass, mm.
fn max_agreeing_residual_mm() -> f64 {
    let slope =
        PASS_HALF_LENGTH_MM / (BALL_RADIUS_MM * BALL_RADIUS_MM - PASS_HALF_LENGTH_MM * PASS_HALF_LENGTH_MM).sqrt();
    MAX_SAMPLE_DELAY_ERROR_MS * 1e-3 * PASS_FEEDS_MM_MIN[1] / 60.0 * slope
}

/// Gauss-Newton by finite differences over centre and latency. Samples with a residual above four times the usual
/// one are left out in each iteration, and at the end those that do not agree: under load Python sends lines late,
/// at times half of them.
fn fit_ball_centre_and_latency(passes: &[SampledPass]) -> Result<PassFit, Failed> {
    let expected = |at: Vector3<f64>, centre: Vector3<f64>| {
        let off = at - centre;
        off.z - (BALL_RADIUS_MM * BALL_RADIUS_MM - off.x * off.x - off.y * off.y).sqrt()
    };
    let mut unknown = Vector4::new(80.0, 0.0, 190.0, 0.04);
    let (mut limit, mut last) = (f64::INFINITY, None);
    for round in 0..25 {
        let residual = |pass: &SampledPass, (t_s, value): (f64, f64), unknown: Vector4<f64>| {
            let at = pass.interpolated_position(t_s - unknown.w)?;
            Some(value - expected(at, unknown.xyz()))
        };
        let (mut normal, mut right, mut all) = (Matrix4::zeros(), Vector4::zeros(), Vec::new());
        let (mut used, mut rms) = (0_usize, 0.0);
        for pass in passes {
            for (t_s, _, value) in &pass.0 {
                let of = |unknown| residual(pass, (*t_s, *value), unknown);
                let Some(off) = of(unknown) else { continue };
                all.push(off.abs());
                let steps = [1e-4, 1e-4, 1e-4, 2e-4];
                let slopes: Option<Vec<f64>> = (0..4)
                    .map(|i| {
                        let mut moved = unknown;
                        moved[i] += steps[i];
                        Some((of(moved)? - off) / steps[i])
                    })
                    .collect();
                let Some(slopes) = slopes.filter(|_| off.abs() <= limit) else { continue };
                let row = Vector4::from_column_slice(&slopes);
                normal += row * row.transpose();
                right -= row * off;
                used += 1;
                rms += off * off;
            }
        }
        unknown += normal.try_inverse().ok_or("the fit finds nothing")? * right;
        all.sort_by(f64::total_cmp);
        limit = 4.0 * 1.48 * all.get(all.len() / 2).ok_or("no sample")?.max(1e-6);
        limit = if round < 12 { limit } else { limit.min(max_agreeing_residual_mm()) };
        if used == 0 || !unknown.norm().is_finite() {
            return Err("the fit finds nothing".into());
        }
        last = Some(PassFit {
            position_at_ball_centre_mm: unknown.xyz(),
            latency_s: unknown.w,
            residual_rms_um: (rms / used as f64).sqrt() * 1e3,
            used_sample_count: used,
        });
    }
    last.ok_or_else(|| "no round".into())
}

/// Places the balls, and the laser over the first one with its beam tilted about X and Y by `beam_tilt_rad`.
fn place_balls_and_laser(rig: &LinuxCncRig, beam_tilt_rad: [f64; 2]) -> Result<(), Failed> {
    place_balls_and_axis_errors(rig, &TILTED_AXES)?;
    let places = [
        ("laser-x", LASER_ZERO_POINT_MM.x),
        ("laser-y", LASER_ZERO_POINT_MM.y),
        ("laser-z", LASER_ZERO_POINT_MM.z),
        ("laser-a", beam_tilt_rad[0]),
        ("laser-b", beam_tilt_rad[1]),
    ];
    places.iter().try_for_each(|(name, value)| rig.set_true_value(name, *value))
}

/// Two runs that differ by the laser's delay only: the latency differs by it, and the ball position does not
/// change.
pub fn latency_follows_the_laser_delay_within_1_ms() -> Result<(), Failed> {
    check_latency_follows_delay(&WIDE_TOLERANCE)
}

/// Lines that are late more often in one direction than in the other shift the ball; this is random.
pub fn latency_follows_the_laser_delay_within_half_a_ms() -> Result<(), Failed> {
    check_latency_follows_delay(&NARROW_TOLERANCE)
}

fn check_latency_follows_delay(tolerance: &FitTolerance) -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_balls_and_laser(&rig, [0.0, 0.0])?;
    let mut streams = StreamsProcess::start(&rig)?;
    let workspace = RunWorkspace::with_laser(&rig, &streams, "")?;
    let mut latencies_ms = Vec::new();
    for delay in [0.0, ADDED_LASER_DELAY_MS] {
        streams.set_laser_delay_ms(delay)?;
        std::thread::sleep(Duration::from_millis(200));
        let (readings, _, ended) = block_on(run_passes(&workspace))?;
        ended?;
        let found = fit_ball_centre_and_latency(&split_into_passes(&readings))?;
        let off_um = (found.position_at_ball_centre_mm - (BALL_CENTRE_MM - LASER_ZERO_POINT_MM)) * 1e3;
        let PassFit { latency_s, residual_rms_um: rms_um, used_sample_count: used, .. } = found;
        eprintln!(
            "{used} of {} readings, rms {rms_um:.3} um, latency {:.3} ms; ball off by {:.3?} um",
            readings.len(),
            latency_s * 1e3,
            off_um.as_slice(),
        );
        // The others were late; the agreeing samples are not selected only by their mutual agreement.
        if off_um.abs().max() > tolerance.ball_position_mm * 1e3 || 4 * used < readings.len() {
            let off_um = off_um.as_slice();
            return Err(format!("the ball is off by {off_um:?} um, {used} readings agree").into());
        }
        latencies_ms.push(found.latency_s * 1e3);
    }
    let follows = latencies_ms[1] - latencies_ms[0];
    eprintln!("latency {latencies_ms:.3?} ms: {follows:.3} ms for {ADDED_LASER_DELAY_MS} ms");
    if (follows - ADDED_LASER_DELAY_MS).abs() > tolerance.latency_ms {
        return Err(format!("{ADDED_LASER_DELAY_MS} ms make {follows} ms").into());
    }
    Ok(())
}

/// The pins are in a different order than in the machine file.
pub fn wrong_order_of_sampler_axes_is_refused_before_motion() -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_balls_and_laser(&rig, [0.0, 0.0])?;
    let streams = StreamsProcess::start(&rig)?;
    let swapped = "axes = [\"Z\", \"Y\", \"X\", \"B\", \"C\"]";
    let (readings, moved, ended) = block_on(run_passes(&RunWorkspace::with_laser(&rig, &streams, swapped)?))?;
    match ended {
        Err(error) if !moved && readings.is_empty() => {
            let said = format!("{error}; {}", error.remedy());
            eprintln!("{said}");
            let named = ["Z is at 200.000", "reports 0.000", "joint.N.pos-fb"];
            if named.iter().all(|words| said.contains(words)) { Ok(()) } else { Err(said.into()) }
        }
        other => Err(format!("moved: {moved}, {other:?}").into()),
    }
}

/// Runs `trued run laser-r-test` with scans in motion.
pub fn laser_r_test_in_motion_finds_the_true_axes() -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_balls_and_laser(&rig, BEAM_TILT_RAD)?;
    let mut streams = StreamsProcess::start(&rig)?;
    streams.set_laser_delay_ms(ADDED_LASER_DELAY_MS)?;
    run_and_check_parameters(
        &RunWorkspace::with_laser(&rig, &streams, "")?,
        "laser-r-test",
        &TRUE_LASER_R_TEST_PARAMETERS,
    )
}
