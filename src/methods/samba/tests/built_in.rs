//! The built-in designs on the built-in machine and balls (`config/samba.toml`): the tests of this folder
//! measure what `trued run samba` measures.

use std::sync::OnceLock;

use serde::Deserialize;

use super::htm::Triple;
use crate::ball_measurement::BallVisit;
use crate::samba::SambaSettings;
use crate::samba::design::{DesignSetup, design_visits};
use crate::samba::settings::{Criterion, Design};
use machine::Axis;
use machine::record::plan::{PLAN_VERSION, Plan};

/// The designs that a user can select; D-optimal is the default.
pub const D_OPTIMAL_DESIGN: (Design, Criterion) = (Design::Optimal, Criterion::D);
pub const ALL_DESIGNS: [(Design, Criterion); 3] =
    [D_OPTIMAL_DESIGN, (Design::Optimal, Criterion::A), (Design::Paper, Criterion::D)];

/// The plan of the machine file `config/samba.toml`.
pub fn plan() -> Plan {
    plan_of(include_str!("../../../../config/samba.toml"), "samba")
}

/// Machine, probe and balls of the file, without measurements.
pub fn plan_of(file: &str, method: &str) -> Plan {
    let mut file: toml::Table = file.parse().unwrap();
    let axes = file["axes"].clone();
    let mut part = |name: &str| file.remove(name).unwrap();
    let mut machine = part("machine");
    machine.as_table_mut().unwrap().insert("axes".to_owned(), axes);
    Plan {
        trued_plan: PLAN_VERSION,
        method: method.into(),
        settings: serde_json::Value::Null,
        machine: machine.try_into().unwrap(),
        probe: part("probe").try_into().unwrap(),
        sensors: Vec::new(),
        keepout: Vec::new(),
        solids: Vec::deserialize(part("solid")).unwrap(),
        artefact: part("artefact").try_into().unwrap(),
        priors: Vec::new(),
        gaps_s: Vec::new(),
        assumed: Vec::new(),
        compensations_active: Vec::new(),
        steps: Vec::new(),
    }
}

pub fn settings((design, criterion): (Design, Criterion)) -> SambaSettings {
    SambaSettings { design, criterion, ..SambaSettings::default() }
}

/// The design in measuring order.
pub fn visits(kind: (Design, Criterion)) -> &'static [BallVisit] {
    static VISITS_OF_DESIGN: [OnceLock<Vec<BallVisit>>; ALL_DESIGNS.len()] =
        [const { OnceLock::new() }; ALL_DESIGNS.len()];
    let index = ALL_DESIGNS.iter().position(|known| *known == kind).unwrap();
    VISITS_OF_DESIGN[index].get_or_init(|| {
        let (plan, settings) = (plan(), settings(kind));
        let setup = DesignSetup::new(&plan, &settings).unwrap();
        design_visits(&setup, |_| Ok(0.0)).unwrap()
    })
}

/// The design [`D_OPTIMAL_DESIGN`] with other positions of C.
pub fn turned_by(turn_deg: &[f64]) -> Vec<(Triple, usize)> {
    let settings = SambaSettings { turn_deg: turn_deg.to_vec(), ..settings(D_OPTIMAL_DESIGN) };
    let plan = plan();
    let setup = DesignSetup::new(&plan, &settings).unwrap();
    ball_measurements(&design_visits(&setup, |_| Ok(0.0)).unwrap())
}

/// The measurements of the design, one after the other: B, C, S in rad, and the index of the ball from 0.
pub fn outlier_measurements(kind: (Design, Criterion)) -> Vec<(Triple, usize)> {
    let all = ball_measurements(visits(kind));
    assert_eq!((visits(kind).len(), all.len()), (32, 109));
    all
}

fn ball_measurements(visits: &[BallVisit]) -> Vec<(Triple, usize)> {
    let one = |visit: &BallVisit| {
        let triple = [Axis::B, Axis::C, Axis::S].map(|axis| visit.rotary_position.get(axis).unwrap());
        visit.balls.iter().map(|ball| (triple, *ball)).collect::<Vec<_>>()
    };
    visits.iter().flat_map(one).collect()
}
