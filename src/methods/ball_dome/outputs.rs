//! The estimate in the words and units of the contract.

use faer::Mat;

use super::model::DomeModel;
use super::points::Points;
use super::variant::Variant;
use crate::ball_measurement::{MeasurementSetup, Observed, describe_position};
use crate::identification::{
    Identification, MisfitAdvice, NonlinearOutputs, ObservationModel as _, Output, Outputs,
    numbered_values,
};
use machine::Position;
use machine::record::estimate::{
    Arrow, ArrowFigure, Arrows, FigureKind, Function, Unit, VectorKind,
};

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    causes: "error motions, sag of the table as it tilts, a machine that has changed since the estimate, an artefact \
             that gives way",
    declared_by: "repeatability_um, error_motion_um or certificate_u_mm",
};

/// The stylus where it is found, then largest and mean deviations: these are not linear in anything, and have
/// their uncertainty from the trials.
pub fn outputs(model: &DomeModel<'_>) -> Outputs {
    let values = model.values(&vec![0.0; model.observations()]);
    let names = model
        .variants
        .iter()
        .flat_map(|v| ["max", "mean"].map(|of| format!("{}_{of}", v.kind.name)));
    let deviation = |(symbol, value): (String, &f64)| Output {
        symbol,
        unit: Unit::Um,
        value: *value,
        slope: None,
    };
    let deviations: Vec<Output> = names.zip(&values).map(deviation).collect();
    let count = deviations.len();
    let with_stylus = model.variants.iter().filter(|variant| variant.has_stylus());
    let styluses =
        with_stylus.flat_map(|v| ["x", "y", "z"].map(|k| format!("{}_tool_{k}", v.kind.name)));
    let stylus =
        |(i, symbol): (usize, String)| Output::unknown(&symbol, Unit::Mm, count + i, &values);
    let nonlinear = NonlinearOutputs {
        outputs: deviations,
        values: Box::new(move |trials| Mat::from_fn(trials.nrows(), count, |i, j| trials[(i, j)])),
    };
    Outputs {
        parameters: styluses.enumerate().map(stylus).collect(),
        nonlinear: Some(nonlinear),
        ..Outputs::default()
    }
}

/// Deviation of each measurement in the order of time.
pub fn histogram(variant: &Variant) -> Function {
    let norms = variant.fit.deviations.iter().map(|deviation| deviation.norm());
    let symbol = format!("{}_deviation", variant.kind.name);
    Function { figure: FigureKind::Histogram, ..numbered_values(&symbol, "measurement", norms) }
}

/// Mean deviation of each ball in the order of the artefact, and at each indexation.
pub fn by_ball_and_place(variant: &Variant, points: &Points, observed: &Observed) -> [Function; 2] {
    let mean = |group: &dyn Fn(usize) -> bool| {
        let own = (0..points.count()).filter(|i| group(*i));
        let own: Vec<f64> = own.map(|i| variant.fit.deviations[i].norm()).collect();
        own.iter().sum::<f64>() / own.len().max(1) as f64
    };
    let balls = points.ball.iter().max().map_or(0, |last| last + 1);
    let places = observed.commanded.len();
    let of_ball = (0..balls).map(|ball| mean(&|i| points.ball[i] == ball));
    let of_place = (0..places).map(|place| mean(&|i| observed.centres[i].commanded == place));
    let name = variant.kind.name;
    [
        numbered_values(&format!("{name}_ball"), "ball", of_ball),
        numbered_values(&format!("{name}_indexation"), "indexation", of_place),
    ]
}

/// Deviations in the artefact frame.
pub fn arrows(
    setup: &MeasurementSetup<'_>,
    observed: &Observed,
    points: &Points,
    shown: [&Variant; 2],
) -> Vec<ArrowFigure> {
    let figure = |variant: &Variant| {
        let arrow = |i: usize| Arrow {
            label: setup.balls.balls[points.ball[i]].id.clone(),
            at_mm: points.certified[i].into(),
            vector: (variant.fit.rotation.inverse() * variant.fit.deviations[i] * 1e3).into(),
            modelled: None,
            flagged: false,
        };
        let group = |(place, at): (usize, &Position)| {
            let here = (0..points.count()).filter(|i| observed.centres[*i].commanded == place);
            Arrows { name: describe_position(at), arrows: here.map(arrow).collect() }
        };
        ArrowFigure {
            symbol: format!("{}_deviations", variant.kind.name),
            unit: Unit::Um,
            groups: observed.commanded.iter().enumerate().map(group).collect(),
            figure: VectorKind::Arrows,
        }
    };
    shown.into_iter().map(figure).collect()
}

/// `alone_mm`: largest and mean deviation that the declared sources alone make.
pub fn gauge(tool_ball: &str, alone_mm: [f64; 2]) -> Vec<String> {
    let [largest, mean] = alone_mm.map(|mm| mm * 1e3);
    vec![
        "deviations: after one rigid fit of the certified places over all points".to_owned(),
        format!(
            "deviations hold the scatter of the measurement and the errors of the certificate: on a machine without errors \
             these make a largest of about {largest:.1} µm and a mean of about {mean:.1} µm"
        ),
        format!("N2, S2: the stylus that makes the places of ball {tool_ball} agree best"),
        "S4: the stylus of a fit of all machine errors to the certified places, less the spindle's offset of the \
         estimate that was taken as known"
            .to_owned(),
    ]
}

pub fn warnings(
    observed: &Observed,
    is_calibrated: bool,
    identified: &Identification,
) -> Vec<String> {
    let mut lines = observed.left_out.clone();
    lines.extend((!is_calibrated).then(|| {
        "only the nominal machine is compared (N1 to N3): S1 to S4 take an estimate of samba (--with)".to_owned()
    }));
    lines.extend(identified.misfit_warning(&MISFIT_ADVICE));
    lines.extend(identified.trials_warning());
    lines
}
