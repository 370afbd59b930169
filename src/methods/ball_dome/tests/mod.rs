//! Tests with the dome of paper 4 on the machine of paper 4.

mod gate_g4;

use nalgebra::Vector3;

use super::BallDomeSettings;
use super::design;
use crate::ball_measurement::{BallCentre, MeasurementPurpose, ObservedBalls, TouchLabel};
use crate::samba::tests::reference_machine::{BcsAnglesRad, ReferenceMachine};
use crate::samba::tests::{PAPER_TOOL_TIP_MM, built_in, csv_rows, paper_errors};
use machine::Axis;
use machine::record::plan::Plan;

/// Height of the dome in `config/ball-dome.toml` above that in the paper's table, mm.
const DOME_HEIGHT_OFFSET_MM: f64 = 60.0;

fn built_in_plan() -> Plan {
    built_in::plan_from_machine_file(include_str!("../../../../config/ball-dome.toml"), super::METHOD_NAME)
}

/// Certified ball positions of the dome: paper 4, table 3, mm.
fn paper_certified_positions() -> Vec<Vector3<f64>> {
    let rows = csv_rows(include_str!("../../../../tests/data/paper4-table3.csv"));
    let number = |text: &str| text.parse::<f64>().unwrap();
    rows.map(|row| Vector3::new(number(row[1]), number(row[2]), number(row[3]))).collect()
}

/// Readings at all visits of the built-in design on the machine of the paper's table 2 with the stylus of its
/// item S3: axis positions from plain matrix products, changed by `noise` (measurement, axis).
fn simulate_observed_balls(plan: &Plan, mut noise: impl FnMut() -> f64) -> ObservedBalls {
    let truth = ReferenceMachine { errors: paper_errors().into_iter().collect(), tool: PAPER_TOOL_TIP_MM };
    let settings = BallDomeSettings::default();
    let setup = design::dome_setup(plan, &settings).unwrap();
    let mut observed = ObservedBalls::default();
    for (place, visit) in design::design_visits(&setup, &settings).unwrap().into_iter().enumerate() {
        let bcs_rad: BcsAnglesRad =
            [visit.rotary_position.get_or_zero(Axis::B), visit.rotary_position.get_or_zero(Axis::C), 0.0];
        for ball in visit.ball_indices {
            let centre = Vector3::from(setup.balls.balls[ball].centre_mm);
            let xyz = truth.axis_positions_at_ball(centre, bcs_rad);
            let id = setup.balls.balls[ball].id.clone();
            observed.centres.push(BallCentre {
                label: TouchLabel {
                    purpose: MeasurementPurpose::Slow,
                    indexation_index: place as u32,
                    ball: id,
                    touch: "pole".into(),
                },
                ball_index: ball,
                measured_rotary_position_index: place,
                commanded_rotary_position_index: place,
                centre_axis_positions_mm: xyz + Vector3::from_fn(|_, _| noise()),
                contact_radius_mm: 0.0,
                form_mm: 0.0,
                touches: Vec::new(),
                mean_time_s: 0.0,
            });
        }
        observed.measured_rotary_positions.push(visit.rotary_position.clone());
        observed.commanded_rotary_positions.push(visit.rotary_position);
    }
    observed
}
