//! Summary of the collision proof as table rows, and the clearance of each touch or scan.

use super::number;
use machine::record::estimate::{EstimatedFunction, FunctionFigureKind, Unit};
use machine::record::plan::Plan;
use machine::record::stage_proof::{Clearance, StageProof};

/// Minimum clearance of each touch or scan, in the order of the run, without those in which no pair was
/// checked; `None` without any.
pub(super) fn clearance_of_each_step(proofs: &[StageProof]) -> Option<EstimatedFunction> {
    let y: Vec<f64> = step_clearances(proofs).map(|clearance| clearance.clearance_mm).collect();
    (!y.is_empty()).then(|| EstimatedFunction {
        symbol: "clearance".to_owned(),
        argument: "touch or scan".to_owned(),
        argument_unit: String::new(),
        x: (1..=y.len()).map(|n| n as f64).collect(),
        unit: Unit::Mm,
        u: Vec::new(),
        y,
        figure: FunctionFigureKind::Curve,
        at_mm: None,
    })
}

/// Name and text of each row: number of stages and motions, and the smallest clearance.
pub(super) fn clearance_rows(plan: &Plan, proofs: &[StageProof]) -> Vec<(String, String)> {
    if proofs.is_empty() {
        return Vec::new();
    }
    let motion_count: usize = proofs.iter().map(|proof| proof.motion_count).sum();
    let mut rows =
        vec![("Stages".to_owned(), proofs.len().to_string()), ("Motions".to_owned(), motion_count.to_string())];
    let least = |a: &&Clearance, b: &&Clearance| a.clearance_mm.total_cmp(&b.clearance_mm);
    if let Some(nearest) = step_clearances(proofs).min_by(least) {
        let step = plan.steps.iter().find(|step| step.id == nearest.step);
        let label = step.map_or(String::new(), |step| format!(" ({})", step.label));
        let [one, other] = &nearest.between;
        let clearance = number::format_fixed(nearest.clearance_mm, 2);
        let text = format!("{clearance} mm between {one} and {other}, step {}{label}", nearest.step);
        rows.push(("Nearest".to_owned(), text));
    }
    rows
}

/// Aspects that the proofs did not check, without duplicates, in the order of the stages.
pub(super) fn unchecked_aspects(proofs: &[StageProof]) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for what in proofs.iter().flat_map(|proof| &proof.unchecked_items) {
        if !all.contains(what) {
            all.push(what.clone());
        }
    }
    all
}

fn step_clearances(proofs: &[StageProof]) -> impl Iterator<Item = &Clearance> {
    proofs.iter().flat_map(|proof| &proof.steps)
}
