//! Evaluation of the touches of a run.

use super::fit::{FittedDelay, fit_delay};
use super::observe::{ObservedTouches, observe_touches};
use super::plc_scan_test::{PlcScanTest, test_for_plc_scan};
use crate::IdentifyError;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Touches of a run, the fitted delay, and the test for a PLC scan.
pub struct EvaluatedRun {
    pub observed: ObservedTouches,
    pub fitted: FittedDelay,
    pub plc_scan_test: PlcScanTest,
    /// Declared standard deviation of a touch including the display resolution, mm; `None`: no repeatability is
    /// declared.
    pub declared_scatter_mm: Option<f64>,
}

impl EvaluatedRun {
    /// # Errors
    /// The errors of [`observe_touches`] and [`fit_delay`].
    pub fn from_readings(plan: &Plan, readings: &[Reading]) -> Result<Self, IdentifyError> {
        let observed = observe_touches(plan, readings)?;
        let fitted = fit_delay(&observed)?;
        let scan = test_for_plc_scan(&observed, &fitted);
        let declared_um = plan.probe.repeatability_um;
        let declared_scatter_mm = declared_um.map(|um| (um * 1e-3).hypot(observed.resolution_mm / 12f64.sqrt()));
        Ok(Self { observed, fitted, plc_scan_test: scan, declared_scatter_mm })
    }
}
