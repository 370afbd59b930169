//! The design on the machine and the balls of paper 4.

use super::{Bench, design, survey};
use crate::estimation::linear::{LinearProblem, solve};
use crate::methods::samba::settings::{Design as Kind, Settings};
use crate::methods::samba::tests::machine;
use crate::record::artefact::{Artefact, Ball, Balls, Length};
use crate::record::plan::Plan;

/// Paper 4, table 1 (samba-balls.csv): balls 1 and 2 are the scale bar. Stems down to the table.
pub const RUMBA: [[f64; 3]; 6] = [
    [-152.4, 0.0, 40.855],
    [152.4, 0.0, 40.435],
    [160.0, 160.0, 177.835],
    [-160.0, 160.0, 177.695],
    [-160.0, -160.0, 75.605],
    [160.0, -160.0, 76.045],
];

pub fn rumba() -> Balls {
    let ball = |(index, centre): (usize, &[f64; 3])| Ball {
        id: (index + 1).to_string(),
        centre_mm: *centre,
        radius_mm: 9.525,
        stem: [0.0, 0.0, -1.0],
        stem_radius_mm: 4.0,
        stem_length_mm: centre[2],
    };
    let length = r#"{"from":"1","to":"2","mm":304.8,"u_mm":0.0001}"#;
    let length: Length = serde_json::from_str(length).unwrap();
    Balls {
        balls: RUMBA.iter().enumerate().map(ball).collect(),
        lengths: vec![length],
        uncertainty_mm: 1.0,
    }
}

pub fn plan(settings: &Settings) -> Plan {
    Plan {
        trued_plan: 1,
        method: "samba".into(),
        settings: serde_json::to_value(settings).unwrap(),
        machine: machine("wCBXFZYSt"),
        probe: serde_json::from_str(r#"{"ball_radius_mm":3.0}"#).unwrap(),
        keepout: Vec::new(),
        solids: Vec::new(),
        artefact: Artefact::Balls(rumba()),
        gaps_s: Vec::new(),
        steps: Vec::new(),
    }
}

/// G4 (METHODS section 4): rank, condition, and the standard deviations at 1 um and u = 0.1 um.
fn check_g4(settings: &Settings) {
    let plan = plan(settings);
    let started = std::time::Instant::now();
    let bench = Bench::new(&plan, settings).unwrap();
    let visits = design(&bench, |_| Ok(0.0)).unwrap();
    println!("{:?}", started.elapsed());
    let measured: usize = visits.iter().map(|visit| visit.balls.len()).sum();
    assert_eq!((visits.len(), measured), (32, 109));
    let (matrix, names) = survey::matrix(&bench, &visits).unwrap();
    let found = survey::check(&bench, &visits).unwrap();
    println!("rank {} cond {}", found.rank, found.condition);
    for v in &visits {
        println!("{} {:?}", super::indexation::in_words(&v.at), v.balls);
    }
    let ones = vec![1.0; matrix.nrows()];
    let problem = LinearProblem {
        a: matrix.as_ref(),
        y: &ones,
        sigma: &ones,
        constraints: None,
        rank_threshold: 1e-10,
    };
    let covariance = solve(&problem).unwrap().covariance;
    for (index, name) in names.iter().take(13).enumerate() {
        let sd = covariance[(index, index)].sqrt();
        println!("{name} {sd:.3e}");
    }
    assert!(found.rank == 34 && found.condition < 40.0);
}

#[test]
fn gate_g4_the_optimal_design() {
    check_g4(&Settings::default());
}

#[test]
fn gate_g4_the_papers_design() {
    check_g4(&Settings { design: Kind::Paper, ..Settings::default() });
}
