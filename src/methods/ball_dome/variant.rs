//! The variants of paper 4, section 7: the machine and the stylus with which the readings are transformed
//! into the table frame. Their results are the deviations of the balls from the certificate after one rigid
//! fit over all points.

use estimation::rigid_fit::RigidFit;
use nalgebra::{Matrix3, Vector3};

use super::measured_points::MeasuredPoints;
use super::stylus_gain::{StylusGain, stylus_change};
use machine::kinematics::ErrorTerm;

/// Machine and stylus of a variant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VariantKind {
    /// Name of the variant in the paper.
    pub name: &'static str,
    /// Whether the variant uses the machine of the prior; otherwise it uses the nominal one.
    pub uses_calibrated_machine: bool,
    pub stylus: StylusSource,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StylusSource {
    /// The stylus as the machine file states it.
    Stated,
    /// Fitted to the readings of one ball at all indexations.
    OneBall,
    /// Fitted to the readings of all balls.
    AllBalls,
    /// Fitted together with the machine errors. The fitted stylus contains the offset of the spindle; its value in
    /// the prior is subtracted.
    FittedWithMachineErrors,
}

pub const VARIANT_KINDS: [VariantKind; 7] = [
    VariantKind { name: "N1", uses_calibrated_machine: false, stylus: StylusSource::Stated },
    VariantKind { name: "N2", uses_calibrated_machine: false, stylus: StylusSource::OneBall },
    VariantKind { name: "N3", uses_calibrated_machine: false, stylus: StylusSource::AllBalls },
    VariantKind { name: "S1", uses_calibrated_machine: true, stylus: StylusSource::Stated },
    VariantKind { name: "S2", uses_calibrated_machine: true, stylus: StylusSource::OneBall },
    VariantKind { name: "S3", uses_calibrated_machine: true, stylus: StylusSource::AllBalls },
    VariantKind { name: "S4", uses_calibrated_machine: true, stylus: StylusSource::FittedWithMachineErrors },
];

/// One variant evaluated: the rigid fit, whose residuals are the deviations of the balls from the certificate.
pub struct DomeVariant {
    pub kind: VariantKind,
    pub stylus: StylusEstimate,
    /// Fit of the certified positions to the measured ones, table frame, mm.
    pub certified_to_measured_fit: RigidFit,
    /// Derivative of each point by the stylus.
    point_derivatives_by_stylus: Vec<Matrix3<f64>>,
}

/// Changes of the inputs of the variants.
pub struct InputChanges<'a> {
    /// Change of each point in the table frame, mm, without the errors of the machine.
    pub points_mm: Vec<Vector3<f64>>,
    /// Change of each point by the errors of the prior, table frame, mm.
    pub points_by_prior_errors_mm: Vec<Vector3<f64>>,
    /// Changes of the errors of the prior.
    pub prior_errors: &'a [f64],
    /// Change of the certified position of each point, artefact frame, mm.
    pub certified_positions_mm: Vec<Vector3<f64>>,
}

/// A stylus, and its derivatives by the errors of the prior.
pub struct StylusEstimate {
    /// Stylus from the spindle datum, mm.
    pub vector_mm: Vector3<f64>,
    /// Gain of the stylus. `None`: the stylus is as stated.
    pub gain: Option<StylusGain>,
    /// Change of the stylus by each error of the prior (S4); empty for the other variants.
    pub stylus_derivatives_by_prior_errors: Vec<Vector3<f64>>,
}

impl DomeVariant {
    /// `known_errors`: errors of the machine from the prior; empty for the nominal machine.
    pub fn new(kind: VariantKind, points: &MeasuredPoints, known_errors: &[ErrorTerm], stylus: StylusEstimate) -> Self {
        let measured_mm = points.table_positions_mm(known_errors, stylus.vector_mm);
        let fit = RigidFit::new(&points.certified_positions_mm, &measured_mm);
        Self {
            kind,
            stylus,
            certified_to_measured_fit: fit,
            point_derivatives_by_stylus: points.point_derivatives_by_stylus(known_errors),
        }
    }

    /// Whether the stylus is a result of the fit.
    pub fn has_fitted_stylus(&self) -> bool {
        self.stylus.gain.is_some()
    }

    /// First-order changes of the deviations and of the stylus, mm.
    pub fn first_order_deviation_and_stylus_changes(
        &self,
        changes: &InputChanges<'_>,
    ) -> (Vec<Vector3<f64>>, Vector3<f64>) {
        let mut moved = changes.points_mm.clone();
        let subtract_certified = |moved: &mut [Vector3<f64>]| {
            let certified =
                changes.certified_positions_mm.iter().map(|change| self.certified_to_measured_fit.rotation * change);
            moved.iter_mut().zip(certified).for_each(|(moved, change)| *moved -= change);
        };
        let add_errors = |moved: &mut [Vector3<f64>]| {
            moved.iter_mut().zip(&changes.points_by_prior_errors_mm).for_each(|(moved, change)| *moved += change);
        };
        let is_fitted_with_errors = self.kind.stylus == StylusSource::FittedWithMachineErrors;
        if is_fitted_with_errors {
            subtract_certified(&mut moved);
        } else if self.kind.uses_calibrated_machine {
            add_errors(&mut moved);
        }
        let mut stylus = self.stylus.gain.as_ref().map_or(Vector3::zeros(), |gain| stylus_change(gain, &moved));
        let prior = self.stylus.stylus_derivatives_by_prior_errors.iter().zip(changes.prior_errors);
        stylus += prior.map(|(by, error)| by * *error).sum::<Vector3<f64>>();
        if is_fitted_with_errors {
            add_errors(&mut moved)
        } else {
            subtract_certified(&mut moved)
        }
        moved.iter_mut().zip(&self.point_derivatives_by_stylus).for_each(|(moved, by)| *moved += by * stylus);
        self.certified_to_measured_fit.subtract_rigid_motion(&mut moved);
        (moved, stylus)
    }
}
