//! Positions of sphere, zero point and beam: as stated in the plan, and as the readings so far determine them.

use nalgebra::Matrix3;

use super::observe::observe_scans;
use super::pose_groups::{GroupedScans, group_scans};
use super::scan_step::ExpectedGeometry;
use super::setup::LaserSetup;
use super::sphere_model::{CentreObservation, MachineEquations, SphereModel};
use crate::{IdentifyError, MethodRefusal};
use machine::record::reading::Reading;

/// Assumed standard uncertainty of the stated zero point before its measurement, and maximum error allowed, mm.
const MAX_ZERO_POINT_ERROR_MM: f64 = 1.0;
/// Assumed standard uncertainty of the sphere centre from one group of scans, for fits while the run goes on, mm.
const PROVISIONAL_CENTRE_STD_U_MM: f64 = 1e-3;

/// Positions as stated in the plan.
pub fn nominal_geometry(setup: &LaserSetup<'_>) -> ExpectedGeometry {
    let (zero_point, beam_direction, ball_centre) = (setup.zero_point(), setup.beam_direction(), setup.ball_centre());
    ExpectedGeometry { zero_point, beam_direction, ball_centre, max_position_error_mm: 0.0 }
}

/// Positions of sphere, zero point and beam by the nominal machine, as far as the readings up to now determine them;
/// those of the plan without readings.
///
/// # Errors
/// The readings do not determine the sphere or the latency, or the sphere is too far from its stated position.
pub fn measured_geometry(setup: &LaserSetup<'_>, readings: &[Reading]) -> Result<ExpectedGeometry, MethodRefusal> {
    let nominal = nominal_geometry(setup);
    if readings.is_empty() {
        return Ok(nominal);
    }
    let refused = |why: String| MethodRefusal::new(why, "check the sphere and the sensor, and start a new run");
    let mut observed = observe_scans(setup, readings).map_err(|why| match why {
        IdentifyError::Refused(why) => why,
        error => refused(error.to_string()),
    })?;
    let GroupedScans { groups, centre_equations: centres, .. } = group_scans(setup, &mut observed)?;
    let fitted = centres.solve().map_err(|why| refused(why.to_string()))?;
    let centre_observations = groups.iter().enumerate().map(|(i, group)| {
        let axis_positions = group.axis_positions(centres.group_centre(&fitted.x, i));
        CentreObservation { axis_positions, whitening_matrix: Matrix3::identity() / PROVISIONAL_CENTRE_STD_U_MM }
    });
    let problem = MachineEquations {
        model: SphereModel { chain: setup.chain.clone(), parameters: Vec::new() },
        centre_observations: centre_observations.collect(),
        zero_point_prior: Some((nominal.zero_point, MAX_ZERO_POINT_ERROR_MM)),
    };
    let start = [nominal.zero_point.as_slice(), nominal.ball_centre.as_slice()].concat();
    let fitted_machine = problem.solve(start).map_err(|why| refused(why.to_string()))?;
    let geometry = ExpectedGeometry {
        zero_point: problem.model.zero_point(&fitted_machine.x),
        beam_direction: centres.beam_vector(&fitted.x),
        ball_centre: problem.model.ball_centre(&fitted_machine.x),
        max_position_error_mm: 0.0,
    };
    check_sphere_position(setup, &geometry)?;
    Ok(geometry)
}

/// Checks that the deviations of sphere and zero point from their stated positions add up to at most twice the stated
/// uncertainty of the sphere plus [`MAX_ZERO_POINT_ERROR_MM`].
fn check_sphere_position(setup: &LaserSetup<'_>, geometry: &ExpectedGeometry) -> Result<(), MethodRefusal> {
    let offset_mm =
        (geometry.ball_centre - setup.ball_centre()).norm() + (geometry.zero_point - setup.zero_point()).norm();
    let limit = 2.0 * setup.balls.uncertainty_mm + MAX_ZERO_POINT_ERROR_MM;
    MethodRefusal::require(
        offset_mm <= limit && geometry.ball_centre.iter().all(|mm| mm.is_finite()),
        format!(
            "the measured position of the sphere differs by {offset_mm:.2} mm from the stated one; the limit is \
             {limit} mm (twice uncertainty_mm of [artefact], plus 1 mm for zero_mm)"
        ),
        "check centre_mm of the sphere and zero_mm of the sensor",
    )
}
