//! Reported quantities: coefficients and curves of the error motions, eccentricity, roundness.

use machine::record::estimate::Unit;

use super::fit::SeparationFit;
use super::model::{MotionOrForm, ProbeLayout, co_rotating_directions};
use super::settings::TurnSampling;
use crate::identification::{
    Harmonic, HarmonicFunction, IdentificationOutputs, NonlinearOutputs, OutputParameter, range_outputs,
    synchronous_ranges,
};

/// Number of points of a curve over one revolution.
const CURVE_POINT_COUNT: usize = 120;

/// Derivatives of the cosine and the sine part of one harmonic by the unknowns of that harmonic.
type HarmonicDerivatives = [Vec<f64>; 2];

/// Derivatives of all reported quantities by the unknowns.
pub struct ReportedMotions<'a> {
    layout: &'a ProbeLayout,
    fit: &'a SeparationFit,
    /// Components × harmonics from 1 on. `None`: not identifiable.
    harmonic_derivatives: Vec<(MotionOrForm, Vec<Option<HarmonicDerivatives>>)>,
    /// Text that the co-rotating first harmonic is set to zero, with the reason.
    pub gauge_text: String,
}

impl<'a> ReportedMotions<'a> {
    pub fn new(layout: &'a ProbeLayout, fit: &'a SeparationFit) -> Self {
        let pairs = [(MotionOrForm::X, MotionOrForm::Y), (MotionOrForm::A, MotionOrForm::B)];
        let co_rotating = |(a, b)| co_rotating_directions(layout, a, b);
        let removed: Vec<Vec<f64>> = pairs.into_iter().flat_map(co_rotating).collect();
        let [(x, y), (a, b)] = pairs.map(|(a, b)| (a.symbol(layout.measured_axis), b.symbol(layout.measured_axis)));
        let gauge = format!(
            "the co-rotating first harmonic of ({x}, {y}) and ({a}, {b}) is zero: inseparable from the eccentricity \
             and tilt of the artefact and of the indexing stage"
        );
        let derivatives = |(column, component)| {
            let removed = |block| if block == 0 { removed.as_slice() } else { &[] };
            let blocks = fit.blocks.iter().enumerate();
            (
                component,
                blocks.map(|(block, harmonic)| harmonic.identifiable_harmonic_slopes(column, removed(block))).collect(),
            )
        };
        let components = layout.components().into_iter().enumerate();
        Self { layout, fit, harmonic_derivatives: components.map(derivatives).collect(), gauge_text: gauge }
    }

    /// Harmonics that are not reported, and the combinations of unknowns that the rows do not separate.
    pub fn describe_not_identifiable(&self) -> Vec<String> {
        let lost_harmonics = |(component, parts): &(MotionOrForm, Vec<Option<HarmonicDerivatives>>)| {
            let lost = parts.iter().zip(1..).filter(|(parts, _)| parts.is_none());
            let name =
                |(_, order): (_, usize)| format!("{} harmonic {order}", component.symbol(self.layout.measured_axis));
            lost.map(name).collect::<Vec<String>>()
        };
        let combinations = self.fit.blocks.iter().flat_map(|harmonic| harmonic.undetermined_names.clone());
        self.harmonic_derivatives.iter().flat_map(lost_harmonics).chain(combinations).collect()
    }

    /// Whether the harmonic `order`, counted from 1, of the component is identifiable. `false` also if the layout
    /// does not have the component.
    pub fn is_identifiable(&self, component: MotionOrForm, order: usize) -> bool {
        let own = self.harmonic_derivatives.iter().find(|(own, _)| *own == component);
        own.is_some_and(|(_, parts)| matches!(parts.get(order - 1), Some(Some(_))))
    }

    /// The identifiable harmonics of one component. The first harmonic of a form is omitted, because it is the
    /// eccentricity of the artefact.
    fn harmonic_function(
        &self,
        (component, parts): &(MotionOrForm, Vec<Option<HarmonicDerivatives>>),
    ) -> HarmonicFunction {
        let harmonic = |(block, parts): (usize, &Option<HarmonicDerivatives>)| {
            let parts = parts.as_ref()?.each_ref().map(|slope| self.fit.extend_slope_to_all_unknowns(block, slope));
            Some(Harmonic { order: (block + 1) as f64, cosine_and_sine_slopes: parts })
        };
        let first = usize::from(component.is_artefact_form());
        HarmonicFunction {
            symbol: component.symbol(self.layout.measured_axis),
            unit: component_unit(*component),
            harmonics: parts.iter().enumerate().skip(first).filter_map(harmonic).collect(),
        }
    }

    /// The error motions with their identifiable harmonics, without the forms of the artefact.
    pub fn error_motions(&self) -> impl Iterator<Item = (MotionOrForm, HarmonicFunction)> {
        let motions = self.harmonic_derivatives.iter().filter(|(component, _)| !component.is_artefact_form());
        motions.map(|parts| (parts.0, self.harmonic_function(parts)))
    }

    /// Centre of a section relative to the table's axis at the first index and q = 0. It contains the co-rotating
    /// error motion.
    fn section_centre_outputs(&self, section: usize) -> Vec<OutputParameter> {
        let (layout, sign) = (self.layout, self.layout.turn_sign);
        let lever = layout.section_z_mm[section] - layout.reference_z_mm;
        let form = layout.components().iter().position(|c| *c == MotionOrForm::Roundness(section));
        let index_angle = layout.index_angles_rad.first().copied().unwrap_or(0.0);
        let (sin, cos) = index_angle.sin_cos();
        let offset = co_rotating_directions(layout, MotionOrForm::X, MotionOrForm::Y);
        let tilt = co_rotating_directions(layout, MotionOrForm::A, MotionOrForm::B);
        let slope = |axis: usize, lever: f64, of_form: [f64; 2]| {
            let mut slope: Vec<f64> = offset[axis].iter().map(|d| d / 2.0).collect();
            let tilt = tilt.get(1 - axis).into_iter().flatten();
            slope.iter_mut().zip(tilt).for_each(|(slope, d)| *slope += lever * d / 2.0);
            form.into_iter().for_each(|j| slope[2 * j..2 * j + 2].copy_from_slice(&of_form));
            slope
        };
        let output = |axis: &str, slope: Vec<f64>| {
            let symbol = format!("ecc_{axis}{}", section + 1);
            OutputParameter::from_coefficients(
                &symbol,
                Unit::Um,
                self.fit.extend_slope_to_all_unknowns(0, &slope),
                &self.fit.x,
            )
        };
        vec![output("X", slope(0, lever, [cos, sign * sin])), output("Y", slope(1, -lever, [sin, -sign * cos]))]
    }

    /// Outputs that are linear in the unknowns: coefficients, eccentricities and curves.
    pub fn linear_outputs(&self) -> IdentificationOutputs {
        let x = self.solution();
        let motions: Vec<HarmonicFunction> = self.error_motions().map(|(_, motion)| motion).collect();
        let sections = 0..self.layout.section_z_mm.len();
        let mut parameters: Vec<OutputParameter> = motions.iter().flat_map(|m| m.coefficient_outputs(x)).collect();
        parameters.extend(sections.flat_map(|section| self.section_centre_outputs(section)));
        let curves = self.harmonic_derivatives.iter().filter(|(component, _)| *component != MotionOrForm::FaceForm);
        let curves = curves.map(|parts| self.harmonic_function(parts));
        let curves = curves.filter(|function| !function.harmonics.is_empty());
        IdentificationOutputs {
            linear_parameters: parameters,
            curves: curves.map(|function| function.curve("C", CURVE_POINT_COUNT, x)).collect(),
            nonlinear: None,
        }
    }

    /// Values of the motions by ISO 230-7, and roundness (peak to valley from the least-squares circle). ISO 230-7
    /// specifies a turning axis. For dwell points the same range is named `EXC_range`.
    pub fn motion_ranges(&self, sampling: TurnSampling) -> NonlinearOutputs {
        let ranges = |parts: &(MotionOrForm, Vec<Option<HarmonicDerivatives>>)| {
            let function = self.harmonic_function(parts);
            match (parts.0, sampling) {
                (MotionOrForm::FaceForm, _) => Vec::new(),
                (MotionOrForm::Roundness(section), _) => {
                    Vec::from_iter(function.range_output(format!("RONt_{}", section + 1)))
                }
                (component, TurnSampling::Continuous) => synchronous_ranges(&function, component == MotionOrForm::Z),
                _ => Vec::from_iter(function.range_output(format!("{}_range", function.symbol))),
            }
        };
        range_outputs(self.harmonic_derivatives.iter().flat_map(ranges).collect(), self.solution())
    }

    /// Solved unknowns of all harmonics.
    pub fn solution(&self) -> &[f64] {
        &self.fit.x
    }
}

fn component_unit(component: MotionOrForm) -> Unit {
    match component {
        MotionOrForm::A | MotionOrForm::B => Unit::Urad,
        _ => Unit::Um,
    }
}
