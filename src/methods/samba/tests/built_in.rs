//! The built-in designs on the built-in machine and balls (`config/samba.toml`): the tests of this folder
//! measure what `trued run samba` measures.

use std::sync::OnceLock;

use serde::Deserialize;

use super::htm::Triple;
use crate::ball_measurement::Visit;
use crate::samba::Settings;
use crate::samba::design::{DesignSetup, design};
use crate::samba::settings::{Criterion, Design};
use machine::Axis;
use machine::record::plan::{PLAN_VERSION, Plan};

/// The designs that a user can select; D-optimal is the default.
pub const OPTIMAL: (Design, Criterion) = (Design::Optimal, Criterion::D);
pub const ALL: [(Design, Criterion); 3] =
    [OPTIMAL, (Design::Optimal, Criterion::A), (Design::Paper, Criterion::D)];

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

pub fn settings((design, criterion): (Design, Criterion)) -> Settings {
    Settings { design, criterion, ..Settings::default() }
}

/// The design in measuring order.
pub fn visits(kind: (Design, Criterion)) -> &'static [Visit] {
    static MADE: [OnceLock<Vec<Visit>>; ALL.len()] = [const { OnceLock::new() }; ALL.len()];
    let index = ALL.iter().position(|known| *known == kind).unwrap();
    MADE[index].get_or_init(|| {
        let (plan, settings) = (plan(), settings(kind));
        let bench = DesignSetup::new(&plan, &settings).unwrap();
        design(&bench, |_| Ok(0.0)).unwrap()
    })
}

/// The design [`OPTIMAL`] with other positions of C.
pub fn turned_by(turn_deg: &[f64]) -> Vec<(Triple, usize)> {
    let settings = Settings { turn_deg: turn_deg.to_vec(), ..settings(OPTIMAL) };
    let plan = plan();
    let bench = DesignSetup::new(&plan, &settings).unwrap();
    of_visits(&design(&bench, |_| Ok(0.0)).unwrap())
}

/// The measurements of the design, one after the other: B, C, S in rad, and the index of the ball from 0.
pub fn measurements(kind: (Design, Criterion)) -> Vec<(Triple, usize)> {
    let all = of_visits(visits(kind));
    assert_eq!((visits(kind).len(), all.len()), (32, 109));
    all
}

fn of_visits(visits: &[Visit]) -> Vec<(Triple, usize)> {
    let one = |visit: &Visit| {
        let triple = [Axis::B, Axis::C, Axis::S].map(|axis| visit.at.get(axis).unwrap());
        visit.balls.iter().map(|ball| (triple, *ball)).collect::<Vec<_>>()
    };
    visits.iter().flat_map(one).collect()
}
