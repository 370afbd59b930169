//! Correction sheet: the measured errors, for controls that this program cannot write to, and for CAM.

use super::proposal::{ControlProposalError, last_usable_estimate, remaining_errors};
use crate::report::correction_sheet::{CorrectionSheet, SheetRow};
use crate::report::number::{decimals_for_uncertainty, format_fixed};
use crate::report::time::format_local_time;
use crate::setup::{ControlConfig, MachineFile};
use crate::store::{Journal, RunId, StoredRun};
use machine::Axis;
use machine::kinematics::KinematicChain;
use machine::record::estimate::Unit;
use methods::compensation::{MeasuredAxisPositions, RotaryAxisCoordinate};
use methods::identification::StatedStylusUncertainty;

/// Decimals of a position in mm.
const MM_DECIMALS: usize = 4;

/// A correction sheet: HTML with figures of the errors, and CSV.
pub struct RenderedSheet {
    pub html: String,
    pub csv: Vec<u8>,
}

/// Renders the correction sheet of the newest estimate of `run`.
///
/// # Errors
/// The run has no usable estimate, or no errors of axes.
pub fn render_correction_sheet(journal: &Journal, run: RunId) -> Result<RenderedSheet, ControlProposalError> {
    let stored = journal.load_run(run)?;
    let sheet = correction_sheet(run, &stored)?;
    let estimate = &last_usable_estimate(run, &stored)?.estimate;
    let mut csv = Vec::new();
    sheet.write_csv(&mut csv)?;
    Ok(RenderedSheet { html: sheet.render(estimate)?, csv })
}

/// Positions of the rotary axes that carry the workpiece, across their directions; and all other identified errors
/// except those in µm.
fn correction_sheet(run: RunId, stored: &StoredRun) -> Result<CorrectionSheet, ControlProposalError> {
    let last = last_usable_estimate(run, stored)?;
    let plan = &stored.plan;
    let stylus = StatedStylusUncertainty::new(&plan.probe, &plan.assumed);
    let measured = MeasuredAxisPositions::new(&plan.machine, stylus, &last.estimate)?;
    let chain = KinematicChain::new(&plan.machine).map_err(methods::MethodRefusal::from)?;
    let rotary_axes = chain.topology().workpiece_branch().iter().filter(|axis| !axis.is_linear());
    let coordinates = rotary_axes.flat_map(|axis| {
        let across = [Axis::X, Axis::Y, Axis::Z].into_iter();
        let is_across = |component: &Axis| component.nominal_direction().dot(&axis.nominal_direction()) == 0.0;
        across.filter(is_across).map(|component| RotaryAxisCoordinate { axis: *axis, component })
    });
    let of_run = MachineFile::from_stored_run("machine file", stored.machine_file_text.clone(), &plan.artefact);
    Ok(CorrectionSheet {
        run: run.to_string(),
        method: stored.summary.method.clone(),
        machine: plan.machine.name.clone(),
        topology: plan.machine.topology.clone(),
        measured_at: format_local_time(stored.summary.started),
        is_simulated: of_run.is_ok_and(|own| matches!(own.controller_section.control, ControlConfig::Simulated(_))),
        estimate_sha256: last.sha256.clone(),
        positions: coordinates.map(|coordinate| position_row(&measured, coordinate)).collect(),
        reference_point: measured.at_mm().map(|at_mm| {
            let [x, y, z] = at_mm.map(|mm| format_fixed(mm, 1));
            format!("with the tip at X {x} Y {y} Z {z} mm in machine coordinates")
        }),
        others: remaining_errors(&last.estimate, |own| own.unit == Unit::Um)
            .into_iter()
            .map(|own| {
                let decimals = decimals_for_uncertainty(own.expanded);
                SheetRow {
                    quantity: own.symbol,
                    value: format_fixed(own.value, decimals),
                    expanded: format_fixed(own.expanded, decimals),
                    unit: own.unit.symbol(),
                    stated_in_machine_file: String::new(),
                    not_determined_reason: String::new(),
                }
            })
            .collect(),
        warnings: last.estimate.warnings.clone(),
    })
}

/// Row of one position; if the run does not determine it, the row has the reason and the remedy instead of a value.
fn position_row(measured: &MeasuredAxisPositions<'_>, coordinate: RotaryAxisCoordinate) -> SheetRow {
    let number = |mm: f64| format_fixed(mm, MM_DECIMALS);
    let row = SheetRow {
        quantity: format!("{} of {}", coordinate.component, coordinate.axis),
        value: String::new(),
        expanded: String::new(),
        unit: "mm",
        stated_in_machine_file: measured.stated_mm(coordinate).map_or(String::new(), number),
        not_determined_reason: String::new(),
    };
    match measured.position(coordinate) {
        Ok(position) => SheetRow { value: number(position.mm), expanded: number(position.expanded_mm), ..row },
        Err(refusal) => SheetRow { not_determined_reason: format!("{}; {}", refusal.reason, refusal.remedy), ..row },
    }
}
