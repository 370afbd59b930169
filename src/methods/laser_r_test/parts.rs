//! The solved identification with everything that the estimate reports.

use super::bench::LaserSetup;
use super::group::Grouped;
use super::model::Problem;
use super::observe::Observed;
use super::parameters::Chosen;
use crate::identification::Identification;
use estimation::nonlinear::Minimum;

pub struct Parts<'a> {
    pub bench: &'a LaserSetup<'a>,
    pub observed: Observed,
    pub grouped: Grouped,
    /// Fit of the sphere's centres and the beam.
    pub fitted: Minimum,
    pub chosen: Chosen,
    pub problem: Problem,
    /// Fit of the machine errors.
    pub minimum: Minimum,
    /// Names of the unknowns of `minimum`.
    pub names: Vec<String>,
    pub identified: Identification,
}

impl Parts<'_> {
    /// Form error of each scan: largest less smallest residual, mm.
    pub fn forms(&self) -> Vec<f64> {
        let off = self.grouped.centres.off(&self.fitted.x);
        let of_group = |group: usize| {
            let rows = self.grouped.centres.rows.iter().zip(&off);
            let here = rows.filter(|(row, _)| row.group == group).map(|(_, off)| *off);
            let (least, most) = here
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), off| (a.min(off), b.max(off)));
            most - least
        };
        (0..self.grouped.groups.len()).map(of_group).collect()
    }
}
