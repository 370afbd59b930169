//! The variants of paper 4, section 7: the machine and the stylus with which the readings are transformed
//! into the table frame. Their results are the deviations of the balls from the certificate after one rigid
//! fit over all points.

use estimation::rigid::RigidFit;
use nalgebra::{Matrix3, Vector3};

use super::points::Points;
use super::stylus::{StylusGain, stylus_change};
use machine::kinematics::ErrorTerm;

/// Machine and stylus of a variant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kind {
    /// Name of the variant in the paper.
    pub name: &'static str,
    /// Whether the variant uses the machine of the prior; otherwise it uses the nominal one.
    pub is_calibrated: bool,
    pub stylus: StylusFrom,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StylusFrom {
    /// The stylus as the machine file states it.
    Stated,
    OneBall,
    AllBalls,
    /// Fitted together with the machine errors, minus the offset of the spindle in the prior.
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
    /// Stylus from the spindle datum, mm.
    pub stylus: Vector3<f64>,
    /// Fit of the certified positions to the measured ones, table frame, mm.
    pub fit: RigidFit,
    /// Derivative of each point by the stylus.
    by_stylus: Vec<Matrix3<f64>>,
    /// Gain of the stylus. `None`: the stylus is as stated.
    gain: Option<StylusGain>,
    /// Change of the stylus by each error of the prior (S4).
    by_prior: Vec<Vector3<f64>>,
}

/// Changes of the inputs of the variants.
pub struct Changes<'a> {
    /// Change of each point in the table frame, mm, without the errors of the machine.
    pub points: &'a [Vector3<f64>],
    /// Change of each point by the errors of the prior.
    pub by_errors: &'a [Vector3<f64>],
    /// Changes of the errors of the prior.
    pub errors: &'a [f64],
    /// Change of the certified position of each point, artefact frame, mm.
    pub certified: &'a [Vector3<f64>],
}

/// A stylus and its derivatives.
pub struct Found {
    pub stylus: Vector3<f64>,
    pub gain: Option<StylusGain>,
    pub by_prior: Vec<Vector3<f64>>,
}

impl Variant {
    /// `errors`: errors of the machine of this variant.
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

    /// Whether the stylus is a result of the fit.
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
