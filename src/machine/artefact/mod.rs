//! What an artefact is made of, as bodies with places. The nouns themselves stand in
//! `record`. Table frame, mm.

mod check;
mod observation;
mod part;

pub use check::{Entry, Flaw, check};
pub use observation::{CylinderOnTable, ObservationError, ObservedSurface};
pub use part::{Part, Shape, parts};

use crate::record::artefact::{Artefact, Balls, Cylinder, DatumCylinder};

/// How far the true artefact may stand from the stated one, mm.
pub fn uncertainty_mm(artefact: &Artefact) -> f64 {
    match artefact {
        Artefact::Cylinder(Cylinder { uncertainty_mm, .. })
        | Artefact::Balls(Balls { uncertainty_mm, .. })
        | Artefact::DatumCylinder(DatumCylinder { uncertainty_mm, .. }) => *uncertainty_mm,
        Artefact::None => 0.0,
    }
}
