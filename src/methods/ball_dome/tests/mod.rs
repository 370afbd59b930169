//! Tests with the dome of paper 4 on the machine of paper 4.

mod g4;

use nalgebra::Vector3;

use super::BallDomeSettings;
use super::design;
use crate::ball_measurement::{BallCentre, MeasurementPass, ObservedBalls, TouchLabel};
use crate::samba::tests::htm::{Triple, Truth};
use crate::samba::tests::{TOOL, built_in, paper_errors, table};
use machine::Axis;
use machine::record::plan::Plan;

/// Height of the dome in `config/ball-dome.toml` above that in the paper's table, mm.
const BASE_MM: f64 = 60.0;

fn plan() -> Plan {
    built_in::plan_of(include_str!("../../../../config/ball-dome.toml"), super::METHOD_NAME)
}

/// Certified ball positions of the dome: paper 4, table 3, mm.
fn certified() -> Vec<Vector3<f64>> {
    let rows = table(include_str!("../../../../tests/data/paper4-table3.csv"));
    let number = |text: &str| text.parse::<f64>().unwrap();
    rows.map(|row| Vector3::new(number(row[1]), number(row[2]), number(row[3]))).collect()
}

/// Readings at all visits of the built-in design on the machine of the paper's table 2 with the stylus of its
/// item S3: axis positions from plain matrix products, changed by `noise` (measurement, axis).
fn observed(plan: &Plan, mut noise: impl FnMut() -> f64) -> ObservedBalls {
    let truth = Truth { errors: paper_errors().into_iter().collect(), tool: TOOL };
    let settings = BallDomeSettings::default();
    let setup = design::dome_setup(plan, &settings).unwrap();
    let mut observed = ObservedBalls::default();
    for (place, visit) in design::design_visits(&setup, &settings).unwrap().into_iter().enumerate() {
        let triple: Triple =
            [visit.rotary_position.get_or_zero(Axis::B), visit.rotary_position.get_or_zero(Axis::C), 0.0];
        for ball in visit.balls {
            let centre = Vector3::from(setup.balls.balls[ball].centre_mm);
            let xyz = truth.axes_at(centre, triple);
            let id = setup.balls.balls[ball].id.clone();
            observed.centres.push(BallCentre {
                label: TouchLabel {
                    pass: MeasurementPass::Slow,
                    indexation: place as u32,
                    ball: id,
                    touch: "pole".into(),
                },
                ball,
                rotary_position_index: place,
                commanded_position_index: place,
                axes_mm: xyz + Vector3::from_fn(|_, _| noise()),
                radius_mm: 0.0,
                form_mm: 0.0,
                touches: Vec::new(),
                t_s: 0.0,
            });
        }
        observed.rotary_positions.push(visit.rotary_position.clone());
        observed.commanded_positions.push(visit.rotary_position);
    }
    observed
}
