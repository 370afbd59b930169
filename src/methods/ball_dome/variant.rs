//! The variants of paper 4, section 7: the machine and the stylus with which the readings are transformed
//! into the table frame. Their results are the deviations of the balls from the certificate after one rigid
//! fit over all points.

use estimation::rigid::RigidFit;
use nalgebra::{Matrix3, Vector3};

use super::points::MeasuredPoints;
use super::stylus::{StylusGain, stylus_change};
use machine::kinematics::ErrorTerm;

/// Machine and stylus of a variant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VariantKind {
    /// Name of the variant in the paper.
    pub name: &'static str,
    /// Whether the variant uses the machine of the prior; otherwise it uses the nominal one.
    pub is_calibrated: bool,
    pub stylus: StylusSource,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StylusSource {
    /// The stylus as the machine file states it.
    Stated,
    OneBall,
    AllBalls,
    /// Fitted together with the machine errors, minus the offset of the spindle in the prior.
    ErrorAndStylusFit,
}

const fn variant_kind(name: &'static str, is_calibrated: bool, stylus: StylusSource) -> VariantKind {
    VariantKind { name, is_calibrated, stylus }
}

pub const VARIANT_KINDS: [VariantKind; 7] = [
    variant_kind("N1", false, StylusSource::Stated),
    variant_kind("N2", false, StylusSource::OneBall),
    variant_kind("N3", false, StylusSource::AllBalls),
    variant_kind("S1", true, StylusSource::Stated),
    variant_kind("S2", true, StylusSource::OneBall),
    variant_kind("S3", true, StylusSource::AllBalls),
    variant_kind("S4", true, StylusSource::ErrorAndStylusFit),
];

/// A variant with its deviations and their first-order changes.
pub struct DomeVariant {
    pub kind: VariantKind,
    /// Stylus from the spindle datum, mm.
    pub stylus: Vector3<f64>,
    /// Fit of the certified positions to the measured ones, table frame, mm.
    pub fit: RigidFit,
    /// Derivative of each point by the stylus.
    stylus_derivatives: Vec<Matrix3<f64>>,
    /// Gain of the stylus. `None`: the stylus is as stated.
    gain: Option<StylusGain>,
    /// Change of the stylus by each error of the prior (S4).
    prior_derivatives: Vec<Vector3<f64>>,
}

/// Changes of the inputs of the variants.
pub struct InputChanges<'a> {
    /// Change of each point in the table frame, mm, without the errors of the machine.
    pub points: &'a [Vector3<f64>],
    /// Change of each point by the errors of the prior.
    pub error_derivatives: &'a [Vector3<f64>],
    /// Changes of the errors of the prior.
    pub errors: &'a [f64],
    /// Change of the certified position of each point, artefact frame, mm.
    pub certified: &'a [Vector3<f64>],
}

/// A stylus and its derivatives.
pub struct StylusResult {
    pub stylus: Vector3<f64>,
    pub gain: Option<StylusGain>,
    pub prior_derivatives: Vec<Vector3<f64>>,
}

impl DomeVariant {
    /// `errors`: errors of the machine of this variant.
    pub fn new(kind: VariantKind, points: &MeasuredPoints, errors: &[ErrorTerm], found: StylusResult) -> Self {
        let seen = points.table_positions_mm(errors, found.stylus);
        Self {
            kind,
            stylus: found.stylus,
            fit: RigidFit::new(&points.certified_mm, &seen),
            stylus_derivatives: points.stylus_derivatives(errors),
            gain: found.gain,
            prior_derivatives: found.prior_derivatives,
        }
    }

    /// Whether the stylus is a result of the fit.
    pub fn has_stylus(&self) -> bool {
        self.gain.is_some()
    }

    /// First-order changes of the deviations and of the stylus, mm.
    pub fn first_order_change(&self, changes: &InputChanges<'_>) -> (Vec<Vector3<f64>>, Vector3<f64>) {
        let places = changes.certified.iter().map(|change| self.fit.rotation * change);
        let places: Vec<Vector3<f64>> = places.collect();
        let mut moved = changes.points.to_vec();
        let is_full = self.kind.stylus == StylusSource::ErrorAndStylusFit;
        if is_full {
            moved.iter_mut().zip(&places).for_each(|(moved, place)| *moved -= place);
        }
        if self.kind.is_calibrated && !is_full {
            moved.iter_mut().zip(changes.error_derivatives).for_each(|(moved, by)| *moved += by);
        }
        let mut stylus = self.gain.as_ref().map_or(Vector3::zeros(), |gain| stylus_change(gain, &moved));
        let prior = self.prior_derivatives.iter().zip(changes.errors);
        stylus += prior.map(|(by, error)| by * *error).sum::<Vector3<f64>>();
        if is_full {
            moved.iter_mut().zip(changes.error_derivatives).for_each(|(moved, by)| *moved += by);
        } else {
            moved.iter_mut().zip(&places).for_each(|(moved, place)| *moved -= place);
        }
        moved.iter_mut().zip(&self.stylus_derivatives).for_each(|(moved, by)| *moved += by * stylus);
        self.fit.subtract_rigid_motion(&mut moved);
        (moved, stylus)
    }
}
