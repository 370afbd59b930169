//! Bodies of an artefact and their positions, table frame, mm. The data types of artefacts are in `record`.

mod artefact_body;
mod ball_check;
mod observed_surface;

pub use artefact_body::{ArtefactBody, BodyShape, artefact_bodies};
pub use ball_check::{ArtefactEntry, ArtefactFault, check_balls};
pub use observed_surface::{ObservedCylinder, ObservedSurface, ObservedSurfaceError};

use crate::record::artefact::{Artefact, Balls, Cylinder, DatumCylinder};

/// Maximum distance of the artefact's true position (for balls: of each centre) from the stated one, mm.
pub fn max_misplacement_mm(artefact: &Artefact) -> f64 {
    match artefact {
        Artefact::Cylinder(Cylinder { uncertainty_mm, .. })
        | Artefact::Balls(Balls { uncertainty_mm, .. })
        | Artefact::DatumCylinder(DatumCylinder { uncertainty_mm, .. }) => *uncertainty_mm,
        Artefact::None => 0.0,
    }
}
