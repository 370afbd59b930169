//! The true surface that can be touched: nearest point for each kind of artefact.

use std::ops::RangeInclusive;

use nalgebra::Vector3;

use super::SimulatedWorldError;
use super::balls::TrueBalls;
use super::nearest_surface::NearestSurface;
use super::random_draws::{RandomSource, draw_form_harmonics};
use super::true_datum_cylinder::TrueDatumCylinder;
use super::true_round_part::{RadiusProfile, TrueCylinder};
use super::truth::MachineTruth;
use machine::record::artefact::{Artefact, Cylinder};

/// Orders of the drawn roughness.
const ROUGHNESS_ORDERS: RangeInclusive<u32> = 16..=64;
/// Distance from the surface if there is no artefact: beyond the reach of any machine, mm.
const EMPTY_TABLE_DISTANCE_MM: f64 = 1e9;

/// The true artefact, in the table frame.
#[derive(Debug, Clone)]
pub(super) enum ArtefactSurface {
    Cylinder(TrueCylinder),
    Balls(TrueBalls),
    DatumCylinder(Box<TrueDatumCylinder>),
    /// There is no artefact.
    NoArtefact,
}

impl ArtefactSurface {
    /// Draws the true surface of the artefact.
    ///
    /// # Errors
    /// The artefact is impossible, or `truth` has a key for another kind of artefact or an unknown ball.
    pub fn new(artefact: &Artefact, truth: &MachineTruth) -> Result<Self, SimulatedWorldError> {
        match artefact {
            Artefact::Cylinder(cylinder) => {
                truth.reject_ball_keys()?;
                true_cylinder(cylinder, truth).map(Self::Cylinder)
            }
            Artefact::Balls(balls) => {
                truth.check_keys_for_balls(balls)?;
                TrueBalls::new(balls, truth).map(Self::Balls)
            }
            Artefact::DatumCylinder(cylinder) => {
                truth.reject_ball_keys()?;
                TrueDatumCylinder::new(cylinder, truth).map(|datum| ArtefactSurface::DatumCylinder(Box::new(datum)))
            }
            Artefact::None => {
                truth.reject_ball_keys()?;
                truth.reject_form_keys()?;
                Ok(ArtefactSurface::NoArtefact)
            }
        }
    }

    /// Mounts a datum cylinder again on its indexing stage, turned by this angle against its first mounting. Does
    /// nothing with another artefact.
    pub fn remount_datum_cylinder(&mut self, turn_deg: f64) {
        if let ArtefactSurface::DatumCylinder(datum) = self {
            datum.remount(turn_deg);
        }
    }

    /// Surface nearest to `point` at the time `t_s`. Point and result: table frame. `growth`: growth of a round part's
    /// radius, mm; the growth of a small ball is far below a micrometre.
    pub fn nearest(&self, point: Vector3<f64>, growth: f64, t_s: f64) -> NearestSurface {
        match self {
            Self::Cylinder(cylinder) => cylinder.nearest(point, growth),
            Self::Balls(balls) => balls.nearest(point, t_s),
            ArtefactSurface::DatumCylinder(datum) => datum.nearest(point, growth),
            ArtefactSurface::NoArtefact => NearestSurface::no_surface_within(EMPTY_TABLE_DISTANCE_MM),
        }
    }
}

fn true_cylinder(cylinder: &Cylinder, truth: &MachineTruth) -> Result<TrueCylinder, SimulatedWorldError> {
    let rough = draw_form_harmonics(truth.seed, RandomSource::Roughness, &[], ROUGHNESS_ORDERS, truth.roughness_um);
    let radius = cylinder.radius_mm + truth.radius_offset_mm;
    let profile = RadiusProfile::new(radius, truth.form.iter().copied().chain(rough));
    let direction = Vector3::from(cylinder.axis);
    let is_finite = direction.iter().all(|part| part.is_finite());
    let is_valid = is_finite && direction.norm() > 0.0 && cylinder.height_mm > 0.0;
    // This also rejects NaN, because every comparison with NaN is false.
    if !(is_valid && profile.min_radius_bound() > 0.0) {
        return Err(SimulatedWorldError::InvalidCylinder);
    }
    let foot = Vector3::from(cylinder.foot_mm) + truth.artefact_offset_mm();
    Ok(TrueCylinder::new(foot, direction, cylinder.height_mm, profile))
}
