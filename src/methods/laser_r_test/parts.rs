//! The results of the identification, with the unknowns' names.

use nalgebra::Rotation3;

use super::bench::Bench;
use super::centres::BEAM;
use super::group::Grouped;
use super::model::Problem;
use super::observe::Observed;
use super::parameters::Chosen;
use estimation::linear::Survey;
use estimation::misfit::Misfit;
use estimation::monte_carlo::Summary;
use estimation::nonlinear::Minimum;
use estimation::propagated::Propagated;

/// Lean of the beam from its nominal direction along the two directions across (X and Y of a beam that
/// looks down), and what the sensor's scale deviates from 1.
const BEAM_NAMES: [&str; BEAM] = ["beam_x", "beam_y", "gain"];

/// Everything that the estimate is written from.
pub struct Parts<'a> {
    pub bench: &'a Bench<'a>,
    pub observed: Observed,
    pub grouped: Grouped,
    pub fitted: Minimum,
    pub chosen: Chosen,
    pub problem: Problem,
    pub minimum: Minimum,
    pub names: Vec<String>,
    pub survey: Survey,
    pub into_table: Vec<Rotation3<f64>>,
    pub misfit: Misfit,
    pub propagated: Propagated,
    pub monte_carlo: Summary,
}

impl Parts<'_> {
    /// Names and values of the sensor's latency and of what the axes lose where they turn round.
    pub fn clocks(&self) -> (Vec<String>, Vec<f64>) {
        let latency = self.observed.latency.as_ref();
        latency.map_or_else(Default::default, |latency| (latency.names(), latency.values()))
    }

    /// Which of them an unknown is.
    pub fn clock(&self, i: usize) -> Option<usize> {
        i.checked_sub(self.names.len() + self.grouped.centres.common())
    }

    pub fn symbol(&self, i: usize) -> String {
        if let Some(k) = self.clock(i) {
            return self.clocks().0.get(k).cloned().unwrap_or_default();
        }
        let of_beam = || BEAM_NAMES.get(i - self.names.len()).map(|name| (*name).to_owned());
        self.names.get(i).cloned().or_else(of_beam).unwrap_or_default()
    }

    /// Residuals of each scan: largest less smallest, mm.
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
