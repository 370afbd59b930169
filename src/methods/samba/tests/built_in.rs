//! The built-in designs on the built-in machine and balls (`config/samba.toml`): the tests of this folder
//! measure what `trued run samba` measures.

use std::sync::OnceLock;

use serde::Deserialize;

use super::reference_machine::BcsAnglesRad;
use crate::ball_measurement::BallVisit;
use crate::samba::SambaSettings;
use crate::samba::design::{DesignSetup, design_visits};
use crate::samba::settings::{DesignKind, OptimalityCriterion};
use machine::Axis;
use machine::record::plan::{PLAN_VERSION, Plan};
use machine::record::report_data::ReportData;

/// The default design.
pub const D_OPTIMAL_DESIGN: (DesignKind, OptimalityCriterion) = (DesignKind::Optimal, OptimalityCriterion::D);
/// The designs that a user can select.
pub const ALL_DESIGNS: [(DesignKind, OptimalityCriterion); 3] =
    [D_OPTIMAL_DESIGN, (DesignKind::Optimal, OptimalityCriterion::A), (DesignKind::Paper, OptimalityCriterion::D)];

/// The plan of the machine file `config/samba.toml`.
pub fn built_in_plan() -> Plan {
    plan_from_machine_file(include_str!("../../../../config/samba.toml"), "samba")
}

/// Machine, probe and balls of the file, without measurements.
pub fn plan_from_machine_file(file: &str, method: &str) -> Plan {
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
        interruption_times_s: Vec::new(),
        assumed: Vec::new(),
        compensations_active: Vec::new(),
        report: ReportData::default(),
        steps: Vec::new(),
    }
}

pub fn settings((design, criterion): (DesignKind, OptimalityCriterion)) -> SambaSettings {
    SambaSettings { design, criterion, ..SambaSettings::default() }
}

/// The design in measuring order.
pub fn cached_visits(kind: (DesignKind, OptimalityCriterion)) -> &'static [BallVisit] {
    static VISITS_OF_DESIGN: [OnceLock<Vec<BallVisit>>; ALL_DESIGNS.len()] =
        [const { OnceLock::new() }; ALL_DESIGNS.len()];
    let index = ALL_DESIGNS.iter().position(|known| *known == kind).unwrap();
    VISITS_OF_DESIGN[index].get_or_init(|| {
        let (plan, settings) = (built_in_plan(), settings(kind));
        let setup = DesignSetup::new(&plan, &settings).unwrap();
        design_visits(&setup, |_| Ok(0.0)).unwrap()
    })
}

/// The design [`D_OPTIMAL_DESIGN`] with other positions of C.
pub fn d_optimal_measurements_with_turns(turn_deg: &[f64]) -> Vec<(BcsAnglesRad, usize)> {
    let settings = SambaSettings { turn_deg: turn_deg.to_vec(), ..settings(D_OPTIMAL_DESIGN) };
    let plan = built_in_plan();
    let setup = DesignSetup::new(&plan, &settings).unwrap();
    measurements_of_visits(&design_visits(&setup, |_| Ok(0.0)).unwrap())
}

/// The measurements of the design, one after the other: B, C, S in rad, and the index of the ball from 0.
pub fn design_measurements(kind: (DesignKind, OptimalityCriterion)) -> Vec<(BcsAnglesRad, usize)> {
    let all = measurements_of_visits(cached_visits(kind));
    assert_eq!((cached_visits(kind).len(), all.len()), (32, 109));
    all
}

fn measurements_of_visits(visits: &[BallVisit]) -> Vec<(BcsAnglesRad, usize)> {
    let one = |visit: &BallVisit| {
        let bcs_rad = [Axis::B, Axis::C, Axis::S].map(|axis| visit.rotary_position.get(axis).unwrap());
        visit.ball_indices.iter().map(|ball| (bcs_rad, *ball)).collect::<Vec<_>>()
    };
    visits.iter().flat_map(one).collect()
}
