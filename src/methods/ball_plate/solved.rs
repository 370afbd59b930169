//! The solved equations of a run, without uncertainty.

use faer::Mat;

use super::design::Design;
use super::observe::Measured;
use super::plate::Plate;
use super::settings::Settings;
use estimation::linear::LinearSolution;
use machine::record::plan::Plan;

pub struct Solved<'a> {
    pub plan: &'a Plan,
    pub settings: &'a Settings,
    pub plate: &'a Plate<'a>,
    pub design: &'a Design,
    pub measured: Measured,
    /// Of each coordinate of each sighting, mm.
    pub sigma: Vec<f64>,
    pub a: Mat<f64>,
    pub solution: LinearSolution,
}
