//! The true surface that can be touched: nearest point for each kind of artefact.

use nalgebra::Vector3;

use super::WorldError;
use super::balls::Balls;
use super::datum::Datum;
use super::drawn;
use super::flank::{Flank, Profile};
use super::nearest::Nearest;
use super::truth::Truth;
use machine::record::artefact::{Artefact, Cylinder};

/// Distance from the surface if there is no artefact: beyond the reach of any machine, mm.
const NOTHING_NEAR_MM: f64 = 1e9;

/// The true artefact, in the table frame.
#[derive(Debug, Clone)]
pub(super) enum Surface {
    Flank(Flank),
    Balls(Balls),
    Datum(Box<Datum>),
    /// There is no artefact.
    Empty,
}

impl Surface {
    pub fn new(artefact: &Artefact, truth: &Truth) -> Result<Self, WorldError> {
        match artefact {
            Artefact::Cylinder(cylinder) => {
                truth.of_a_round_part()?;
                flank(cylinder, truth).map(Self::Flank)
            }
            Artefact::Balls(balls) => {
                truth.of_balls(balls)?;
                Balls::new(balls, truth).map(Self::Balls)
            }
            Artefact::DatumCylinder(cylinder) => {
                truth.of_a_round_part()?;
                Datum::new(cylinder, truth).map(|datum| Self::Datum(Box::new(datum)))
            }
            Artefact::None => {
                truth.of_a_round_part()?;
                truth.reject_form_keys()?;
                Ok(Self::Empty)
            }
        }
    }

    /// Mounts the artefact again, turned by this angle against its first mounting. Only a datum cylinder has an
    /// indexing stage.
    pub fn mount(&mut self, turn_deg: f64) {
        if let Self::Datum(datum) = self {
            datum.mount(turn_deg);
        }
    }

    /// Nearest surface to `point` in the table frame at the time `t_s`. `growth`: of the radius of a round
    /// part; the growth of a small ball is far below a micrometre.
    pub fn nearest(&self, point: Vector3<f64>, growth: f64, t_s: f64) -> Nearest {
        match self {
            Self::Flank(flank) => flank.nearest(point, growth),
            Self::Balls(balls) => balls.nearest(point, t_s),
            Self::Datum(datum) => datum.nearest(point, growth),
            Self::Empty => Nearest { distance: NOTHING_NEAR_MM, normal: Vector3::z() },
        }
    }
}

fn flank(cylinder: &Cylinder, truth: &Truth) -> Result<Flank, WorldError> {
    let rough = drawn::roughness(truth.seed, truth.roughness_um);
    let radius = cylinder.radius_mm + truth.radius_offset_mm;
    let profile = Profile::new(radius, truth.form.iter().copied().chain(rough));
    let direction = Vector3::from(cylinder.axis);
    let finite = direction.iter().all(|part| part.is_finite());
    let sound = finite && direction.norm() > 0.0 && cylinder.height_mm > 0.0;
    // `>` is false for NaN as well.
    if !(sound && profile.smallest_radius() > 0.0) {
        return Err(WorldError::Artefact);
    }
    let foot = Vector3::from(cylinder.centre_mm) + truth.centre_offset();
    Ok(Flank::new(foot, direction, cylinder.height_mm, profile))
}
