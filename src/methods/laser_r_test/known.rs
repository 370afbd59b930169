//! Position of the sphere that the measurement has determined so far.

use nalgebra::Matrix3;

use super::bench::LaserSetup;
use super::cross::Place;
use super::group::{Grouped, grouped};
use super::model::{Model, Observation, Problem, placed};
use super::observe::observe;
use crate::{IdentifyError, Refused};
use machine::record::reading::Reading;

/// Largest distance of the zero point from its stated position before it is measured, mm.
const ZERO_DOUBT_MM: f64 = 1.0;
/// Assumed standard uncertainty of a centre during the measurement, mm.
const CENTRE_MM: f64 = 1e-3;

/// Positions as stated in the plan.
pub fn nominal(bench: &LaserSetup<'_>) -> Place {
    let (zero, beam, ball) = (bench.zero(), bench.beam(), bench.centre());
    Place { zero, beam, ball, position_uncertainty_mm: 0.0 }
}

/// Positions of sphere, zero point and beam by the nominal machine, as far as the readings up to now determine
/// them.
///
/// # Errors
/// The sphere is not found in the readings.
pub fn known(bench: &LaserSetup<'_>, readings: &[Reading]) -> Result<Place, Refused> {
    let nominal = nominal(bench);
    if readings.is_empty() {
        return Ok(nominal);
    }
    let refused = |why: String| Refused {
        why,
        instead: "check the sphere and the sensor, and start a new run".to_owned(),
    };
    let mut observed = observe(bench, readings).map_err(|why| match why {
        IdentifyError::Refused(why) => why,
        other => refused(other.to_string()),
    })?;
    let Grouped { groups, centres, .. } = grouped(bench, &mut observed)?;
    let fitted = centres.solve().map_err(|why| refused(why.to_string()))?;
    let sights = groups.iter().enumerate().map(|(i, group)| {
        let at = placed(&group.rotary, group.axes(centres.centre(&fitted.x, i)));
        Observation { at, weight: Matrix3::identity() / CENTRE_MM }
    });
    let problem = Problem {
        model: Model { chain: bench.chain.clone(), parameters: Vec::new() },
        sights: sights.collect(),
        hold: Some((nominal.zero, ZERO_DOUBT_MM)),
    };
    let start = [nominal.zero.as_slice(), nominal.ball.as_slice()].concat();
    let solved = problem.solve(start).map_err(|why| refused(why.to_string()))?;
    let place = Place {
        zero: problem.model.zero(&solved.x),
        beam: centres.beam(&fitted.x),
        ball: problem.model.ball(&solved.x),
        position_uncertainty_mm: 0.0,
    };
    check_place(bench, &place)?;
    Ok(place)
}

/// Checks that the sphere is not farther from its stated position than the stated uncertainty allows.
fn check_place(bench: &LaserSetup<'_>, place: &Place) -> Result<(), Refused> {
    let away = (place.ball - bench.centre()).norm() + (place.zero - bench.zero()).norm();
    let limit = 2.0 * bench.balls.uncertainty_mm + ZERO_DOUBT_MM;
    if away <= limit && place.ball.iter().all(|mm| mm.is_finite()) {
        return Ok(());
    }
    Err(Refused {
        why: format!(
            "the sphere seems to stand {away:.2} mm from its stated place, beyond {limit} mm: \
             uncertainty_mm of [artefact] and what zero_mm may be off"
        ),
        instead: "check centre_mm of the sphere and zero_mm of the sensor".to_owned(),
    })
}
