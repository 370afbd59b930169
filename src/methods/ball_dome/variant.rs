//! The variants of paper 4, section 7: which machine and which stylus bring the readings into the table frame, and
//! how far the balls then are from their certificate, after one rigid fit over all points.

use estimation::rigid::RigidFit;
use nalgebra::{Matrix3, Vector3};

use super::points::Points;
use super::stylus::{StylusGain, stylus_change};
use machine::kinematics::ErrorTerm;

/// Which machine and which stylus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kind {
    /// As in the paper.
    pub name: &'static str,
    /// The machine of the prior; otherwise the nominal one.
    pub is_calibrated: bool,
    pub stylus: StylusFrom,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StylusFrom {
    /// The machine file.
    Stated,
    OneBall,
    AllBalls,
    /// Machine errors and stylus at once, less the spindle's offset of the prior.
    FullFit,
}

const fn kind(name: &'static str, is_calibrated: bool, stylus: StylusFrom) -> Kind {
    Kind { name, is_calibrated, stylus }
}

pub const KINDS: [Kind; 7] = [
    kind("N1", false, StylusFrom::Stated),
    kind("N2", false, StylusFrom::OneBall),
    kind("N3", false, StylusFrom::AllBalls),
    kind("S1", true, StylusFrom::Stated),
    kind("S2", true, StylusFrom::OneBall),
    kind("S3", true, StylusFrom::AllBalls),
    kind("S4", true, StylusFrom::FullFit),
];

/// A variant with its deviations and their first-order changes.
pub struct Variant {
    pub kind: Kind,
    /// mm from the spindle datum.
    pub stylus: Vector3<f64>,
    /// Of the certified places onto those that the machine sees, table frame, mm.
    pub fit: RigidFit,
    /// Derivative of each point by the stylus.
    by_stylus: Vec<Matrix3<f64>>,
    /// `None`: the stylus is as stated.
    gain: Option<StylusGain>,
    /// Change of the stylus by each error of the prior (S4).
    by_prior: Vec<Vector3<f64>>,
}

/// Changes of what the variants are computed from.
pub struct Changes<'a> {
    /// Of each point in the table frame, mm, without the machine's errors.
    pub points: &'a [Vector3<f64>],
    /// Of each point by the errors of the prior.
    pub by_errors: &'a [Vector3<f64>],
    /// Of the errors of the prior.
    pub errors: &'a [f64],
    /// Of each point's certified place, artefact frame, mm.
    pub certified: &'a [Vector3<f64>],
}

/// How the stylus is found.
pub struct Found {
    pub stylus: Vector3<f64>,
    pub gain: Option<StylusGain>,
    pub by_prior: Vec<Vector3<f64>>,
}

impl Variant {
    /// `errors`: of the machine of this variant.
    pub fn new(kind: Kind, points: &Points, errors: &[ErrorTerm], found: Found) -> Self {
        let seen = points.seen(errors, found.stylus);
        Self {
            kind,
            stylus: found.stylus,
            fit: RigidFit::new(&points.certified, &seen),
            by_stylus: points.by_stylus(errors),
            gain: found.gain,
            by_prior: found.by_prior,
        }
    }

    /// Whether the stylus is a result.
    pub fn has_stylus(&self) -> bool {
        self.gain.is_some()
    }

    /// First-order changes of the deviations and of the stylus, mm.
    pub fn change(&self, changes: &Changes<'_>) -> (Vec<Vector3<f64>>, Vector3<f64>) {
        let places = changes.certified.iter().map(|change| self.fit.rotation * change);
        let places: Vec<Vector3<f64>> = places.collect();
        let mut moved = changes.points.to_vec();
        let is_full = self.kind.stylus == StylusFrom::FullFit;
        if is_full {
            moved.iter_mut().zip(&places).for_each(|(moved, place)| *moved -= place);
        }
        if self.kind.is_calibrated && !is_full {
            moved.iter_mut().zip(changes.by_errors).for_each(|(moved, by)| *moved += by);
        }
        let mut stylus =
            self.gain.as_ref().map_or(Vector3::zeros(), |gain| stylus_change(gain, &moved));
        let prior = self.by_prior.iter().zip(changes.errors);
        stylus += prior.map(|(by, error)| by * *error).sum::<Vector3<f64>>();
        if is_full {
            moved.iter_mut().zip(changes.by_errors).for_each(|(moved, by)| *moved += by);
        } else {
            moved.iter_mut().zip(&places).for_each(|(moved, place)| *moved -= place);
        }
        moved.iter_mut().zip(&self.by_stylus).for_each(|(moved, by)| *moved += by * stylus);
        self.fit.without_rigid(&mut moved);
        (moved, stylus)
    }
}
