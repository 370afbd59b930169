//! A program that measures balls on stems, and modifications that do not exist for a round part.

use machine::record::artefact::{Artefact, Balls};
use machine::record::plan::{Plan, Stage, Step, StepKind};
use machine::{Axis, Position};
use planning::{BallMeasurementRequest, BallTouchMode, TouchAccess};
use trued::setup::{MachineFile, configure_method_and_plan_without_steps};

use super::program_sabotages::{LineRange, ProgramLines, Sabotage, change_word_values};
use super::rendered_plan::{RenderedPlan, StepLines};

pub const SAMBA_MACHINE_TOML: &str = include_str!("../../../config/samba.toml");
/// B, C, S in degrees.
const INDEXATION_ANGLES_BCS_DEG: [[f64; 3]; 6] = [
    [0.0, 0.0, 0.0],
    [30.0, 90.0, 90.0],
    [-30.0, 180.0, 180.0],
    [60.0, 270.0, 270.0],
    [-90.0, 0.0, 0.0],
    [90.0, 90.0, 90.0],
];
/// Uncertainty of the ball positions in the slow touches, mm.
const FOUND_BALL_UNCERTAINTY_MM: f64 = 0.25;

/// Two stages at each indexation: every accessible ball is searched for, then measured.
pub fn render_dome(dialect: &str) -> RenderedPlan {
    let file = MachineFile::parse("samba.toml", SAMBA_MACHINE_TOML.to_owned()).unwrap();
    let (_, mut plan) = configure_method_and_plan_without_steps(&file, "samba", None).unwrap();
    let Artefact::Balls(balls) = plan.artefact.clone() else { panic!("balls") };
    let found = Artefact::Balls(Balls { uncertainty_mm: FOUND_BALL_UNCERTAINTY_MM, ..balls.clone() });
    let search = BallTouchMode::Search { uncertainty_mm: balls.uncertainty_mm, standoff_mm: 0.5 };
    let slow = BallTouchMode::Measure { standoff_mm: 0.5, search_mm: 1.0 };
    let mut stages = Vec::new();
    for degrees in INDEXATION_ANGLES_BCS_DEG {
        let axes = [Axis::B, Axis::C, Axis::S].into_iter().zip(degrees);
        let rotary: Position = axes.map(|(axis, at)| (axis, axis.to_mm_or_rad(at))).collect();
        add_ball_stage(&mut plan, &mut stages, &balls, &rotary, (search, None));
        add_ball_stage(&mut plan, &mut stages, &balls, &rotary, (slow, Some(found.clone())));
    }
    assert!(plan.steps.len() > 200, "{}", plan.steps.len());
    RenderedPlan::from_plan(plan, stages, dialect)
}

fn add_ball_stage(
    plan: &mut Plan,
    stages: &mut Vec<Stage>,
    balls: &Balls,
    rotary: &Position,
    (mode, found): (BallTouchMode, Option<Artefact>),
) {
    let access = TouchAccess::new(plan, found.as_ref().unwrap_or(&plan.artefact)).unwrap();
    let (first, stage) = (plan.steps.len(), stages.len() as u32);
    for ball in &balls.balls {
        let request = BallMeasurementRequest { ball, rotary, touch_mode: mode, touch_count: 5 };
        let label = |touch: &str| format!("t/{stage:03}/{}/{touch}", ball.id);
        let steps = access.touch_steps(&request, &plan.probe, StepKind::Touch, label);
        let steps = plan.number_steps(stage, steps.unwrap_or_default());
        plan.steps.extend(steps);
    }
    let steps = (first..plan.steps.len()).map(|id| id as u32).collect();
    stages.push(Stage { id: stage, name: format!("stage {stage}"), repeat: 0, steps, found });
}

pub const BALL_SABOTAGES: [(&str, Sabotage); 6] = [
    ("another ball's touch", replace_with_step_of_another_ball),
    ("straight through the ball", |p, l, id| {
        let (_, opposite) = facing_start_positions(p, id)?;
        Some(insert_moves_after_back_off(p, l, id, &[opposite]))
    }),
    ("across under the ball, through its stem", |p, l, id| {
        let (here, opposite) = facing_start_positions(p, id)?;
        let upright = find_step(p, id)?.from.get_or_zero(Axis::B) == 0.0;
        let out = |from: [f64; 3], to: [f64; 3], by: f64, z: f64| {
            let way = (to[0] - from[0]).hypot(to[1] - from[1]);
            let along = |k: usize| from[k] + by * (to[k] - from[k]) / way;
            [along(0), along(1), from[2] + z]
        };
        let beside = out(here, opposite, -8.0, 0.0);
        let below = out(here, opposite, -8.0, -15.0);
        let behind = out(opposite, here, -8.0, -15.0);
        upright.then(|| insert_moves_after_back_off(p, l, id, &[beside, below, behind]))
    }),
    ("no lift on the way to the next ball", |p, l, id| {
        let next = find_step(p, id + 5)?;
        let same = ball_id_of_step(next) != ball_id_of_step(find_step(p, id)?) && next.stage == find_step(p, id)?.stage;
        let inside = [Axis::X, Axis::Y, Axis::Z].map(|axis| next.to.get_or_zero(axis));
        same.then(|| insert_moves_after_back_off(p, l, id, &[inside]))
    }),
    ("S a quarter on", |p, l, id| {
        let StepLines { spindle_orientation_line: orient, touch_line: touch, .. } =
            lines_of_spindle_orientation_step(p, id)?;
        change_word_values(l, orient?, &['R'], |r| (r + 90.0) % 360.0).then_some((orient?, touch))
    }),
    ("S left out", |p, l, id| {
        let StepLines { spindle_orientation_line: orient, touch_line: touch, .. } =
            lines_of_spindle_orientation_step(p, id)?;
        l.remove(orient?);
        Some((orient? - 1, touch - 1))
    }),
];

/// The first step of the same indexation: there the spindle turns.
fn lines_of_spindle_orientation_step(p: &RenderedPlan, id: u32) -> Option<StepLines> {
    (0..=id).rev().map(|id| p.lines_of_step(id)).find(|place| place.spindle_orientation_line.is_some())
}

fn find_step(p: &RenderedPlan, id: u32) -> Option<&Step> {
    p.plan.steps.iter().find(|step| step.id == id)
}

fn ball_id_of_step(step: &Step) -> Option<&str> {
    step.label.split('/').nth(2)
}

/// All lines of the other ball's step, with the number of this step.
fn replace_with_step_of_another_ball(p: &RenderedPlan, l: &mut ProgramLines, id: u32) -> Option<LineRange> {
    let other = find_step(p, id + 5).filter(|other| other.stage == find_step(p, id).unwrap().stage)?;
    let differs = ball_id_of_step(other) != ball_id_of_step(find_step(p, id)?);
    let (own, theirs) = (p.lines_of_step(id), p.lines_of_step(id + 5));
    let renamed = |line: &String| line.replacen(&format!("N{} ", id + 5), &format!("N{id} "), 1);
    let lines: ProgramLines = l[theirs.first_line..=theirs.last_line].iter().map(renamed).collect();
    let count = lines.len();
    l.splice(own.first_line..=own.last_line, lines);
    differs.then_some((own.first_line, own.first_line + count - 1))
}

/// Start positions of two touches that face each other across the ball, at the same height: this step and the
/// second next.
fn facing_start_positions(p: &RenderedPlan, id: u32) -> Option<([f64; 3], [f64; 3])> {
    let (one, other) = (find_step(p, id)?, find_step(p, id + 2)?);
    let along = (0..3).map(|i| one.normal[i] * other.normal[i]).sum::<f64>();
    let level = one.normal[2].abs() < 1e-9;
    let place = |step: &Step| [Axis::X, Axis::Y, Axis::Z].map(|axis| step.from.get_or_zero(axis));
    let faces = ball_id_of_step(one) == ball_id_of_step(other) && level && along < -0.999;
    faces.then(|| (place(one), place(other)))
}

/// Inserts guarded moves through these positions after the back-off; one of them must be refused.
fn insert_moves_after_back_off(p: &RenderedPlan, l: &mut ProgramLines, id: u32, places: &[[f64; 3]]) -> LineRange {
    let at = p.lines_of_step(id).back_off_line + 1;
    for (k, [x, y, z]) in places.iter().enumerate() {
        l.insert(at + k, format!("N{id} G38.3 X{x:.4} Y{y:.4} Z{z:.4} F300"));
    }
    (at, at + places.len() - 1)
}
