//! Independent simulation: paper 2, Eq. (1) as a product of plain motions, and a beam that is intersected with the
//! sphere.

use nalgebra::{Matrix3, Rotation3, Translation3, Vector3};
use rand_distr::{Distribution, StandardNormal};

use crate::laser_r_test::{LaserRTest, LaserRTestSettings};
use crate::{Method, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod};
use estimation::random::seeded_stream;
use machine::frame::Pose;
use machine::record::plan::{Plan, Sampling, Stage, Step};
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};

/// Paper 2, Table 5: α_BY, β_BY, γ_BY (rad), δx_CB (mm), α_CB (rad).
pub const PAPER_TABLE_5: [f64; 5] = [-3.5e-6, -42e-6, -3.5e-6, -1e-3, 5.2e-6];

/// True values of the simulated machine.
#[derive(Debug, Clone)]
pub struct SimulatedMachine {
    /// Location errors in the order of [`PAPER_TABLE_5`], rad and mm.
    pub location_errors: [f64; 5],
    /// True zero point relative to the spindle datum, and true beam; both differ from the machine file.
    pub zero_point: Vector3<f64>,
    pub beam_direction: Vector3<f64>,
    /// Centre of the sphere, table frame, mm.
    pub ball_centre: Vector3<f64>,
    pub sphere_radius_mm: f64,
    /// Standard deviation of a sample or a touch, µm.
    pub noise_std_um: f64,
    pub seed: u64,
    /// Latency of the sensor: its value at time t belongs to the time t − latency.
    pub latency_s: f64,
    /// Lost motion of X, Y and Z, mm.
    pub lost_motion_mm: f64,
    /// Additional displacement of the table (machine frame, mm) at these positions and this time.
    pub table_displacement: fn(&SimulatedMachine, &Position, f64) -> Vector3<f64>,
    /// Deviation of the reading from the distance, as a function of the distance, mm.
    pub reading_deviation: fn(&SimulatedMachine, f64) -> f64,
}

pub fn table_5_machine(noise_um: f64, seed: u64) -> SimulatedMachine {
    SimulatedMachine {
        location_errors: PAPER_TABLE_5,
        zero_point: Vector3::new(0.21, -0.34, -149.83),
        beam_direction: Vector3::new(1.3e-3, -0.9e-3, -1.0).normalize(),
        ball_centre: Vector3::new(80.4, -0.3, 60.2),
        sphere_radius_mm: 10.0,
        noise_std_um: noise_um,
        seed,
        latency_s: 0.0,
        lost_motion_mm: 0.0,
        table_displacement: |_, _, _| Vector3::zeros(),
        reading_deviation: |_, _| 0.0,
    }
}

fn rotation_pose(matrix: Matrix3<f64>) -> Pose {
    Pose::from_parts(Translation3::identity(), Rotation3::from_matrix_unchecked(matrix))
}

fn rotation_about_x(a: f64) -> Pose {
    let (s, c) = a.sin_cos();
    rotation_pose(Matrix3::from_columns(&[Vector3::x(), Vector3::new(0.0, c, s), Vector3::new(0.0, -s, c)]))
}

fn rotation_about_y(b: f64) -> Pose {
    let (s, c) = b.sin_cos();
    rotation_pose(Matrix3::from_columns(&[Vector3::new(c, 0.0, -s), Vector3::y(), Vector3::new(s, 0.0, c)]))
}

fn rotation_about_z(g: f64) -> Pose {
    let (s, c) = g.sin_cos();
    rotation_pose(Matrix3::from_columns(&[Vector3::new(c, s, 0.0), Vector3::new(-s, c, 0.0), Vector3::z()]))
}

fn translation_along_x(x: f64) -> Pose {
    Pose::from(Translation3::from(Vector3::x() * x))
}

impl SimulatedMachine {
    /// Pose of the table by Eq. (1), without the three parameters that drop out.
    pub fn table_pose(&self, b: f64, c: f64) -> Pose {
        let [alpha, beta, gamma, delta_x, alpha_cb] = self.location_errors;
        let of_b = rotation_about_x(alpha) * rotation_about_y(beta) * rotation_about_z(gamma) * rotation_about_y(-b);
        of_b * translation_along_x(delta_x) * rotation_about_x(alpha_cb) * rotation_about_z(-c)
    }

    /// Distance along the beam to its first intersection with the sphere. X moves the table.
    fn distance_along_beam(&self, at: &Position, t_s: f64) -> Option<f64> {
        let table = translation_along_x(-at.get_or_zero(Axis::X))
            * self.table_pose(at.get_or_zero(Axis::B), at.get_or_zero(Axis::C));
        let centre = table.transform_point(&self.ball_centre.into()).coords + (self.table_displacement)(self, at, t_s);
        let origin = Vector3::new(0.0, at.get_or_zero(Axis::Y), at.get_or_zero(Axis::Z)) + self.zero_point;
        let (from, along) = (origin - centre, self.beam_direction);
        let half = from.dot(&along);
        let root = half * half - from.norm_squared() + self.sphere_radius_mm * self.sphere_radius_mm;
        (root >= 0.0).then(|| -half - root.sqrt())
    }

    /// Position at which the stylus ball, with its centre at `zero_point`, meets the sphere on the straight path of a
    /// touch.
    fn axis_positions_at_contact(&self, step: &Step, stylus: f64, t_s: f64) -> Position {
        let apart = |at: &Position| {
            let table = translation_along_x(-at.get_or_zero(Axis::X))
                * self.table_pose(at.get_or_zero(Axis::B), at.get_or_zero(Axis::C));
            let tip = Vector3::new(0.0, at.get_or_zero(Axis::Y), at.get_or_zero(Axis::Z)) + self.zero_point;
            tip - table.transform_point(&self.ball_centre.into()).coords - (self.table_displacement)(self, at, t_s)
        };
        let mut noise = StandardNormal.sample_iter(seeded_stream(self.seed, &[u64::from(step.id)]));
        let deviation: f64 = noise.next().unwrap();
        let reach = self.sphere_radius_mm + stylus + deviation * self.noise_std_um * 1e-3;
        let (from, way) = (apart(&step.from), apart(&step.to) - apart(&step.from));
        let (a, half) = (way.norm_squared(), from.dot(&way));
        let root = half * half - a * (from.norm_squared() - reach * reach);
        let share = (-half - root.sqrt()) / a;
        assert!((0.0..=1.0).contains(&share), "{}: no contact", step.label);
        let between = |(axis, value)| (axis, value + share * (step.to.get_or_zero(axis) - value));
        let linear = step.from.filter_axes(Axis::is_linear).iter().map(between).collect();
        step.from.updated_by(&linear)
    }

    /// Reading of a touch with a stylus ball of radius `stylus`.
    fn touch_readings(&self, step: &Step, stylus: f64, t_s: &mut f64) -> Vec<Reading> {
        *t_s += 4.0;
        vec![Reading {
            step: step.id,
            repeat: 0,
            position: self.axis_positions_at_contact(step, stylus, *t_s),
            value_mm: None,
            sensor: step.first_sensor().to_owned(),
            t_s: *t_s,
            flag: ReadingFlag::None,
            temperatures_c: Default::default(),
        }]
    }

    pub fn simulate_step(&self, step: &Step, stylus: f64, t_s: &mut f64) -> Vec<Reading> {
        let Some(scan) = &step.scan else { return self.touch_readings(step, stylus, t_s) };
        let samples = match scan.sampling {
            Sampling::Dwell { samples, .. } => samples,
            Sampling::Continuous { rate_hz, .. } => {
                return self.continuous_readings(step, &scan.path, rate_hz, t_s);
            }
        };
        let mut noise = StandardNormal.sample_iter(seeded_stream(self.seed, &[u64::from(step.id)]));
        let (mut readings, mut stands) = (Vec::new(), scan.path[0].clone());
        for at in &scan.path {
            *t_s += 0.3;
            self.follow_with_lost_motion(&mut stands, at);
            let distance = self.distance_along_beam(&stands, *t_s);
            for _ in 0..samples {
                *t_s += 1e-3;
                let deviation: f64 = noise.next().unwrap();
                let shown = |d: f64| d + (self.reading_deviation)(self, d) + deviation * self.noise_std_um * 1e-3;
                readings.push(Reading {
                    step: step.id,
                    repeat: 0,
                    position: at.clone(),
                    value_mm: distance.map(shown),
                    sensor: step.first_sensor().to_owned(),
                    t_s: *t_s,
                    flag: if distance.is_some() { ReadingFlag::None } else { ReadingFlag::Range },
                    temperatures_c: Default::default(),
                });
            }
        }
        readings
    }
}

/// Acceleration of the simulated axes, mm/s².
const ACCELERATION_MM_S2: f64 = 500.0;

/// Distance along a straight path from rest to rest at `t_s` after its start, and its total duration.
fn ramped_distance_and_duration(way: f64, speed: f64, t_s: f64) -> (f64, f64) {
    let speed = speed.min((way * ACCELERATION_MM_S2).sqrt());
    let (rise, whole) = (speed / ACCELERATION_MM_S2, way / speed + speed / ACCELERATION_MM_S2);
    let t = t_s.clamp(0.0, whole);
    let s = match (t < rise, t > whole - rise) {
        (true, _) => ACCELERATION_MM_S2 * t * t / 2.0,
        (_, true) => way - ACCELERATION_MM_S2 * (whole - t) * (whole - t) / 2.0,
        _ => speed * (t - rise / 2.0),
    };
    (s, whole)
}

/// Commanded axis positions at `t_s` after the start of `path`, and the duration of the whole path, s.
pub fn commanded_position_and_duration(path: &[Position], feed_mm_min: f64, t_s: f64) -> (Position, f64) {
    let (mut begins, mut at) = (0.0, path[0].clone());
    for pair in path.windows(2) {
        let xyz = |p: &Position| Vector3::from(Axis::LINEAR.map(|axis| p.get_or_zero(axis)));
        let way = (xyz(&pair[1]) - xyz(&pair[0])).norm();
        let (s, whole) = ramped_distance_and_duration(way, feed_mm_min / 60.0, t_s - begins);
        if t_s > begins {
            for axis in Axis::LINEAR {
                at.set(
                    axis,
                    pair[0].get_or_zero(axis) + (pair[1].get_or_zero(axis) - pair[0].get_or_zero(axis)) * s / way,
                );
            }
        }
        begins += whole;
    }
    (at, begins)
}

impl SimulatedMachine {
    /// Updates the true axis positions for the command `to`, without a reversal in between.
    fn follow_with_lost_motion(&self, true_position: &mut Position, to: &Position) {
        for axis in Axis::LINEAR {
            let (at, half) = (to.get_or_zero(axis), self.lost_motion_mm / 2.0);
            true_position.set(axis, true_position.get_or_zero(axis).clamp(at - half, at + half));
        }
    }

    /// Readings of a continuous scan: the stamped positions are the commanded ones, the axes follow once the lost
    /// motion is taken up, and the sensor reports the value of one latency earlier.
    fn continuous_readings(&self, step: &Step, path: &[Position], rate_hz: f64, t_s: &mut f64) -> Vec<Reading> {
        let mut noise = StandardNormal.sample_iter(seeded_stream(self.seed, &[u64::from(step.id)]));
        let mut stands = path[0].clone();
        let (begins, (_, whole)) = (*t_s + 0.3, commanded_position_and_duration(path, step.feed_mm_min, 0.0));
        let mut readings = Vec::new();
        for k in 0..=(whole * rate_hz) as usize {
            let t = k as f64 / rate_hz;
            let (followed, _) = commanded_position_and_duration(path, step.feed_mm_min, t - self.latency_s);
            self.follow_with_lost_motion(&mut stands, &followed);
            *t_s = begins + t;
            let distance = self.distance_along_beam(&stands, *t_s);
            let deviation: f64 = noise.next().unwrap();
            let shown = |d: f64| d + (self.reading_deviation)(self, d) + deviation * self.noise_std_um * 1e-3;
            readings.push(Reading {
                step: step.id,
                repeat: 0,
                position: commanded_position_and_duration(path, step.feed_mm_min, t).0,
                value_mm: distance.map(shown),
                sensor: step.first_sensor().to_owned(),
                t_s: *t_s,
                flag: if distance.is_some() { ReadingFlag::None } else { ReadingFlag::Range },
                temperatures_c: Default::default(),
            });
        }
        readings
    }
}

/// Plan, stages and readings of a run of the method in this simulation, with `stages` stages at most.
pub fn simulate_run(
    mut plan: Plan,
    settings: &LaserRTestSettings,
    world: &SimulatedMachine,
    stages: usize,
) -> Result<(Plan, Vec<Stage>, Vec<Reading>), MethodRefusal> {
    let method = LaserRTest::new(settings.clone());
    let (mut done, mut readings, mut t_s) = (Vec::new(), Vec::new(), 0.0);
    while done.len() < stages {
        let next = method.next_stage(&plan, &done, ObjectPositionSource::Measured(&readings))?;
        let NextStage::Stage { stage, new_steps } = next else { break };
        plan.steps.extend(new_steps);
        for id in &stage.steps {
            let step = plan.steps.iter().find(|step| step.id == *id).unwrap();
            readings.extend(world.simulate_step(step, plan.probe.ball_radius_mm, &mut t_s));
        }
        done.push(stage);
    }
    Ok((plan, done, readings))
}
