//! From readings to the estimate, with the independent model of the machine of paper 4: touches instead of
//! centres.

use faer::Mat;
use faer::linalg::solvers::Solve;
use nalgebra::Vector3;
use rand_distr::{Distribution, StandardNormal};

use super::built_in::{D_OPTIMAL_DESIGN, design_measurements};
use super::reference_machine::{BcsAnglesRad, ReferenceMachine};
use super::{BAR_LENGTH_MM, PAPER_TOOL_TIP_MM, machine, paper_ball_centres, paper_errors, true_ball_centres};
use crate::IdentifyError;
use crate::decision::judge_estimate;
use crate::samba::SambaSettings;
use crate::samba::identify::identify;
use estimation::coverage;
use estimation::random::seeded_stream;
use machine::record::artefact::{Artefact, Ball, Balls, CertifiedLength};
use machine::record::estimate::{Estimate, Parameter, ParameterTolerance, Unit, Verdict};
use machine::record::plan::{PLAN_VERSION, Plan, Step, StepKind};
use machine::record::reading::{Reading, ReadingFlag};
use machine::record::report_data::ReportData;
use machine::{Axis, Position};
use testing::population::{event_count_limit, population_size};

const BALL_RADIUS_MM: f64 = 10.0;
const STYLUS_BALL_RADIUS_MM: f64 = 3.0;
const REPEATABILITY_UM: f64 = 0.5;
const TOUCH_AZIMUTHS_DEG: [(&str, f64); 5] =
    [("+45", 45.0), ("-135", -135.0), ("-45", -45.0), ("+135", 135.0), ("pole", f64::NAN)];

/// Errors of the simulated world besides the thirteen machine errors.
pub struct SimulatedMeasurement {
    pub seed: u64,
    pub touch_noise_std_um: f64,
    pub stated_bar_mm: f64,
    /// Declared standard deviation of positioning and straightness errors of X, Y and Z, µm.
    pub motion_std_um: f64,
    /// Displacement of a ball from its position at a visit, mm.
    pub ball_shift: fn(ball: usize, visit: usize, bcs_rad: BcsAnglesRad) -> Vector3<f64>,
    /// Design of the measurements.
    pub design: fn() -> Vec<(BcsAnglesRad, usize)>,
}

pub const FAULTLESS_MEASUREMENT: SimulatedMeasurement = SimulatedMeasurement {
    seed: 1,
    touch_noise_std_um: REPEATABILITY_UM,
    stated_bar_mm: BAR_LENGTH_MM,
    motion_std_um: 0.0,
    ball_shift: |_, _, _| Vector3::zeros(),
    design: || design_measurements(D_OPTIMAL_DESIGN),
};
const ERROR_WAVELENGTH_MM: f64 = 200.0;

impl SimulatedMeasurement {
    pub fn measure(&self) -> (Plan, Vec<Reading>) {
        let balls = true_ball_centres();
        let truth = ReferenceMachine { errors: paper_errors().into_iter().collect(), tool: PAPER_TOOL_TIP_MM };
        let mut normal = StandardNormal.sample_iter(seeded_stream(self.seed, &[]));
        let motions = LinearErrorMotions::draw(self.seed, self.motion_std_um * 1e-3);
        let (mut steps, mut readings) = (Vec::new(), Vec::new());
        for (visit, (bcs_rad, ball)) in (self.design)().into_iter().enumerate() {
            let place = |xyz: Vector3<f64>| {
                let rotary = [Axis::B, Axis::C, Axis::S].into_iter().zip(bcs_rad);
                Position::from_xyz(xyz).updated_by(&rotary.collect())
            };
            let centre = balls[ball] + (self.ball_shift)(ball, visit, bcs_rad);
            let origin = truth.axis_positions_at_ball(centre, bcs_rad);
            for (touch, azimuth) in TOUCH_AZIMUTHS_DEG {
                let (s, c) = azimuth.to_radians().sin_cos();
                let n = if azimuth.is_nan() { Vector3::z() } else { Vector3::new(c, s, 0.0) };
                let on_table = truth.tip_in_table(origin + n, bcs_rad) - truth.tip_in_table(origin, bcs_rad);
                let deviation: f64 = normal.next().unwrap();
                let apart = BALL_RADIUS_MM + STYLUS_BALL_RADIUS_MM + deviation * self.touch_noise_std_um * 1e-3;
                let xyz = truth.axis_positions_at_ball(centre + on_table.normalize() * apart, bcs_rad);
                let xyz = xyz - motions.displacement_at(xyz);
                let id = steps.len() as u32;
                steps.push(Step {
                    id,
                    stage: 0,
                    kind: StepKind::Touch,
                    label: format!("slow/{:03}/{}/{touch}", visit + 1, ball + 1),
                    from: place(xyz + n),
                    to: place(xyz - n),
                    feed_mm_min: 30.0,
                    sensors: vec!["probe".into()],
                    normal: n.into(),
                    scan: None,
                    text: None,
                    mount: None,
                    watch: Vec::new(),
                });
                readings.push(Reading {
                    step: id,
                    repeat: 0,
                    position: place(xyz),
                    value_mm: None,
                    sensor: "probe".into(),
                    t_s: f64::from(id) * 5.0,
                    flag: ReadingFlag::None,
                    temperatures_c: Default::default(),
                });
            }
        }
        (self.plan(steps), readings)
    }

    fn plan(&self, steps: Vec<Step>) -> Plan {
        let mut machine = machine("wCBXFZYSt");
        machine.tool_mm = [0.0, 0.0, -326.717];
        for axis in Axis::LINEAR {
            let spec = machine.axes.get_mut(&axis).unwrap();
            spec.error_motion_um = self.motion_std_um;
            spec.error_wavelength_mm = ERROR_WAVELENGTH_MM;
        }
        let probe = format!(r#"{{"ball_radius_mm":{STYLUS_BALL_RADIUS_MM},"repeatability_um":{REPEATABILITY_UM}}}"#);
        let ball = |(i, centre): (usize, Vector3<f64>)| Ball {
            id: (i + 1).to_string(),
            centre_mm: centre.into(),
            radius_mm: BALL_RADIUS_MM,
            stem: [0.0, 0.0, -1.0],
            stem_radius_mm: 0.0,
            stem_length_mm: 0.0,
        };
        let bar = CertifiedLength {
            from: "1".into(),
            to: "2".into(),
            mm: self.stated_bar_mm,
            u_mm: 1e-4,
            expansion_um_per_m_k: 0.0,
            temperature_c: None,
            u_temperature_k: 0.0,
        };
        let balls = Balls {
            certificate_u_mm: None,
            expansion_um_per_m_k: None,
            temperature_c: None,
            u_temperature_k: None,
            balls: paper_ball_centres().into_iter().enumerate().map(ball).collect(),
            lengths: if self.stated_bar_mm > 0.0 { vec![bar] } else { Vec::new() },
            uncertainty_mm: 2.0,
        };
        Plan {
            trued_plan: PLAN_VERSION,
            method: "samba".into(),
            settings: serde_json::Value::Null,
            machine,
            probe: serde_json::from_str(&probe).unwrap(),
            sensors: Vec::new(),
            keepout: Vec::new(),
            solids: Vec::new(),
            artefact: Artefact::Balls(balls),
            priors: Vec::new(),
            interruption_times_s: Vec::new(),
            assumed: Vec::new(),
            compensations_active: Vec::new(),
            report: ReportData::default(),
            steps,
        }
    }

    pub fn identify(&self) -> Result<Estimate, IdentifyError> {
        self.identify_with_trials(settings_with_2000_trials().monte_carlo_trials)
    }

    fn identify_with_trials(&self, monte_carlo_trials: usize) -> Result<Estimate, IdentifyError> {
        let (plan, readings) = self.measure();
        identify(&plan, &SambaSettings { monte_carlo_trials, ..settings_with_2000_trials() }, &readings)
    }
}

/// Nine smooth functions, each a sum of cosines of random wavelength, zero at position zero.
struct LinearErrorMotions {
    amplitude_mm: f64,
    /// Frequency and phase of each wave, for each axis and direction.
    waves: Vec<Vec<(f64, f64)>>,
}

impl LinearErrorMotions {
    fn draw(seed: u64, sigma: f64) -> Self {
        const WAVE_COUNT: usize = 40;
        let mut normal = StandardNormal.sample_iter(seeded_stream(seed, &[9]));
        let mut next = || -> f64 { normal.next().unwrap() };
        // A phase with a standard deviation of ten turns is practically uniform.
        let mut wave = || (next() / ERROR_WAVELENGTH_MM, next() * 60.0);
        let waves = (0..9).map(|_| (0..WAVE_COUNT).map(|_| wave()).collect()).collect();
        Self { amplitude_mm: sigma * (2.0 / WAVE_COUNT as f64).sqrt(), waves }
    }

    fn displacement_at(&self, xyz: Vector3<f64>) -> Vector3<f64> {
        let value = |axis: usize, along: usize| -> f64 {
            let waves = self.waves[3 * axis + along].iter();
            waves.map(|(w, p)| (w * xyz[axis] + p).cos() - p.cos()).sum::<f64>() * self.amplitude_mm
        };
        let along = |along: usize| (0..3).map(|axis| value(axis, along)).sum();
        Vector3::new(along(0), along(1), along(2))
    }
}

pub fn settings_with_2000_trials() -> SambaSettings {
    SambaSettings { monte_carlo_trials: 2_000, ..SambaSettings::default() }
}

pub fn find_parameter<'a>(estimate: &'a Estimate, symbol: &str) -> &'a Parameter {
    estimate.parameters.iter().find(|p| p.symbol == symbol).unwrap()
}

pub fn has_warning(estimate: &Estimate, words: &[&str]) -> bool {
    estimate.warnings.iter().any(|line| words.iter().all(|word| line.contains(word)))
}

#[test]
fn a_sound_run_gives_its_errors_back_within_u() {
    let estimate = FAULTLESS_MEASUREMENT.identify().unwrap();
    println!("{:?}\n{:?}\n{:?}", estimate.warnings, estimate.weakest, estimate.not_identifiable);
    assert_eq!((estimate.rank, estimate.unknowns, estimate.degrees_of_freedom), (34, 34, 294));
    assert!(estimate.condition < 40.0 && estimate.weakest.is_some());
    assert!((0.75..1.25).contains(&estimate.chi2_per_dof), "{}", estimate.chi2_per_dof);
    assert!(estimate.warnings.is_empty(), "{:?}", estimate.warnings);
    let [of_c, of_s, sizes] = &estimate.not_identifiable[..] else { panic!() };
    assert!(of_c.starts_with("error motions of C at orders 4, 8, 12: "), "{of_c}");
    assert!(of_s.starts_with("error motions of S at orders 4, 8, 12: "), "{of_s}");
    assert!(sizes.starts_with("deviations of a single measurement below "), "{sizes}");
    for (name, expected) in paper_errors() {
        let found = find_parameter(&estimate, &name);
        let expected = found.unit.to_reported_value(expected);
        println!("{name}: {:.2} ± {:.2}, true {expected:.2}", found.value, found.expanded);
        assert!((found.value - expected).abs() < 3.5 * found.u, "{name}");
        assert!((found.u_monte_carlo.unwrap() / found.u - 1.0).abs() < 0.08, "{name}");
        let squares: f64 = found.budget.iter().map(|line| line.u.powi(2)).sum();
        assert!((squares.sqrt() / found.u - 1.0).abs() < 1e-6, "{name}: {:?}", found.budget);
    }
    assert_eq!(find_parameter(&estimate, "tool_z").unit.symbol(), "mm");
    assert!((find_parameter(&estimate, "tool_x").value - PAPER_TOOL_TIP_MM.x).abs() < 3e-3);
    let centre = true_ball_centres()[2];
    assert!((find_parameter(&estimate, "ball_3_y").value - centre.y).abs() < 3e-3);
    let arrows: usize = estimate.arrows[0].groups.iter().map(|group| group.arrows.len()).sum();
    assert_eq!(arrows, 109);
    assert!(estimate.arrows[0].groups.iter().flat_map(|g| &g.arrows).all(|arrow| !arrow.flagged));
    assert_eq!(estimate.covariance.rows.len(), 34);
    assert!(estimate.gauge[0].contains("EX0B") && !estimate.gauge[0].contains("EX0S"));
    assert_eq!(estimate, FAULTLESS_MEASUREMENT.identify().unwrap());
}

/// Over many seeds the deviations of all unknowns scatter jointly as their covariance predicts, also if
/// positioning and straightness errors of the linear axes, which no unknown describes, are declared.
#[test]
fn deviations_scatter_as_the_covariance_over_seeds() {
    const FULL_SEED_COUNT: u64 = 60;
    let seeds = population_size(FULL_SEED_COUNT);
    for motion_um in [0.0, 1.5] {
        let (mut joint, mut misfits, mut unknowns) = (0.0, 0, 0);
        for seed in 0..seeds {
            let estimate = SimulatedMeasurement { seed, motion_std_um: motion_um, ..FAULTLESS_MEASUREMENT }
                .identify_with_trials(100)
                .unwrap();
            unknowns = estimate.unknowns;
            joint += joint_chi2(&estimate);
            misfits += usize::from(has_warning(&estimate, &["does not explain"]));
        }
        let dof = (seeds as usize * unknowns) as f64;
        let (low, high) = coverage::chi_square_bounds(dof, 0.99).unwrap();
        println!("{motion_um} µm: χ² {:.3} of {:.3} to {:.3}", joint / dof, low / dof, high / dof);
        assert!((low..=high).contains(&joint), "{motion_um} µm: {}", joint / dof);
        let most = event_count_limit(seeds, FULL_SEED_COUNT, (0.01, 1));
        assert!(misfits as u64 <= most, "{motion_um} µm: {misfits} of {seeds} called a misfit");
    }
}

/// χ² of the deviations δ of all unknowns: δᵀ·C⁻¹·δ.
fn joint_chi2(estimate: &Estimate) -> f64 {
    let balls = true_ball_centres();
    let truth = |p: &Parameter| match p.symbol.split('_').collect::<Vec<_>>().as_slice() {
        ["tool", k] => PAPER_TOOL_TIP_MM["xyz".find(k).unwrap()],
        ["ball", id, k] => balls[id.parse::<usize>().unwrap() - 1]["xyz".find(k).unwrap()],
        _ => {
            let errors = paper_errors();
            p.unit.to_reported_value(errors.iter().find(|(name, _)| *name == p.symbol).unwrap().1)
        }
    };
    let count = estimate.parameters.len();
    let u = |i: usize| estimate.parameters[i].u;
    let off = Mat::from_fn(count, 1, |i, _| (estimate.parameters[i].value - truth(&estimate.parameters[i])) / u(i));
    let scaled = Mat::from_fn(count, count, |i, j| estimate.covariance.rows[i][j] / (u(i) * u(j)));
    let solved = scaled.partial_piv_lu().solve(&off);
    (off.transpose() * solved)[(0, 0)]
}

/// A ball that slips by 20 µm half-way is named, with the visits between which it slipped.
#[test]
fn a_ball_that_moved_is_named() {
    let slipped: SimulatedMeasurement = SimulatedMeasurement {
        ball_shift: |ball, visit, _| {
            if ball == 3 && visit > 50 { Vector3::x() * 0.02 } else { Vector3::zeros() }
        },
        ..FAULTLESS_MEASUREMENT
    };
    let estimate = slipped.identify().unwrap();
    println!("{:#?}", estimate.warnings);
    assert!(has_warning(&estimate, &["ball 4 probably moved by", "between"]));
    assert!(has_warning(&estimate, &["the model does not explain the measurements"]));
    let wide = ParameterTolerance { symbol: "EX0C".to_owned(), unit: Unit::Um, limit: 1e6 };
    let mut judged = estimate.clone();
    judge_estimate(&mut judged, &[wide]);
    assert_eq!(judged.verdict, Verdict::UndecidedModel);
    let told = estimate.warnings.iter().find(|line| line.contains("moved by")).unwrap();
    let um: f64 = told.split(' ').nth(5).unwrap().parse().unwrap();
    assert!((um - 20.0).abs() < 2.0, "{told}");
    assert!(!has_warning(&FAULTLESS_MEASUREMENT.identify().unwrap(), &["moved"]));
}

/// If motions are declared, the expectation of χ² differs from the degrees of freedom. The warning states
/// both, and the figure of the estimate is the ratio in the warning. If a run states no number of trials, its
/// trials satisfy the stopping rule.
#[test]
fn misfit_warning_states_the_chi2_of_the_estimate() {
    let shift = |ball, visit, _| {
        if ball == 3 && visit > 50 { Vector3::x() * 0.02 } else { Vector3::zeros() }
    };
    let slipped = SimulatedMeasurement { motion_std_um: 1.5, ball_shift: shift, ..FAULTLESS_MEASUREMENT };
    let estimate = slipped.identify_with_trials(0).unwrap();
    println!("{:#?}", estimate.warnings);
    let told = estimate.warnings.iter().find(|line| line.contains("does not explain")).unwrap();
    let number = |after: &str| -> f64 {
        let (_, rest) = told.split_once(after).unwrap();
        rest.split(' ').next().unwrap().parse().unwrap()
    };
    let (chi2, expected) = (number("(χ² "), number("where "));
    assert_eq!((number("not the "), estimate.degrees_of_freedom), (294.0, 294));
    assert!(expected < 280.0);
    assert!((chi2 / expected / estimate.chi2_per_dof - 1.0).abs() < 0.01, "{told}");
    assert!(!has_warning(&estimate, &["stable"]), "{:?}", estimate.warnings);
}

/// Dirt under one measurement: it is flagged, named and kept; the others are not flagged.
#[test]
fn a_dirty_measurement_is_flagged_and_kept() {
    let dirty = SimulatedMeasurement {
        ball_shift: |_, visit, _| if visit == 40 { Vector3::y() * 0.012 } else { Vector3::zeros() },
        ..FAULTLESS_MEASUREMENT
    };
    let estimate = dirty.identify().unwrap();
    println!("{:#?}", estimate.warnings);
    assert!(has_warning(&estimate, &["at indexation 41", "The result includes this measurement"]));
    let flagged = estimate.arrows[0].groups.iter().flat_map(|g| &g.arrows).filter(|a| a.flagged).count();
    assert_eq!((flagged, estimate.degrees_of_freedom), (1, 294));
    assert!(!has_warning(&estimate, &["moved"]));
}

/// The table sags by 8 µm as it tilts, which is outside the model. A warning states the misfit, and the
/// uncertainties grow.
#[test]
fn sag_is_reported_and_enlarges_the_uncertainties() {
    let sagging = SimulatedMeasurement {
        ball_shift: |_, _, [b, c, _]| Vector3::new(c.cos(), -c.sin(), 1.0) * (0.008 * (3.0 * b).sin().powi(2)),
        ..FAULTLESS_MEASUREMENT
    };
    let (sound, estimate) = (FAULTLESS_MEASUREMENT.identify().unwrap(), sagging.identify().unwrap());
    println!("{:#?} {}", estimate.warnings, estimate.chi2_per_dof);
    assert!(has_warning(&estimate, &["the model does not explain the measurements", "multiplied"]));
    assert!(has_warning(&estimate, &["Sag of the table under the tilt of B would appear in EX0C, EB0C, EB0Z"]));
    assert!(estimate.chi2_per_dof > 2.0);
    let ratio = find_parameter(&estimate, "EX0C").u / find_parameter(&sound, "EX0C").u;
    assert!((ratio / estimate.chi2_per_dof.sqrt() - 1.0).abs() < 0.05, "{ratio}");
    assert!(find_parameter(&estimate, "EX0C").dof.is_some());
}

#[test]
fn wrong_or_missing_bars_are_reported() {
    let long = SimulatedMeasurement { stated_bar_mm: BAR_LENGTH_MM * (1.0 + 400e-6), ..FAULTLESS_MEASUREMENT };
    let estimate = long.identify().unwrap();
    assert!(has_warning(&estimate, &["certified length 1–2", "µm/m"]), "{:?}", estimate.warnings);
    let none = SimulatedMeasurement { stated_bar_mm: 0.0, ..FAULTLESS_MEASUREMENT };
    let Err(IdentifyError::RankDeficient { rank: 33, unknowns: 34, undetermined: what }) = none.identify() else {
        panic!("no bar, and yet a scale")
    };
    assert!(what[0].contains("uniform scale"), "{what:?}");
    // A machine whose scales are taken as true needs no bar; they then check the bar.
    let (plan, readings) = long.measure();
    let mut settings = settings_with_2000_trials();
    let scales = |name: &String| !["EXX1", "EYY1", "EZZ1"].contains(&name.as_str());
    settings.parameters = paper_errors().into_iter().map(|(name, _)| name).filter(scales).collect();
    let estimate = identify(&plan, &settings, &readings).unwrap();
    assert!(has_warning(&estimate, &["certified length 1–2", "the balls as measured"]), "{:?}", estimate.warnings);
}

#[test]
fn unused_measurements_are_named_and_bad_readings_rejected() {
    let (plan, mut readings) = FAULTLESS_MEASUREMENT.measure();
    // Ball 6 keeps two measurements; of another measurement only three touches remain.
    let of_six: Vec<usize> = (0..readings.len()).filter(|i| plan.steps[*i].label.contains("/6/")).collect();
    for i in of_six.iter().skip(10) {
        readings[*i].flag = ReadingFlag::Excluded;
    }
    readings.truncate(readings.len() - 2);
    let estimate = identify(&plan, &settings_with_2000_trials(), &readings).unwrap();
    println!("{:?} {:?}", estimate.warnings, estimate.not_identifiable);
    assert!(estimate.not_identifiable.iter().any(|line| line.contains("ball 6 was measured at 2")));
    assert!(has_warning(&estimate, &["indexation 109 was not used", "3 touches"]));
    let stranger = Reading { step: 9_999, ..readings[0].clone() };
    readings.push(stranger);
    let unknown = identify(&plan, &settings_with_2000_trials(), &readings);
    assert_eq!(unknown, Err(IdentifyError::UnknownStep { step: 9_999 }));
    let last = readings.len() - 1;
    readings[last] = readings[0].clone();
    let twice = identify(&plan, &settings_with_2000_trials(), &readings);
    assert_eq!(twice, Err(IdentifyError::DuplicateReading { step: 0, repeat: 0 }));
}
