//! Positions of the touches of a run: plan view and side view of the artefact, in the table frame; lengths in mm.

use minijinja::{Value, context};
use nalgebra::Vector3;

use crate::report::number::format_fixed;
use crate::report::step_text::{describe_axis_value, describe_step};
use crate::service::http::problem::Problem;
use crate::store::{Journal, RunId, RunProgress};
use machine::artefact::{ArtefactBody, BodyShape, artefact_bodies};
use machine::kinematics::KinematicChain;
use machine::record::plan::{Plan, Step, StepKind};
use machine::record::reading::Reading;
use machine::{Axis, Position, frame::Point};

/// The two views, and the index of the coordinate that points up in each.
const VIEW_NAMES_AND_UP_INDEXES: [(&str, usize); 2] = [("from above", 1), ("from the side", 2)];
/// Radius of a mark, as a fraction of the picture's width.
const MARK_RADIUS_PER_PICTURE_WIDTH: f64 = 1.0 / 70.0;
/// Margin on each side, as a fraction of the largest extent of the drawing.
const MARGIN_PER_EXTENT: f64 = 0.08;

/// Views of `run`; `None` if its number is 0, that is, no run has begun, or if the kinematics of its plan are
/// invalid.
pub fn views_of_run(journal: &Journal, run: RunId) -> Result<Option<Value>, Problem> {
    match run.0 {
        0 => Ok(None),
        _ => Ok(progress_views(&journal.load_run_progress(run)?)),
    }
}

/// Mark of one step in the views.
struct StepMark {
    /// CSS class: `now` for the next step without a reading, `done` for a step with one, otherwise `next`.
    css_class: &'static str,
    /// Path of a scan; for a touch one point, the start of its probing motion. Table frame, mm.
    path_in_table_mm: Vec<Vector3<f64>>,
}

/// Template values of both views and of the progress; `None`: the kinematics of the plan are invalid.
fn progress_views(progress: &RunProgress) -> Option<Value> {
    let marks = step_marks(progress)?;
    let bodies: Vec<BodyShape> = artefact_bodies(&progress.plan.artefact).into_iter().map(|part| part.shape).collect();
    let count = |class| marks.iter().filter(|mark| mark.css_class == class).count();
    Some(context! {
        done => count("done"),
        next => count("next"),
        step => current_step(progress).map(describe_step),
        last => progress.last_reading.as_ref().map(|reading| reading_values(reading, last_deviation_mm(progress))),
        views => VIEW_NAMES_AND_UP_INDEXES.map(|(name, up)| projection_values(name, up, &marks, &bodies)),
    })
}

/// Marks of all steps except prompts, the current step last; stages that are not planned yet have none. `None`: the
/// kinematics of the plan are invalid.
fn step_marks(progress: &RunProgress) -> Option<Vec<StepMark>> {
    let RunProgress { plan, stored_steps_and_repeats: stored_readings, .. } = progress;
    let chain = KinematicChain::new(&plan.machine).ok()?;
    let current = next_step_without_reading(progress);
    let class = |step: u32| match (current == Some(step), stored_readings.iter().any(|(read, _)| *read == step)) {
        (true, _) => "now",
        (false, true) => "done",
        (false, false) => "next",
    };
    let mark = |step: &Step| StepMark {
        css_class: class(step.id),
        path_in_table_mm: step_path_in_table_mm(plan, &chain, step),
    };
    // The current step is drawn last, on top of the others.
    let mut marks: Vec<StepMark> = motion_steps(plan).map(mark).collect();
    marks.sort_by_key(|mark| mark.css_class == "now");
    Some(marks)
}

/// The next step without a reading; `None`: each planned step has one.
fn current_step(progress: &RunProgress) -> Option<&Step> {
    let current = next_step_without_reading(progress)?;
    progress.plan.steps.iter().find(|step| step.id == current)
}

/// Deviation of the last touch from the nominal surface of the nearest touchable body of the artefact, outward
/// positive, mm; `None` for a scan or without a reading. It contains the position errors of the artefact and of the
/// axes.
fn last_deviation_mm(progress: &RunProgress) -> Option<f64> {
    let RunProgress { plan, last_reading, .. } = progress;
    let touch = last_reading.as_ref().filter(|reading| reading.value_mm.is_none())?;
    let [x, y, z] = plan.machine.tool_mm;
    let tip = KinematicChain::new(&plan.machine).ok()?.tip_in_table(&touch.position, Point::new(x, y, z), &[]).mm;
    let deviation = |body: ArtefactBody| body.shape.distance_to_surface_mm(tip) - plan.probe.ball_radius_mm;
    let touchable = artefact_bodies(&plan.artefact).into_iter().filter(|body| body.is_touchable);
    touchable.map(deviation).min_by(|a, b| a.abs().total_cmp(&b.abs()))
}

/// Position, value, deviation and temperatures of a reading.
fn reading_values(reading: &Reading, deviation_mm: Option<f64>) -> Value {
    let position: Vec<String> = reading.position.iter().map(|(axis, value)| describe_axis_value(axis, value)).collect();
    let temperatures = reading.temperatures_c.iter().map(|(name, celsius)| format!("{name} {celsius:.1} °C"));
    context! {
        position => position.join(", "),
        value_mm => reading.value_mm.map(|mm| format_fixed(mm, 4)),
        deviation_mm => deviation_mm.map(|mm| format_fixed(mm, 3)),
        sensor => reading.sensor.as_str(),
        temperature => temperatures.collect::<Vec<_>>().join(", "),
    }
}

/// Steps of the plan except prompts.
fn motion_steps(plan: &Plan) -> impl Iterator<Item = &Step> {
    plan.steps.iter().filter(|step| step.kind != StepKind::Prompt)
}

/// Number of the next step without a reading. After a stop the reference checks are the last stage, and the stage
/// before it continues after them.
fn next_step_without_reading(
    RunProgress { plan, stages, stored_steps_and_repeats: stored_readings, .. }: &RunProgress,
) -> Option<u32> {
    let is_open = |step: u32, repeat: u32| {
        !stored_readings.contains(&(step, repeat)) && motion_steps(plan).any(|known| known.id == step)
    };
    stages.iter().rev().find_map(|stage| stage.steps.iter().copied().find(|step| is_open(*step, stage.repeat)))
}

/// Path of the stylus ball, or of the zero point of a sensor in the spindle, table frame, mm; for a touch only its
/// start.
fn step_path_in_table_mm(plan: &Plan, chain: &KinematicChain, step: &Step) -> Vec<Vector3<f64>> {
    let mut in_spindle = plan.sensors.iter().filter(|sensor| sensor.mount.is_spindle());
    let sensor = in_spindle.find(|sensor| sensor.name == step.first_sensor());
    let [x, y, z] = sensor.map_or(plan.machine.tool_mm, |sensor| sensor.zero_mm);
    let tip_position = |at: &Position| chain.tip_in_table(at, Point::new(x, y, z), &[]).mm;
    match &step.scan {
        Some(scan) => scan.path.iter().map(tip_position).collect(),
        None => vec![tip_position(&step.from)],
    }
}

/// Lower and upper bounds of the bodies and the paths along each axis of the table frame, mm.
fn drawing_bounds(marks: &[StepMark], bodies: &[BodyShape]) -> [Vector3<f64>; 2] {
    let reach = |body: &BodyShape, sign: f64| {
        Vector3::from(Axis::LINEAR.map(|axis| sign * body.max_extent_along(sign * axis.nominal_direction())))
    };
    let path_points = marks.iter().flat_map(|mark| mark.path_in_table_mm.iter().copied());
    let ends = bodies.iter().flat_map(|body| [reach(body, -1.0), reach(body, 1.0)]);
    path_points
        .chain(ends)
        .fold([f64::INFINITY, f64::NEG_INFINITY].map(Vector3::repeat), |[low, high], at| [low.inf(&at), high.sup(&at)])
}

/// Template values of one view. Both views have the same scale. The vertical coordinate is negated, because the y axis
/// of SVG points down. `up_index`: index of the coordinate that points up.
fn projection_values(name: &str, up_index: usize, marks: &[StepMark], bodies: &[BodyShape]) -> Value {
    let [low, high] = drawing_bounds(marks, bodies);
    let span = (high - low).max().max(1.0);
    let middle = (low + high) / 2.0;
    let size = (1.0 + 2.0 * MARGIN_PER_EXTENT) * span;
    let (left, top) = (middle.x - size / 2.0, -middle[up_index] - size / 2.0);
    let flat = |at: Vector3<f64>| [at.x, -at[up_index]];
    context! {
        name,
        frame => format!("{left:.2} {top:.2} {size:.2} {size:.2}"),
        radius => format_mm(MARK_RADIUS_PER_PICTURE_WIDTH * size),
        large => format_mm(2.0 * MARK_RADIUS_PER_PICTURE_WIDTH * size),
        bodies => bodies.iter().map(|body| body_outline(*body, up_index)).collect::<Vec<_>>(),
        marks => marks.iter().map(|mark| context! {
            class => mark.css_class,
            at => mark.path_in_table_mm.first().map(|at| flat(*at).map(format_mm)),
            way => (mark.path_in_table_mm.len() > 1).then(|| polyline_points(mark.path_in_table_mm.iter().map(|at| flat(*at)))),
        }).collect::<Vec<_>>(),
    }
}

/// Outline of a body in one view: a circle, or a line of the body's diameter; the rims of an inclined cylinder are not
/// drawn.
fn body_outline(body: BodyShape, up_index: usize) -> Value {
    let flat = |at: Vector3<f64>| [at.x, -at[up_index]].map(format_mm);
    let circle = |centre: Vector3<f64>, radius: f64| context! { centre => flat(centre), radius => format_mm(radius) };
    match body {
        BodyShape::Ball { centre, radius } => circle(centre, radius),
        BodyShape::Cylinder { from, to, radius } => {
            let along = to - from;
            match along.x.hypot(along[up_index]) < 0.1 * along.norm() {
                true => circle(from, radius),
                false => context! { from => flat(from), to => flat(to), width => format_mm(2.0 * radius) },
            }
        }
    }
}

fn polyline_points(points: impl Iterator<Item = [f64; 2]>) -> String {
    points.map(|[x, y]| format!("{x:.2},{y:.2} ")).collect()
}

fn format_mm(value: f64) -> String {
    format!("{value:.2}")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// A cylinder of 20 mm diameter and 30 mm height, and a touch 5 mm beside it: both views are 34.8 mm wide, with
    /// 30 mm for the drawing.
    #[test]
    fn both_views_show_all_bodies_at_one_scale() {
        let (from, to, radius) = (Vector3::zeros(), Vector3::new(0.0, 0.0, 30.0), 10.0);
        let bodies = [BodyShape::Cylinder { from, to, radius }];
        let marks = [StepMark { css_class: "now", path_in_table_mm: vec![Vector3::new(15.0, 0.0, 12.0)] }];
        let [above, side] = VIEW_NAMES_AND_UP_INDEXES.map(|(name, up)| projection_values(name, up, &marks, &bodies));
        let text = |view: &Value, attribute: &str| view.get_attr(attribute).unwrap().to_string();
        assert_eq!(text(&above, "frame"), "-14.90 -17.40 34.80 34.80");
        assert_eq!(text(&side, "frame"), "-14.90 -32.40 34.80 34.80");
        let body = |view: &Value| view.get_attr("bodies").unwrap().get_item_by_index(0).unwrap();
        assert_eq!(text(&body(&above), "radius"), "10.00");
        assert_eq!(text(&body(&side), "width"), "20.00");
        let mark = side.get_attr("marks").unwrap().get_item_by_index(0).unwrap();
        let at = mark.get_attr("at").unwrap();
        let at = [0, 1].map(|axis| at.get_item_by_index(axis).unwrap().to_string());
        assert_eq!(at, ["15.00", "-12.00"]);
    }

    /// A ball of 6 mm diameter on a cylinder of 20 mm diameter. The axis of the cylinder is 1 mm from that of C, which
    /// turns it by 90° clockwise seen from above; the contact is 50 µm farther out than nominal.
    #[test]
    fn deviation_of_a_touch_is_the_distance_from_the_nominal_surface() {
        let axis = json!({"min": -360.0, "max": 450.0, "rapid_per_min": 6000.0, "acceleration_per_s2": 1000.0});
        let plan = json!({"trued_plan": 1, "method": "test", "settings": {},
            "machine": {"name": "test", "topology": "w-C-b-Y-X-Z-t", "tool_mm": [0.0, 0.0, -100.0],
                "axes": {"X": axis, "Y": axis, "Z": axis, "C": axis}},
            "probe": {"ball_radius_mm": 3.0},
            "artefact": {"kind": "cylinder", "centre_mm": [0.0, 1.0, 0.0], "axis": [0.0, 0.0, 1.0],
                "radius_mm": 10.0, "height_mm": 30.0}});
        let deviation = |value_mm: Option<f64>| {
            let reading = json!({"step": 0, "repeat": 0, "position": {}, "sensor": "probe", "t_s": 0.0,
                "value_mm": value_mm});
            let mut reading: Reading = serde_json::from_value(reading).unwrap();
            reading.position = [(Axis::X, 1.0 + 13.05), (Axis::Z, 112.0), (Axis::C, std::f64::consts::FRAC_PI_2)]
                .into_iter()
                .collect();
            last_deviation_mm(&RunProgress {
                plan: serde_json::from_value(plan.clone()).unwrap(),
                stages: Vec::new(),
                stored_steps_and_repeats: Vec::new(),
                last_reading: Some(reading),
            })
        };
        assert!((deviation(None).unwrap() - 0.05).abs() < 1e-12, "{:?}", deviation(None));
        assert_eq!(deviation(Some(1.0)), None);
    }
}
