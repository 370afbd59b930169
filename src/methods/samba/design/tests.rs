//! The design for the machine and the balls of paper 4, and for those of `config/samba.toml`.

use faer::Mat;
use faer::linalg::solvers::DenseSolveCore;

use super::{DesignCandidates, DesignSetup, design_visits, rank_check};
use crate::ball_measurement::{BallVisit, describe_rotary_axes_in_degrees, visits_machine_time_s};
use crate::samba::settings::{DesignKind, OptimalityCriterion, SambaSettings};
use crate::samba::tests::{built_in, machine};
use estimation::linear_least_squares::{LinearProblem, RANK_THRESHOLD, solve_least_squares};
use machine::record::artefact::{Artefact, Ball, Balls, CertifiedLength};
use machine::record::plan::Plan;
use machine::record::report_data::ReportData;

/// Paper 4, table 1 (samba-balls.csv): balls 1 and 2 are the scale bar. The stems point down to the table.
pub const RUMBA_CENTRES_MM: [[f64; 3]; 6] = [
    [-152.4, 0.0, 40.855],
    [152.4, 0.0, 40.435],
    [160.0, 160.0, 177.835],
    [-160.0, 160.0, 177.695],
    [-160.0, -160.0, 75.605],
    [160.0, -160.0, 76.045],
];

pub fn rumba_balls() -> Balls {
    let ball = |(index, centre): (usize, &[f64; 3])| Ball {
        id: (index + 1).to_string(),
        centre_mm: *centre,
        radius_mm: 9.525,
        stem: [0.0, 0.0, -1.0],
        stem_radius_mm: 4.0,
        stem_length_mm: centre[2],
    };
    let length = r#"{"from":"1","to":"2","mm":304.8,"u_mm":0.0001}"#;
    let length: CertifiedLength = serde_json::from_str(length).unwrap();
    Balls {
        certificate_u_mm: None,
        expansion_um_per_m_k: None,
        temperature_c: None,
        u_temperature_k: None,
        balls: RUMBA_CENTRES_MM.iter().enumerate().map(ball).collect(),
        lengths: vec![length],
        uncertainty_mm: 1.0,
    }
}

pub fn rumba_plan(settings: &SambaSettings) -> Plan {
    Plan {
        trued_plan: 1,
        method: "samba".into(),
        settings: serde_json::to_value(settings).unwrap(),
        machine: machine("wCBXFZYSt"),
        probe: serde_json::from_str(r#"{"ball_radius_mm":3.0}"#).unwrap(),
        sensors: Vec::new(),
        keepout: Vec::new(),
        solids: Vec::new(),
        artefact: Artefact::Balls(rumba_balls()),
        priors: Vec::new(),
        interruption_times_s: Vec::new(),
        assumed: Vec::new(),
        compensations_active: Vec::new(),
        report: ReportData::default(),
        steps: Vec::new(),
    }
}

/// G4 (METHODS section 4) on the built-in machine: rank, condition, and the standard deviations at 1 µm noise
/// and u = 0.1 µm.
fn check_gate_g4(kind: (DesignKind, OptimalityCriterion)) {
    let (mut plan, settings) = (built_in::built_in_plan(), built_in::settings(kind));
    // The noise of the gate; the design is that of the declared probe.
    plan.probe.repeatability_um = Some(1.0);
    let setup = DesignSetup::new(&plan, &settings).unwrap();
    let visits = built_in::cached_visits(kind);
    let measured: usize = visits.iter().map(|visit| visit.ball_indices.len()).sum();
    assert_eq!((visits.len(), measured), (32, 109));
    for ball in 0..6 {
        let shown = visits.iter().filter(|visit| visit.ball_indices.contains(&ball)).count();
        assert!(shown >= 3, "ball {ball} is measured {shown} times");
    }
    for (index, visit) in visits.iter().enumerate() {
        println!("{} {:?}", describe_rotary_axes_in_degrees(&visit.rotary_position), visit.ball_indices);
        assert!(visits[..index].iter().all(|other| other.rotary_position != visit.rotary_position), "twice");
    }
    let (matrix, names) = rank_check::design_matrix(&setup, visits).unwrap();
    let found = rank_check::check_rank_and_condition(&setup, visits).unwrap();
    println!("rank {} condition {:.2}", found.rank, found.condition);
    assert!(found.rank == 34 && found.condition < 40.0);
    let ones = vec![1.0; matrix.nrows()];
    let problem =
        LinearProblem { a: matrix.as_ref(), y: &ones, sigma: &ones, constraints: None, rank_threshold: RANK_THRESHOLD };
    let covariance = solve_least_squares(&problem).unwrap().covariance;
    for (index, name) in names.iter().take(13).enumerate() {
        let sd = covariance[(index, index)].sqrt();
        let limit = match name.as_str() {
            "EXX1" | "EYY1" | "EZZ1" => 2.5e-6,
            "EX0C" | "EX0S" | "EY0S" => 0.8e-3,
            _ => 2e-6,
        };
        println!("{name}: {:.2} of what METHODS asks", sd / limit);
        assert!(sd <= limit, "{name} {sd:e}");
    }
}

#[test]
fn gate_g4_built_in_designs_meet_the_uncertainty_limits() {
    built_in::ALL_DESIGNS.into_iter().for_each(check_gate_g4);
}

/// The design has as many balls as 25 minutes allow, and hardly fewer.
#[test]
fn design_keeps_the_time_budget() {
    let settings = SambaSettings { minutes: 25.0, ..SambaSettings::default() };
    let plan = rumba_plan(&settings);
    let setup = DesignSetup::new(&plan, &settings).unwrap();
    let time_s = |visits: &[BallVisit]| visits_machine_time_s(&setup.measurement_setup(), visits);
    let visits = design_visits(&setup, time_s).unwrap();
    let minutes = time_s(&visits).unwrap() / 60.0;
    let balls: usize = visits.iter().map(|visit| visit.ball_indices.len()).sum();
    println!("{balls} balls in {minutes:.2} minutes");
    assert!(minutes <= 25.0 && minutes > 23.5, "{minutes} minutes");
    assert!((18..109).contains(&balls), "{balls} balls");
}

/// A random choice of the same number of balls gives less information than the greedy choice.
#[test]
fn random_design_has_less_information() {
    let settings = SambaSettings::default();
    let plan = rumba_plan(&settings);
    let setup = DesignSetup::new(&plan, &settings).unwrap();
    let access = setup.measurement_setup().touch_access(&plan.artefact).unwrap();
    let candidates = DesignCandidates::new(&setup, &access).unwrap();
    // log det of the covariance of the machine's parameters.
    let volume = |visits: &[BallVisit]| {
        let (matrix, _) = rank_check::design_matrix(&setup, visits).unwrap();
        let information = matrix.transpose() * &matrix;
        let scale = |i: usize| information[(i, i)].sqrt();
        let scaled = Mat::from_fn(34, 34, |i, j| information[(i, j)] / (scale(i) * scale(j)));
        let inverse = scaled.partial_piv_lu().inverse();
        let of_machine = Mat::from_fn(13, 13, |i, j| inverse[(i, j)] / (scale(i) * scale(j)) * 1e10);
        of_machine.determinant().ln()
    };
    let chosen = volume(&design_visits(&setup, |_| Ok(0.0)).unwrap());
    for seed in 0..5_usize {
        let stride = 7 + 2 * seed;
        let all = candidates.measurements.len();
        let mut drawn: Vec<usize> = (0..109).map(|k| (seed + k * stride) % all).collect();
        drawn.sort_unstable();
        drawn.dedup();
        let by_chance = volume(&candidates.visits_of_chosen(&drawn));
        println!("{chosen:.2} against {by_chance:.2} with {} balls", drawn.len());
        assert!(chosen < by_chance, "{chosen} against {by_chance}");
    }
}

/// If only the table turns, the length of the stylus shifts all balls alike: it is fixed and not an unknown.
#[test]
fn four_axis_design_has_full_rank_with_fixed_stylus_length() {
    for (topology, unknowns) in [("wCFXYZt", 7 + 2 + 18), ("wCFXYZSt", 9 + 2 + 18)] {
        let settings = SambaSettings::default();
        let plan = Plan { machine: machine(topology), ..rumba_plan(&settings) };
        let setup = DesignSetup::new(&plan, &settings).unwrap();
        let visits = design_visits(&setup, |_| Ok(0.0)).unwrap();
        let found = rank_check::check_rank_and_condition(&setup, &visits).unwrap();
        println!("{topology}: {} indexations, condition {:.1}", visits.len(), found.condition);
        assert_eq!((found.rank, found.nullity), (unknowns, 0), "{topology}");
        let (_, names) = rank_check::design_matrix(&setup, &visits).unwrap();
        assert!(names.iter().any(|name| name == "t_x") && !names.iter().any(|name| name == "t_z"));
    }
}
