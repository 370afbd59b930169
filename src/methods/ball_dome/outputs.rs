//! Builds the results of the estimate, with the symbols and units in which it reports them: styluses, largest and mean
//! deviations, curves, histogram, arrows, and texts.

use std::ops::Range;

use faer::Mat;

use super::measured_points::MeasuredPoints;
use super::model::DomeModel;
use super::variant::DomeVariant;
use crate::ball_measurement::{
    BallCentre, MeasurementPurpose, MeasurementSetup, ObservedBalls, describe_rotary_axes_in_degrees,
};
use crate::identification::{
    Identification, IdentificationOutputs, MisfitAdvice, NonlinearOutputs, ObservationModel as _, OutputCurve,
    OutputParameter, function_of_numbered_values, slope_of_unknown,
};
use machine::Position;
use machine::record::estimate::{
    ArrowFigure, ArrowGroup, EstimatedFunction, FigureArrow, FunctionFigureKind, Unit, VectorFigureKind,
};

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    possible_causes: "error motions, sag of the tilted table, a change of the machine since the estimate, deformation of \
        the artefact",
    declaring_settings: "repeatability_um, error_motion_um or certificate_u_mm",
};

/// The fitted styluses, then largest and mean deviations; as curves, the mean deviations of the groups. Largest and
/// mean deviations are nonlinear functions, and their uncertainty comes from the Monte Carlo trials.
pub fn build_outputs(model: &DomeModel<'_>, groups: &MeasurementGroups) -> IdentificationOutputs {
    let values = model.result_values(&vec![0.0; model.observation_count()]);
    let names = model.variants.iter().flat_map(|v| ["max", "mean"].map(|of| format!("{}_{of}", v.kind.name)));
    let deviation =
        |(symbol, value): (String, &f64)| OutputParameter { symbol, unit: Unit::Um, value: *value, linear_slope: None };
    let deviations: Vec<OutputParameter> = names.zip(&values).map(deviation).collect();
    let count = deviations.len();
    let with_stylus = model.variants.iter().filter(|variant| variant.has_fitted_stylus());
    let styluses = with_stylus.flat_map(|v| ["x", "y", "z"].map(|k| format!("{}_tool_{k}", v.kind.name)));
    let stylus = |(i, symbol): (usize, String)| OutputParameter::from_unknown(&symbol, Unit::Mm, count + i, &values);
    let nonlinear = NonlinearOutputs {
        outputs: deviations,
        trial_values: Box::new(move |trials| Mat::from_fn(trials.nrows(), count, |i, j| trials[(i, j)])),
    };
    IdentificationOutputs {
        linear_parameters: styluses.enumerate().map(stylus).collect(),
        curves: group_mean_curves(model, groups, &values),
        nonlinear: Some(nonlinear),
    }
}

/// Groups of measurements: those of each ball in the order of the artefact, and those at each indexation in
/// the order of the run, without references.
pub struct MeasurementGroups {
    /// Number of groups of balls at the start of `point_indices`; a group of a ball without measurement is empty.
    ball_group_count: usize,
    /// Indices of the points of each group: the groups of the balls, then those of the indexations.
    pub point_indices: Vec<Vec<usize>>,
}

impl MeasurementGroups {
    pub fn from_observed(observed: &ObservedBalls) -> Self {
        let slow = || observed.centres.iter().enumerate().filter(|(_, c)| c.label.purpose == MeasurementPurpose::Slow);
        let group = |key: fn(&BallCentre) -> usize| -> Vec<Vec<usize>> {
            let count = slow().map(|(_, centre)| key(centre) + 1).max().unwrap_or(0);
            let mut groups = vec![Vec::new(); count];
            slow().for_each(|(i, centre)| groups[key(centre)].push(i));
            groups
        };
        let balls = group(|centre| centre.ball_index);
        let indexations = group(|centre| centre.label.indexation_index as usize);
        Self { ball_group_count: balls.len(), point_indices: [balls, indexations].concat() }
    }
}

/// Mean deviation of each ball and of each indexation, over their numbers from 1; empty groups are omitted.
fn group_mean_curves(model: &DomeModel<'_>, groups: &MeasurementGroups, values: &[f64]) -> Vec<OutputCurve> {
    let kinds =
        [("ball", 0..groups.ball_group_count), ("indexation", groups.ball_group_count..groups.point_indices.len())];
    let curve = |(variant, (argument, range)): (usize, (&'static str, Range<usize>))| {
        let first = range.start;
        let seen: Vec<usize> = range.filter(|group| !groups.point_indices[*group].is_empty()).collect();
        let at = |group: &usize| model.group_mean_value_index(variant, *group);
        OutputCurve {
            symbol: format!("{}_{argument}", model.variants[variant].kind.name),
            argument,
            argument_unit: "",
            x: seen.iter().map(|group| (group - first + 1) as f64).collect(),
            y: seen.iter().map(|group| values[at(group)]).collect(),
            unit: Unit::Um,
            figure: FunctionFigureKind::Points,
            slopes: seen.iter().map(|group| slope_of_unknown(at(group), values.len())).collect(),
        }
    };
    let both = |variant| kinds.clone().map(|kind| (variant, kind));
    (0..model.variants.len()).flat_map(both).map(curve).collect()
}

/// Lengths of the deviations of all measurements, as a histogram.
pub fn deviation_histogram(variant: &DomeVariant) -> EstimatedFunction {
    let norms = variant.certified_to_measured_fit.deviations.iter().map(|deviation| deviation.norm());
    let symbol = format!("{}_deviation", variant.kind.name);
    EstimatedFunction {
        figure: FunctionFigureKind::Histogram,
        ..function_of_numbered_values(&symbol, "measurement", norms)
    }
}

/// Deviations in the artefact frame, as arrows in µm at the certified positions: one figure for each variant in
/// `shown`, in their order.
pub fn deviation_arrows(
    setup: &MeasurementSetup<'_>,
    observed: &ObservedBalls,
    points: &MeasuredPoints,
    shown: [&DomeVariant; 2],
) -> Vec<ArrowFigure> {
    let figure = |variant: &DomeVariant| {
        let arrow = |i: usize| FigureArrow {
            label: setup.balls.balls[points.ball_indices[i]].id.clone(),
            at_mm: points.certified_positions_mm[i].into(),
            vector: (variant.certified_to_measured_fit.rotation.inverse()
                * variant.certified_to_measured_fit.deviations[i]
                * 1e3)
                .into(),
            modelled: None,
            flagged: false,
        };
        let group = |(place, at): (usize, &Position)| {
            let here =
                (0..points.point_count()).filter(|i| observed.centres[*i].commanded_rotary_position_index == place);
            ArrowGroup { name: describe_rotary_axes_in_degrees(at), arrows: here.map(arrow).collect() }
        };
        ArrowFigure {
            symbol: format!("{}_deviations", variant.kind.name),
            unit: Unit::Um,
            groups: observed.commanded_rotary_positions.iter().enumerate().map(group).collect(),
            figure: VectorFigureKind::Arrows,
        }
    };
    shown.into_iter().map(figure).collect()
}

/// `noise_deviations_mm`: largest and mean deviation that the declared sources alone cause.
pub fn describe_gauge(tool_ball: &str, noise_deviations_mm: [f64; 2]) -> Vec<String> {
    let [largest, mean] = noise_deviations_mm.map(|mm| mm * 1e3);
    vec![
        "deviations: after one rigid fit of the certified positions over all points".to_owned(),
        format!(
            "the deviations include the scatter of the measurement and the errors of the certificate: on a \
            machine without errors the largest deviation is about {largest:.1} µm and the mean about \
            {mean:.1} µm"
        ),
        format!("N2, S2: the stylus for which the measured positions of ball {tool_ball} agree best"),
        "S4: the stylus of a fit of all machine errors to the certified positions, minus the spindle offset \
        of the given estimate"
            .to_owned(),
    ]
}

pub fn collect_warnings(
    observed: &ObservedBalls,
    has_machine_estimate: bool,
    identified: &Identification,
) -> Vec<String> {
    let mut lines = observed.skipped_measurements.clone();
    lines.extend((!has_machine_estimate).then(|| {
        "only the nominal machine is compared (N1 to N3): S1 to S4 require an estimate of samba (--with)".to_owned()
    }));
    lines.extend(identified.misfit_warning(&MISFIT_ADVICE));
    lines.extend(identified.outlier_check.warnings.iter().cloned());
    lines.extend(identified.trial_contradiction_warning());
    lines
}
