//! The stages of a run, with readings of a machine that differs from the nominal one.

use nalgebra::Vector3;

use crate::ball_measurement::{MeasurementPurpose, SearchMode, TouchLabel};
use crate::samba::design::tests::{rumba_balls, rumba_plan};
use crate::samba::settings::SambaSettings;
use crate::samba::{Method, MethodRefusal, NextStage, ObjectPositionSource, RegisteredMethod, Samba};
use machine::kinematics::{ErrorTerm, KinematicChain};
use machine::record::artefact::Artefact;
use machine::record::plan::{Plan, Stage, Step, StepKind};
use machine::record::reading::Reading;
use machine::{Axis, Position, frame::Point};

type DirtThickness = Box<dyn Fn(&TouchLabel, u32) -> f64>;

/// A machine with errors, and balls that are displaced from their stated positions.
struct SimulatedMachine {
    chain: KinematicChain,
    errors: Vec<ErrorTerm>,
    ball_shift_mm: Vector3<f64>,
    /// Dirt: length added to the contact of one touch, mm.
    dirt: DirtThickness,
}

impl SimulatedMachine {
    fn new(plan: &Plan) -> Self {
        let term = |name: &str, value| ErrorTerm { parameter: name.parse().unwrap(), value };
        Self {
            chain: KinematicChain::new(&plan.machine).unwrap(),
            errors: vec![term("EX0C", -0.105), term("EY0S", 0.02), term("EA0C", -11e-6)],
            ball_shift_mm: Vector3::new(0.3, -0.4, 0.2),
            dirt: Box::new(|_, _| 0.0),
        }
    }

    /// Contact of the stylus with the ball, by bisection.
    fn simulate_touch(&self, plan: &Plan, step: &Step, repeat: u32) -> Reading {
        let Artefact::Balls(balls) = &plan.artefact else { panic!() };
        let label: TouchLabel = step.label.parse().unwrap();
        let ball = balls.balls.iter().find(|ball| ball.id == label.ball).unwrap();
        let centre = Vector3::from(ball.centre_mm) + self.ball_shift_mm;
        let reach = ball.radius_mm + plan.probe.ball_radius_mm + (self.dirt)(&label, repeat);
        let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
        let at = |share: f64| -> Position {
            let part =
                |axis| step.from.get_or_zero(axis) + share * (step.to.get_or_zero(axis) - step.from.get_or_zero(axis));
            step.from.updated_by(&Axis::LINEAR.into_iter().map(|a| (a, part(a))).collect())
        };
        let gap =
            |share: f64| self.chain.tip_in_table(&at(share), tip, &self.errors).mm.metric_distance(&centre) - reach;
        assert!(gap(0.0) > 0.0 && gap(1.0) < 0.0, "{} misses", step.label);
        let (mut out, mut inside) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = (out + inside) / 2.0;
            if gap(middle) > 0.0 { out = middle } else { inside = middle }
        }
        Reading {
            step: step.id,
            repeat,
            position: at(out),
            value_mm: None,
            sensor: "probe".into(),
            t_s: 0.0,
            flag: Default::default(),
            temperatures_c: Default::default(),
        }
    }
}

type PlayedRun = (Plan, Vec<Stage>, Vec<Reading>);

/// Plays all stages, as in a run.
fn play_run(settings: &SambaSettings, shop: &SimulatedMachine) -> Result<PlayedRun, MethodRefusal> {
    let mut played = (rumba_plan(settings), Vec::new(), Vec::new());
    continue_run(settings, shop, &mut played).map(|()| played)
}

fn continue_run(
    settings: &SambaSettings,
    shop: &SimulatedMachine,
    played: &mut PlayedRun,
) -> Result<(), MethodRefusal> {
    let (plan, done, readings) = played;
    let samba = Samba::new(settings.clone());
    while let NextStage::Stage { stage, new_steps } =
        samba.next_stage(plan, done, ObjectPositionSource::Measured(readings))?
    {
        plan.steps.extend(new_steps);
        for id in &stage.steps {
            let step = plan.steps.iter().find(|step| step.id == *id).unwrap();
            let mut reading = shop.simulate_touch(plan, step, stage.repeat);
            reading.t_s = readings.len() as f64;
            readings.push(reading);
        }
        done.push(stage);
    }
    Ok(())
}

fn small_design_settings() -> SambaSettings {
    SambaSettings { max_ball_measurements: 30, indexations: 10, ..SambaSettings::default() }
}

#[test]
fn stages_search_and_measure_each_ball_and_repeat_the_references() {
    let settings = small_design_settings();
    let shop = SimulatedMachine::new(&rumba_plan(&settings));
    let (played, done, _) = play_run(&settings, &shop).unwrap();
    assert!(done.iter().all(|stage| stage.repeat == 0));
    // Every ball is searched for first, and measured at three or more indexations.
    let labels: Vec<TouchLabel> = played.steps.iter().map(|step| step.label.parse().unwrap()).collect();
    for ball in rumba_balls().balls {
        let of = |pass: MeasurementPurpose| {
            let mine = labels.iter().filter(move |l| l.purpose == pass && l.touch == "pole");
            mine.filter(|l| l.ball == ball.id).count()
        };
        assert!(of(MeasurementPurpose::Slow) >= 3 && of(MeasurementPurpose::Find) >= 3, "ball {}", ball.id);
    }
    let slow = labels.iter().filter(|l| l.purpose == MeasurementPurpose::Slow).count();
    assert_eq!(slow, 5 * 30);
    // Once all balls are found, proofs use their found positions.
    let last = done.last().unwrap().found.clone().unwrap();
    let Artefact::Balls(found) = last else { panic!() };
    let stated = rumba_balls();
    for (found, stated) in found.balls.iter().zip(&stated.balls) {
        let true_centre = Vector3::from(stated.centre_mm) + shop.ball_shift_mm;
        let off = Vector3::from(found.centre_mm).metric_distance(&true_centre);
        assert!(off < 0.25, "ball {} is taken for {off} mm off", found.id);
    }
    // The references are measured in three rounds at the same places.
    let kind = |step: &&Step| step.kind == StepKind::Reference;
    let references: Vec<&Step> = played.steps.iter().filter(kind).collect();
    assert_eq!(references.len(), 15);
    for (first, later) in references.iter().zip(&references[5..]) {
        assert_eq!((&first.from, &first.to), (&later.from, &later.to));
    }
}

#[test]
fn without_readings_the_plan_has_the_same_stages() {
    let settings = small_design_settings();
    let (mut printed, samba) = (rumba_plan(&settings), Samba::new(settings.clone()));
    let mut done = Vec::new();
    while let NextStage::Stage { stage, new_steps } =
        samba.next_stage(&printed, &done, ObjectPositionSource::Nominal).unwrap()
    {
        printed.steps.extend(new_steps);
        done.push(stage);
    }
    let shop = SimulatedMachine::new(&printed);
    let (played, played_stages, _) = play_run(&settings, &shop).unwrap();
    let outline = |stages: &[Stage]| -> Vec<(u32, String, Vec<u32>, bool)> {
        let one = |s: &Stage| (s.id, s.name.clone(), s.steps.clone(), s.found.is_some());
        stages.iter().map(one).collect()
    };
    assert_eq!(outline(&done), outline(&played_stages));
    let labels = |plan: &Plan| plan.steps.iter().map(|s| s.label.clone()).collect::<Vec<_>>();
    assert_eq!(labels(&printed), labels(&played));
    assert!(printed.steps.iter().enumerate().all(|(index, step)| step.id == index as u32));
}

#[test]
fn find_once_searches_each_ball_once() {
    let settings = SambaSettings { ball_search_mode: SearchMode::Once, ..small_design_settings() };
    let shop = SimulatedMachine::new(&rumba_plan(&settings));
    let (played, _, _) = play_run(&settings, &shop).unwrap();
    let finds = played.steps.iter().filter(|step| step.label.starts_with("find/")).count();
    assert_eq!(finds, 5 * 6);
}

/// Dirt on one touch: the ball is measured again, then the run is held.
#[test]
fn dirty_measurement_is_repeated_once_and_then_holds_the_run() {
    let settings = small_design_settings();
    let mut shop = SimulatedMachine::new(&rumba_plan(&settings));
    let dirty =
        |label: &TouchLabel| label.purpose == MeasurementPurpose::Slow && label.ball == "3" && label.touch == "-45";
    shop.dirt = Box::new(move |label, repeat| if dirty(label) && repeat == 0 { 0.06 } else { 0.0 });
    let (played, done, readings) = play_run(&settings, &shop).unwrap();
    let again: Vec<&Stage> = done.iter().filter(|stage| stage.repeat == 1).collect();
    assert!(again.len() >= 3, "{} stages once more", again.len());
    for stage in again {
        assert_eq!(stage.steps.len(), 5);
        let step = &played.steps[stage.steps[0] as usize];
        assert!(step.label.contains("/3/"), "{}", step.label);
    }
    assert_eq!(readings.iter().filter(|reading| reading.repeat == 1).count() % 5, 0);
    shop.dirt = Box::new(move |label, _| if dirty(label) { 0.06 } else { 0.0 });
    let refused = play_run(&settings, &shop).unwrap_err();
    assert!(refused.reason.contains("a loose ball or a wrong stylus"), "{}", refused.reason);
    assert!(refused.reason.contains("ball 3 at B"), "{}", refused.reason);
    assert!(refused.remedy.contains("resume the run, which measures the ball again"));
}

#[test]
fn larger_ball_is_refused_with_both_diameters() {
    let settings = small_design_settings();
    let mut shop = SimulatedMachine::new(&rumba_plan(&settings));
    shop.dirt = Box::new(|_, _| 0.05);
    let refused = play_run(&settings, &shop).unwrap_err();
    assert!(refused.reason.contains("diameter 19.150 mm differs from the expected 19.050 mm"), "{}", refused.reason);
}

#[test]
fn ball_far_from_its_stated_position_is_refused() {
    let settings = small_design_settings();
    let mut shop = SimulatedMachine::new(&rumba_plan(&settings));
    shop.ball_shift_mm = Vector3::new(0.8, 0.8, 0.0);
    let refused = play_run(&settings, &shop).unwrap_err();
    for word in ["ball ", "from the position in [artefact]", "uncertainty_mm = 1"] {
        assert!(refused.reason.contains(word), "{}", refused.reason);
    }
    // No reference has been measured yet.
    assert!(refused.remedy.ends_with("then start a new run"), "{}", refused.remedy);
}

/// The run holds if the search finds a ball that was moved; it continues once the ball is put back and the
/// run is resumed.
#[test]
fn moved_ball_holds_the_run_and_is_searched_again_on_resume() {
    let settings = small_design_settings();
    let mut shop = SimulatedMachine::new(&rumba_plan(&settings));
    shop.dirt = Box::new(|label, _| match (label.purpose, label.ball.as_str(), label.touch.as_str()) {
        (MeasurementPurpose::Find, "3", "+45") if label.indexation_index > 5 => 0.8,
        (MeasurementPurpose::Find, "3", "-135") if label.indexation_index > 5 => -0.8,
        _ => 0.0,
    });
    let mut played = (rumba_plan(&settings), Vec::new(), Vec::new());
    let refused = continue_run(&settings, &shop, &mut played).unwrap_err();
    assert!(refused.reason.contains("the ball has moved"), "{}", refused.reason);
    assert!(refused.remedy.contains("resume the run, which measures the ball again"));
    // The run does not continue unless the operator resumes it.
    assert!(continue_run(&settings, &shop, &mut played).is_err());
    played.0.interruption_times_s.push(played.2.last().unwrap().t_s);
    shop.dirt = Box::new(|_, _| 0.0);
    continue_run(&settings, &shop, &mut played).unwrap();
    let again: Vec<&Stage> = played.1.iter().filter(|stage| stage.repeat == 1).collect();
    assert_eq!(again.len(), 1);
    let label = |id: &u32| played.0.steps[*id as usize].label.parse::<TouchLabel>().unwrap();
    assert!(again[0].steps.iter().map(label).all(|l| l.ball == "3" && l.purpose == MeasurementPurpose::Find));
}
