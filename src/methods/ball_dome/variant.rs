//! The variants of paper 4, section 7: which machine and which stylus bring the readings into the table frame, and
//! how far the balls then are from their certificate, after one rigid fit over all points.

use nalgebra::{Matrix3, Rotation3, Vector3};

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
    pub aligned: Aligned,
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
            aligned: align(&points.certified, &seen),
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
        let places = changes.certified.iter().map(|change| self.aligned.rotation * change);
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
        self.aligned.without_rigid(&mut moved);
        (moved, stylus)
    }
}

/// Points against their certified places, after the rigid fit.
pub struct Aligned {
    /// From the artefact frame into the table frame.
    pub rotation: Rotation3<f64>,
    /// Certified places from their centroid, table frame, mm.
    pub arms: Vec<Vector3<f64>>,
    /// Seen less certified, table frame, mm.
    pub deviations: Vec<Vector3<f64>>,
    inverse_inertia: Matrix3<f64>,
}

/// The rigid motion of the `certified` places onto the `seen` ones by least squares (singular value decomposition
/// of their covariance).
pub fn align(certified: &[Vector3<f64>], seen: &[Vector3<f64>]) -> Aligned {
    let mean = |all: &[Vector3<f64>]| all.iter().sum::<Vector3<f64>>() / all.len().max(1) as f64;
    let (from, to) = (mean(certified), mean(seen));
    let pairs = certified.iter().zip(seen);
    let covariance: Matrix3<f64> = pairs.map(|(c, s)| (s - to) * (c - from).transpose()).sum();
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u.unwrap_or_default(), svd.v_t.unwrap_or_default());
    let mirror = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
    let rotation = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&mirror) * v_t);
    let arms: Vec<Vector3<f64>> = certified.iter().map(|c| rotation * (c - from)).collect();
    let deviations = arms.iter().zip(seen).map(|(arm, s)| s - to - arm).collect();
    let inertia = |arm: &Vector3<f64>| {
        Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose()
    };
    let inertia: Matrix3<f64> = arms.iter().map(inertia).sum();
    let inverse_inertia = inertia.try_inverse().unwrap_or_default();
    Aligned { rotation, arms, deviations, inverse_inertia }
}

impl Aligned {
    /// Takes out of small changes of the deviations what a rigid motion of the artefact takes up.
    fn without_rigid(&self, changes: &mut [Vector3<f64>]) {
        let mean = changes.iter().sum::<Vector3<f64>>() / changes.len().max(1) as f64;
        let moment: Vector3<f64> =
            self.arms.iter().zip(changes.iter()).map(|(arm, change)| arm.cross(change)).sum();
        let turn = self.inverse_inertia * moment;
        for (change, arm) in changes.iter_mut().zip(&self.arms) {
            *change -= mean + turn.cross(arm);
        }
    }
}
