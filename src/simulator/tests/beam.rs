//! Output of a displacement sensor, compared with numbers computed by hand and with a ray search that uses a pose
//! by matrix products.

use nalgebra::{Vector3, Vector4};

use super::super::random_draws;
use super::contact::{STATED_ERRORS, STYLUS_CENTRE_MM, position_for_ball_centre, table_and_spindle_poses_by_products};
use super::*;
use machine::record::sensor::Sensor;

const BALL_RADIUS_MM: f64 = 10.0;

fn laser_with_keys(changes: &str) -> Sensor {
    let whole = format!("name = 'laser'\nrange_mm = [-10.0, 10.0]\nstand_off_mm = 50.0\n{changes}");
    toml::from_str(&whole).unwrap()
}

/// A sensor that measures downwards, with its zero point at the stylus centre of the ideal bench.
fn downward_sensor() -> Sensor {
    laser_with_keys("zero_mm = [0.0, 0.0, -100.0]\ndirection = [0.0, 0.0, -1.0]")
}

/// One ball of radius 10 mm, 50 mm above the table, and the true errors of the sensor.
fn bench_with_sensor_truth(truth: &str) -> TestBench {
    let mut bench = TestBench::with_balls("[[balls]]\nid = '1'\ncentre_mm = [0.0, 0.0, 50.0]\nradius_mm = 10.0");
    bench.truth.sensor = vec![toml::from_str(&format!("name = 'laser'\n{truth}")).unwrap()];
    bench
}

fn sample_downward_sensor_at(bench: &TestBench, at: &Position) -> SensorOutput {
    sample_sensor_at(bench, &downward_sensor(), at)
}

fn sample_sensor_at(bench: &TestBench, sensor: &Sensor, at: &Position) -> SensorOutput {
    let mut world = bench.build_world().with_sensors(std::slice::from_ref(sensor)).unwrap();
    world.travel(at, Speed::Rapid);
    world.sample_after("laser", 0.0).unwrap()
}

#[track_caller]
fn assert_distance_mm(output: SensorOutput, expected: f64) {
    let SensorOutput::Distance(distance) = output else { panic!("{output:?}") };
    assert!((distance - expected).abs() <= 1e-9, "{distance} {expected}");
}

#[test]
fn ideal_sensor_reads_the_distance_along_its_beam() {
    let bench = bench_with_sensor_truth("");
    assert_distance_mm(sample_downward_sensor_at(&bench, &position_with_ball_at(0.0, 0.0, 65.0)), 5.0);
    assert_distance_mm(sample_downward_sensor_at(&bench, &position_with_ball_at(0.0, 0.0, 52.0)), -8.0);
    // Right triangle 6, 8, 10 mm.
    assert_distance_mm(sample_downward_sensor_at(&bench, &position_with_ball_at(6.0, 0.0, 65.0)), 7.0);
    assert_distance_mm(sample_downward_sensor_at(&bench, &position_with_ball_at(0.0, -6.0, 65.0)), 7.0);
    assert_eq!(
        sample_downward_sensor_at(&bench, &position_with_ball_at(0.0, 0.0, 75.0)),
        SensorOutput::OutOfRange(15.0)
    );
    assert_eq!(
        sample_downward_sensor_at(&bench, &position_with_ball_at(0.0, 0.0, 48.0)),
        SensorOutput::OutOfRange(-12.0)
    );
    assert_eq!(sample_downward_sensor_at(&bench, &position_with_ball_at(0.0, 0.0, 200.0)), SensorOutput::NoEcho);
    assert_eq!(sample_downward_sensor_at(&bench, &position_with_ball_at(30.0, 0.0, 65.0)), SensorOutput::NoEcho);
    // The front of the sensor is 50 mm behind the zero point, and the surface may come up to it; inside the ball
    // there is no echo.
    assert_eq!(
        sample_downward_sensor_at(&bench, &position_with_ball_at(0.0, 0.0, 35.0)),
        SensorOutput::OutOfRange(-25.0)
    );
    assert_eq!(sample_downward_sensor_at(&bench, &position_with_ball_at(0.0, 0.0, 5.0)), SensorOutput::NoEcho);
    let mut world = bench.build_world().with_sensors(&[downward_sensor()]).unwrap();
    assert_eq!(world.sample_after("lazer", 1.0), None);
    assert_eq!(world.time_s(), 0.0);
    world.sample_after("laser", 0.25).unwrap();
    assert_eq!(world.time_s(), 0.25);
}

#[test]
fn steep_surface_gives_no_echo_and_perpendicular_one_too_much_light() {
    let limited = bench_with_sensor_truth("echo_limit_deg = 30.0\ndazzled_deg = 6.0");
    let at = |deg: f64| position_with_ball_at(0.0, BALL_RADIUS_MM * deg.to_radians().sin(), 65.0);
    let expected = |deg: f64| 15.0 - BALL_RADIUS_MM * deg.to_radians().cos();
    assert_distance_mm(sample_downward_sensor_at(&limited, &at(29.99)), expected(29.99));
    assert_eq!(sample_downward_sensor_at(&limited, &at(30.01)), SensorOutput::NoEcho);
    assert_distance_mm(sample_downward_sensor_at(&limited, &at(6.01)), expected(6.01));
    assert_eq!(sample_downward_sensor_at(&limited, &at(5.99)), SensorOutput::TooMuchLight);
    assert_distance_mm(sample_downward_sensor_at(&bench_with_sensor_truth(""), &at(39.99)), expected(39.99));
    assert_eq!(sample_downward_sensor_at(&bench_with_sensor_truth(""), &at(40.01)), SensorOutput::NoEcho);
}

#[test]
fn beam_has_the_declared_tilt_and_offset() {
    // Computed by hand: from (6, 0, 65) along (0.01, 0, -1), normalised, to the ball.
    let said = sample_downward_sensor_at(
        &bench_with_sensor_truth("tilt_urad = [10000.0, 0.0]"),
        &position_with_ball_at(6.0, 0.0, 65.0),
    );
    let (p, d) = (Vector3::new(6.0, 0.0, 15.0), Vector3::new(0.01, 0.0, -1.0));
    let (a, b, c) = (d.dot(&d), p.dot(&d), p.dot(&p) - BALL_RADIUS_MM * BALL_RADIUS_MM);
    let expected = (-b - (b * b - a * c).sqrt()) / a * a.sqrt();
    assert!(expected > 7.05, "it leans down the slope: {expected}");
    assert_distance_mm(said, expected);
    let off = bench_with_sensor_truth("zero_offset_um = [6000.0, 0.0, 1000.0]");
    assert_distance_mm(sample_downward_sensor_at(&off, &position_with_ball_at(0.0, 0.0, 65.0)), 8.0);
    // With the spindle turned by 90°, X of the spindle is Y of the machine.
    let quarter = |x, y| position_with_ball_at(x, y, 65.0).with(Axis::S, std::f64::consts::FRAC_PI_2);
    assert_distance_mm(sample_downward_sensor_at(&off, &quarter(0.0, -6.0)), 6.0);
    let aside = laser_with_keys("zero_mm = [0.0, 3.0, -100.0]\ndirection = [0.0, -1.0, 0.0]");
    let seen = sample_sensor_at(
        &bench_with_sensor_truth("tilt_urad = [0.0, 0.0]"),
        &aside,
        &position_with_ball_at(0.0, 12.0, 56.0),
    );
    assert_distance_mm(seen, 7.0);
    // For a beam along Y the second direction across is Z: the beam tilts upwards, over the top of the ball.
    let up = sample_sensor_at(
        &bench_with_sensor_truth("tilt_urad = [0.0, 20000.0]"),
        &aside,
        &position_with_ball_at(0.0, 12.0, 56.0),
    );
    let SensorOutput::Distance(up) = up else { panic!("{up:?}") };
    assert!((7.08..7.13).contains(&up), "{up}");
}

/// Distance along the ray at which `gap` is zero, by bisection.
fn ray_distance_to_zero_gap(origin: Vector3<f64>, along: Vector3<f64>, gap: impl Fn(Vector3<f64>) -> f64) -> f64 {
    let (mut free, mut inside) = (-40.0, 9.0);
    assert!(gap(origin + along * free) > 0.0 && gap(origin + along * inside) < 0.0);
    for _ in 0..200 {
        let middle = (free + inside) / 2.0;
        if gap(origin + along * middle) > 0.0 { free = middle } else { inside = middle }
    }
    free
}

const ZERO_OFFSET_AND_TILT_TOML: &str = "zero_offset_um = [120.0, -80.0, 300.0]\ntilt_urad = [2000.0, -3500.0]";

#[test]
fn distance_agrees_with_a_ray_search_in_poses_by_matrix_products() {
    let mut bench = bench_with_sensor_truth(ZERO_OFFSET_AND_TILT_TOML);
    bench.machine.tool_mm = STYLUS_CENTRE_MM;
    bench.truth.errors = STATED_ERRORS.map(|(key, value)| (key.to_owned(), value)).into();
    bench.truth.ball_form_um = 40.0;
    bench.truth.ball =
        toml::from_str::<MachineTruth>("[[ball]]\nid = '1'\noffset_mm = [0.2, -0.1, 0.3]\ndiameter_um = 50.0")
            .unwrap()
            .ball;
    let oval = random_draws::draw_ball_oval(0, 0) * 0.040;
    let centre = Vector3::new(0.2, -0.1, 50.3);
    let gap = |point: Vector3<f64>| {
        let u = (point - centre).normalize();
        (point - centre).norm() - BALL_RADIUS_MM - 0.025 - u.dot(&(oval * u))
    };
    let nominal = Sensor { zero_mm: STYLUS_CENTRE_MM, ..downward_sensor() };
    let poses = [[0.0, 0.0, 0.0], [30.0, 100.0, 200.0], [-90.0, 180.0, 90.0], [90.0, -250.0, 10.0]];
    for [b, c, s] in poses.map(|pose: [f64; 3]| pose.map(f64::to_radians)) {
        let others = Position::new().with(Axis::B, b).with(Axis::C, c).with(Axis::S, s);
        let (table, spindle) = table_and_spindle_poses_by_products(&others);
        let up = (table.try_inverse().unwrap() * spindle * Vector4::z()).xyz().normalize();
        for aside in [Vector3::zeros(), Vector3::new(4.0, 1.0, 0.0), Vector3::new(-3.0, 3.0, 2.0)] {
            let at = position_for_ball_centre(centre + up * 12.0 + (aside - up * up.dot(&aside)), &others);
            let (table, spindle) = table_and_spindle_poses_by_products(&at);
            let on_table = table.try_inverse().unwrap() * spindle;
            let zero = Vector3::from(STYLUS_CENTRE_MM) + Vector3::new(0.120, -0.080, 0.300);
            let origin = (on_table * zero.push(1.0)).xyz();
            let beam = Vector4::new(0.002, -0.0035, -1.0, 0.0).normalize();
            let along = (on_table * beam).xyz();
            assert_distance_mm(sample_sensor_at(&bench, &nominal, &at), ray_distance_to_zero_gap(origin, along, gap));
        }
    }
}

#[test]
fn gain_linearity_incidence_lean_and_spot_change_the_output_as_declared() {
    let top = position_with_ball_at(0.0, 0.0, 65.0);
    let slope = position_with_ball_at(6.0, 0.0, 65.0);
    assert_distance_mm(sample_downward_sensor_at(&bench_with_sensor_truth("gain = 1.002"), &top), 5.01);
    let wave = "linearity = [{ amplitude_um = 3.0, period_mm = 4.0, phase_deg = 0.0 }]";
    // The phase is a period and a quarter.
    assert_distance_mm(sample_downward_sensor_at(&bench_with_sensor_truth(wave), &top), 5.003);
    // The slope of 6, 8, 10 is 3/4.
    assert_distance_mm(sample_downward_sensor_at(&bench_with_sensor_truth("incidence_um = 16.0"), &slope), 7.009);
    assert_distance_mm(sample_downward_sensor_at(&bench_with_sensor_truth("incidence_um = 16.0"), &top), 5.0);
    assert_distance_mm(sample_downward_sensor_at(&bench_with_sensor_truth("lean_um = [4.0, 100.0]"), &slope), 7.003);
    assert_distance_mm(
        sample_downward_sensor_at(
            &bench_with_sensor_truth("lean_um = [4.0, 100.0]"),
            &position_with_ball_at(-6.0, 0.0, 65.0),
        ),
        6.997,
    );
    assert_distance_mm(
        sample_downward_sensor_at(
            &bench_with_sensor_truth("lean_um = [100.0, 4.0]"),
            &position_with_ball_at(0.0, 6.0, 65.0),
        ),
        7.003,
    );
    // The mean of R − √(R² − r²) over a disc of radius a.
    let spot = sample_downward_sensor_at(&bench_with_sensor_truth("spot_mm = 0.2"), &top);
    let SensorOutput::Distance(spot) = spot else { panic!("{spot:?}") };
    let mean = 0.1_f64.powi(2) / (4.0 * BALL_RADIUS_MM) + 0.1_f64.powi(4) / (24.0 * BALL_RADIUS_MM.powi(3));
    assert!((spot - 5.0 - mean).abs() <= 2e-9, "{spot}");
}

#[test]
fn noise_and_linearity_without_stated_truth_are_drawn_from_the_seed() {
    let samples = |bench: &TestBench, sensor: Sensor, count: usize| -> Vec<f64> {
        let mut world = bench.build_world().with_sensors(&[sensor]).unwrap();
        world.travel(&position_with_ball_at(0.0, 0.0, 63.0), Speed::Rapid);
        let says = |_| match world.sample_after("laser", 1e-3).unwrap() {
            SensorOutput::Distance(distance) => distance - 3.0,
            other => panic!("{other:?}"),
        };
        (0..count).map(says).collect()
    };
    let noisy = Sensor { noise_um: Some(0.5), ..downward_sensor() };
    let seen = samples(&bench_with_sensor_truth(""), noisy.clone(), 4000);
    let sd = (seen.iter().map(|v| v * v).sum::<f64>() / 4000.0).sqrt();
    assert!((sd - 0.5e-3).abs() < 0.02e-3, "{sd}");
    assert_eq!(seen, samples(&bench_with_sensor_truth(""), noisy.clone(), 4000));
    let mut other = bench_with_sensor_truth("");
    other.truth.seed = 1;
    assert_ne!(seen, samples(&other, noisy.clone(), 4000));
    let quiet = samples(&bench_with_sensor_truth("noise_um = 0.0"), noisy.clone(), 3);
    assert!(quiet.iter().all(|v| v.abs() < 1e-9), "{quiet:?}");
    // After a pause no noise value repeats.
    let mut later = bench_with_sensor_truth("").build_world().with_sensors(&[noisy]).unwrap();
    later.advance(1.0, []);
    later.travel(&position_with_ball_at(0.0, 0.0, 63.0), Speed::Rapid);
    let Some(SensorOutput::Distance(again)) = later.sample_after("laser", 0.0) else { panic!() };
    assert!(seen.iter().all(|v| (v + 3.0 - again).abs() > 1e-12));
    // The curve has the declared standard deviation over machines at every distance.
    let curved = |seed| {
        let mut bench = bench_with_sensor_truth("");
        bench.truth.seed = seed;
        samples(&bench, Sensor { linearity_um: 4.0, ..downward_sensor() }, 1)[0]
    };
    let sd = ((0..500).map(|seed| curved(seed).powi(2)).sum::<f64>() / 500.0).sqrt();
    assert!((sd - 4e-3).abs() < 0.4e-3, "{sd}");
}

#[test]
fn a_sensor_samples_by_its_own_clock() {
    let moments = |truth: &str| -> Vec<f64> {
        let mut world = bench_with_sensor_truth(truth).build_world().with_sensors(&[downward_sensor()]).unwrap();
        let moment = |_| {
            world.sample_after("laser", 1e-3).unwrap();
            world.time_s()
        };
        (0..4000).map(moment).collect()
    };
    let last = |moments: &[f64]| moments[3999];
    assert!((last(&moments("")) - 4.0).abs() < 1e-9);
    assert!((last(&moments("clock_slow_ppm = 50.0")) - 4.0002).abs() < 1e-9);
    let jittered = moments("clock_jitter_us = 20.0");
    let late = jittered.iter().zip(1..).map(|(t, n)| t - f64::from(n) * 1e-3);
    let sd = (late.map(|late| late * late).sum::<f64>() / 4000.0).sqrt();
    assert!((sd - 20e-6).abs() < 1e-6, "{sd}");
    assert!(jittered.windows(2).all(|pair| pair[0] <= pair[1]));
}

/// X moves from 0 to 6 mm and then stops, at 10 mm/s after 0.05 mm of acceleration (1000 mm/s²): 0.61 s. A sensor
/// with a latency of 200 ms reports the sphere at X 4.05 when 0.61 s have passed, and at X 6 after 0.81 s.
#[test]
fn delayed_sensor_reports_an_earlier_position() {
    let began = || {
        let mut world =
            bench_with_sensor_truth("clock_late_ms = 200.0").build_world().with_sensors(&[downward_sensor()]).unwrap();
        world.travel(&position_with_ball_at(0.0, 0.0, 65.0), Speed::Rapid);
        world.dwell(1.0);
        world
    };
    let depth = |x: f64| 15.0 - (BALL_RADIUS_MM * BALL_RADIUS_MM - x * x).sqrt();
    let end = position_with_ball_at(6.0, 0.0, 65.0);
    let speed = Speed::Feed { mm_min: 600.0 };
    let mut world = began();
    let moved = world.travel(&end, speed).duration_s;
    assert!((moved - 0.61).abs() < 1e-9, "{moved}");
    assert_distance_mm(world.sample_after("laser", 0.0).unwrap(), depth(4.05));
    assert_distance_mm(world.sample_after("laser", 0.2).unwrap(), depth(6.0));
    assert_distance_mm(world.sample_after("laser", 5.0).unwrap(), depth(6.0));
    // The same during a move: the current axis positions are displayed, the earlier ones are measured.
    let mut world = began();
    let passing = world.move_and_sample("laser", &end, speed, 0.01);
    assert!(passing.len() >= 60);
    let at = |n: usize| (passing[n - 1].displayed_position.get_or_zero(Axis::X), passing[n - 1].output);
    assert!((at(50).0 - 4.95).abs() < 1e-9, "{:?}", at(50));
    assert_distance_mm(at(50).1, depth(2.95));
    assert_distance_mm(at(15).1, depth(0.0));
    assert_distance_mm(at(21).1, depth(0.05));
    assert!((world.displayed_position().get_or_zero(Axis::X) - 6.0).abs() < 1e-12);
    assert!((world.time_s() - passing[59].world_time_s).abs() < 0.011);
}

#[test]
fn table_drift_changes_the_measured_distance() {
    let mut bench = bench_with_sensor_truth("");
    bench.machine.drift_um_per_h = 30.0;
    let mut world = bench.build_world().with_sensors(&[downward_sensor()]).unwrap();
    world.travel(&position_with_ball_at(0.0, 0.0, 65.0), Speed::Rapid);
    let said = world.sample_after("laser", 3600.0).unwrap();
    let drift = Vector3::from(world.true_table_drift_mm(world.time_s()));
    assert!(drift.z.abs() > 1e-3, "{drift:?}");
    let sideways2 = drift.x.powi(2) + drift.y.powi(2);
    assert_distance_mm(said, 15.0 - drift.z - (BALL_RADIUS_MM * BALL_RADIUS_MM - sideways2).sqrt());
}

#[test]
fn beam_measures_distances_to_stems_and_cylinders() {
    let stem = "[[balls]]\nid = '1'\ncentre_mm = [0.0, 0.0, 50.0]\nradius_mm = 10.0
        stem = [1.0, 0.0, 0.0]\nstem_radius_mm = 3.0\nstem_length_mm = 40.0";
    let over_stem = sample_downward_sensor_at(&TestBench::with_balls(stem), &position_with_ball_at(20.0, 0.0, 60.0));
    assert_distance_mm(over_stem, 7.0);
    let part = TestBench::ideal();
    assert_distance_mm(sample_downward_sensor_at(&part, &position_with_ball_at(10.0, -7.0, 102.0)), 2.0);
    let level = laser_with_keys("zero_mm = [0.0, 0.0, -100.0]\ndirection = [1.0, 0.0, 0.0]");
    assert_distance_mm(sample_sensor_at(&part, &level, &position_with_ball_at(-50.0, 0.0, 30.0)), 5.0);
}

#[test]
fn invalid_sensors_are_refused_with_their_reason() {
    let refused = |truth: &str, sensors: &[Sensor]| {
        bench_with_sensor_truth(truth).build_world().with_sensors(sensors).unwrap_err().to_string()
    };
    assert!(refused("", &[]).contains("`laser`"), "{}", refused("", &[]));
    assert!(refused("", &[downward_sensor(), downward_sensor()]).contains("twice"));
    for (truth, key) in [
        ("gain = 0.0", "gain"),
        ("spot_mm = -1.0", "spot_mm"),
        ("noise_um = nan", "noise_um"),
        ("echo_limit_deg = 90.0", "echo_limit_deg"),
        ("dazzled_deg = 45.0", "dazzled_deg"),
        ("clock_slow_ppm = 1e6", "clock_slow_ppm"),
        ("clock_jitter_us = -1.0", "clock_jitter_us"),
        ("clock_late_ms = -1.0", "clock_late_ms"),
        ("linearity = [{ amplitude_um = 1.0, period_mm = 0.0 }]", "linearity"),
        ("tilt_urad = [inf, 0.0]", "tilt_urad"),
    ] {
        let said = refused(truth, &[downward_sensor()]);
        assert!(said.contains("`laser`") && said.contains(key), "{said}");
    }
    let blind = Sensor { direction: [0.0; 3], ..downward_sensor() };
    assert!(refused("", &[blind]).contains("direction"));
    let narrow = Sensor { range_mm: [5.0, 5.0], ..downward_sensor() };
    assert!(refused("", &[narrow]).contains("range_mm"));
    assert!(toml::from_str::<MachineTruth>("[[sensor]]\nname = 'a'\ntilt = 3").is_err());
}
