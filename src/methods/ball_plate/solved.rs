//! The solved equations of a run, without uncertainty.

use faer::Mat;
use nalgebra::Vector3;

use super::design::Design;
use super::equations::solve;
use super::observe::{Measured, measured};
use super::plate::Plate;
use super::settings::Settings;
use super::sources::{sigma, sources};
use crate::IdentifyError;
use crate::ball_measurement::measurements;
use crate::identification::{Measurement, UncertaintySource};
use estimation::linear::{LinearSolution, Survey};
use estimation::null_names::name_null_space;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Maximum number of undetermined combinations that are named.
const MAX_NAMED_LOST: usize = 4;

pub struct Solved<'a> {
    pub settings: &'a Settings,
    pub plate: &'a Plate<'a>,
    pub design: Design,
    pub measured: Measured,
    pub sources: Vec<UncertaintySource>,
    /// Standard uncertainty of each coordinate of each sighting, mm.
    pub sigma: Vec<f64>,
    pub a: Mat<f64>,
    pub solution: LinearSolution,
    /// Whether the sizes of the sources are declared; otherwise the residuals scale them.
    pub is_declared: bool,
}

impl<'a> Solved<'a> {
    /// # Errors
    /// The readings do not belong to the plan or do not separate the unknowns.
    pub fn new(
        plan: &'a Plan,
        settings: &'a Settings,
        plate: &'a Plate<'a>,
        readings: &[Reading],
    ) -> Result<Self, IdentifyError> {
        let mut design = Design::new(plan, settings, plate)?;
        let measured = measured(plan, settings, plate, &design, readings)?;
        let interruptions = measured.sightings.iter().map(|sighting| sighting.segment).max();
        design.layout.interruptions = interruptions.filter(|_| !settings.values).unwrap_or(0);
        let sources = sources(plan, &measured);
        let sigma = sigma(&sources, measured.sightings.len());
        let names = design.layout.names(plate.axis);
        let lost = |survey: &Survey| {
            let mut named = name_null_space(survey.null_space.as_ref(), &names);
            named.truncate(MAX_NAMED_LOST);
            named
        };
        let (a, solution) = solve(&design.layout, &design.stops, &measured.sightings, &sigma)
            .map_err(|error| IdentifyError::unsolved(error, lost))?;
        let is_declared = plan.probe.repeatability_um.is_some();
        Ok(Self { settings, plate, design, measured, sources, sigma, a, solution, is_declared })
    }

    /// Each ball at each stop as a measurement for the outlier check.
    pub fn measurements(&self) -> Vec<Measurement> {
        let residuals: Vec<Vector3<f64>> = self.residuals().collect();
        measurements(&self.measured.observed, |i| {
            let variances = self.sigma[3 * i..][..3].iter().map(|sigma| sigma.powi(2));
            (residuals[i], 3 * i, (variances.sum::<f64>() / 3.0).sqrt())
        })
    }

    /// Measured minus fitted deviation of each sighting, in axis positions, mm.
    pub fn residuals(&self) -> impl Iterator<Item = Vector3<f64>> {
        self.solution.residuals.chunks(3).map(Vector3::from_column_slice)
    }
}
