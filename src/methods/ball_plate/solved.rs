//! The solved equations of a run, without uncertainty.

use faer::Mat;
use nalgebra::Vector3;

use super::design::PlateDesign;
use super::equations::solve_equations;
use super::observe::{PlateMeasurements, observe_run};
use super::plate::Plate;
use super::settings::BallPlateSettings;
use super::sources::{coordinate_sigmas, uncertainty_sources};
use crate::IdentifyError;
use crate::ball_measurement::measurements_for_outlier_check;
use crate::identification::{MeasurementToCheck, UncertaintySource};
use estimation::linear_least_squares::{LinearSolution, RankAnalysis};
use estimation::null_space_names::name_null_space;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Maximum number of undetermined combinations that are named.
const MAX_NAMED_UNDETERMINED_COMBINATIONS: usize = 4;

/// Observations of a run and the least-squares solution of their equations, without the uncertainty of the solution.
pub struct SolvedRun<'a> {
    pub settings: &'a BallPlateSettings,
    pub plate: &'a Plate<'a>,
    pub design: PlateDesign,
    pub measured: PlateMeasurements,
    pub sources: Vec<UncertaintySource>,
    /// Standard uncertainty of each coordinate of each observation, mm.
    pub coordinate_sigmas_mm: Vec<f64>,
    /// Unweighted; three rows (X, Y, Z) per observation.
    pub design_matrix: Mat<f64>,
    pub solution: LinearSolution,
    /// Whether `repeatability_um` of the probe is declared; otherwise the residuals scale the sizes of the sources.
    pub has_declared_source_sizes: bool,
}

impl<'a> SolvedRun<'a> {
    /// # Errors
    /// The readings do not belong to the plan or do not separate the unknowns.
    pub fn new(
        plan: &'a Plan,
        settings: &'a BallPlateSettings,
        plate: &'a Plate<'a>,
        readings: &[Reading],
    ) -> Result<Self, IdentifyError> {
        let mut design = PlateDesign::new(plan, settings, plate)?;
        let measured = observe_run(plan, settings, plate, &design, readings)?;
        let interruptions =
            measured.observations.iter().map(|observation| observation.preceding_interruption_count).max();
        design.layout.interruption_count = interruptions.filter(|_| !settings.value_per_stop).unwrap_or(0);
        let sources = uncertainty_sources(plan, &measured);
        let sigma = coordinate_sigmas(&sources, measured.observations.len());
        let names = design.layout.unknown_names(plate.rotary_axis);
        let lost = |survey: &RankAnalysis| {
            let mut named = name_null_space(survey.null_space.as_ref(), &names);
            named.truncate(MAX_NAMED_UNDETERMINED_COMBINATIONS);
            named
        };
        let (a, solution) = solve_equations(&design.layout, &design.stops, &measured.observations, &sigma)
            .map_err(|error| IdentifyError::from_solver_error(error, lost))?;
        let has_declared_sizes = plan.probe.repeatability_um.is_some();
        Ok(Self {
            settings,
            plate,
            design,
            measured,
            sources,
            coordinate_sigmas_mm: sigma,
            design_matrix: a,
            solution,
            has_declared_source_sizes: has_declared_sizes,
        })
    }

    /// Each ball at each stop as a measurement for the outlier check.
    pub fn measurements(&self) -> Vec<MeasurementToCheck> {
        let residuals: Vec<Vector3<f64>> = self.residuals().collect();
        measurements_for_outlier_check(&self.measured.observed_balls, |i| {
            let variances = self.coordinate_sigmas_mm[3 * i..][..3].iter().map(|sigma| sigma.powi(2));
            (residuals[i], 3 * i, (variances.sum::<f64>() / 3.0).sqrt())
        })
    }

    /// Measured minus fitted deviation of each observation, in axis positions, mm.
    pub fn residuals(&self) -> impl Iterator<Item = Vector3<f64>> {
        self.solution.residuals.chunks(3).map(Vector3::from_column_slice)
    }
}
