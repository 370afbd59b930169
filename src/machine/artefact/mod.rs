//! Bodies of an artefact and their positions, table frame, mm. The data types of artefacts are in `record`.

mod check;
mod observation;
mod part;

pub use check::{ArtefactEntry, ArtefactFault, check_balls};
pub use observation::{ObservationError, ObservedCylinder, ObservedSurface};
pub use part::{ArtefactBody, BodyShape, artefact_bodies};

use crate::record::artefact::{Artefact, Balls, Cylinder, DatumCylinder};

/// Uncertainty of the artefact's stated position, mm.
pub fn position_uncertainty_mm(artefact: &Artefact) -> f64 {
    match artefact {
        Artefact::Cylinder(Cylinder { uncertainty_mm, .. })
        | Artefact::Balls(Balls { uncertainty_mm, .. })
        | Artefact::DatumCylinder(DatumCylinder { uncertainty_mm, .. }) => *uncertainty_mm,
        Artefact::None => 0.0,
    }
}
