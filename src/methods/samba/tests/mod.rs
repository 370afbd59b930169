pub mod built_in;
mod faulty_readings;
mod gate_g4;
mod other_machines;
mod readings_to_estimate;
pub mod reference_machine;
mod stages;
mod touches;

use nalgebra::Vector3;
use serde_json::json;

use machine::kinematics::Topology;
use machine::record::estimate::Estimate;
use machine::record::machine::{Machine, StatedAxis};

/// A machine with practically unlimited travel.
pub fn machine(topology: &str) -> Machine {
    let parsed: Topology = topology.parse().unwrap();
    let spec: StatedAxis = serde_json::from_str(r#"{"min":-1000,"max":1000}"#).unwrap();
    Machine {
        name: "test".into(),
        topology: topology.into(),
        axes: parsed.axes().map(|axis| (axis, spec.clone())).collect(),
        tool_mm: PAPER_TOOL_TIP_MM.into(),
        drift_um_per_h: 0.0,
        squareness_urad: 0.0,
    }
}

/// Stylus of paper 4, table 4, item S3, mm.
pub const PAPER_TOOL_TIP_MM: Vector3<f64> = Vector3::new(-0.012, -0.012, -326.746);
/// Length of the scale bar, paper 4, mm.
const BAR_LENGTH_MM: f64 = 304.8;

/// Ball positions of paper 4, table 1, mm.
fn paper_ball_centres() -> Vec<Vector3<f64>> {
    csv_rows(include_str!("../../../../tests/data/paper4-table1.csv"))
        .map(|fields| {
            let number = |k: usize| fields[k].parse::<f64>().unwrap();
            Vector3::new(number(1), number(2), number(3))
        })
        .collect()
}

/// True positions of the balls: those of the paper, changed by less than half a millimetre, because the balls
/// are uncalibrated.
fn true_ball_centres() -> Vec<Vector3<f64>> {
    let beside = |i: usize, k: f64| 0.4 * (i as f64 * 2.1 + k).sin();
    let mut balls = paper_ball_centres();
    for (i, ball) in balls.iter_mut().enumerate() {
        *ball += Vector3::new(beside(i, 0.0), beside(i, 1.0), beside(i, 2.0));
    }
    let along = (balls[1] - balls[0]).normalize();
    balls[1] = balls[0] + along * BAR_LENGTH_MM;
    balls
}

/// Machine errors of paper 4, table 2, in mm, rad, mm/mm.
pub fn paper_errors() -> Vec<(String, f64)> {
    csv_rows(include_str!("../../../../tests/data/paper4-table2.csv"))
        .map(|fields| {
            let scale = if fields[2] == "mm" { 1.0 } else { 1e-6 };
            (fields[0].to_owned(), fields[1].parse::<f64>().unwrap() * scale)
        })
        .collect()
}

/// An estimate of samba that equals the paper's table 2.
pub fn exact_estimate() -> Estimate {
    let unit = |name: &str| match name {
        gain if gain.ends_with('1') => ("um/m", 1e6),
        offset if offset.starts_with("EX") || offset.starts_with("EY") => ("um", 1e3),
        _ => ("urad", 1e6),
    };
    let errors = paper_errors();
    let parameters = errors.iter().map(|(name, value)| {
        let (unit, scale) = unit(name);
        json!({"symbol": name, "value": value * scale, "unit": unit, "u": 0.0, "U": 0.0, "k": 2.0,
            "dof": null, "identifiable": true})
    });
    let symbols: Vec<&String> = errors.iter().map(|(name, _)| name).collect();
    serde_json::from_value(json!({
        "trued_estimate": 1, "method": "samba", "parameters": parameters.collect::<Vec<_>>(),
        "functions": [], "covariance": {"symbols": symbols, "rows": vec![vec![0.0; 13]; 13]},
        "rank": 34, "unknowns": 34, "condition": 1.0, "gauge": [], "not_identifiable": [],
        "residual_rms_um": 0.0, "degrees_of_freedom": 0, "chi2_per_dof": 1.0, "verdict": "none",
        "warnings": [], "priors": [],
    }))
    .unwrap()
}

pub fn csv_rows(text: &'static str) -> impl Iterator<Item = Vec<&'static str>> {
    let lines = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    lines.map(|line| line.split(',').collect())
}
