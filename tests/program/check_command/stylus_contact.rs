//! Check of a machine whose stylus is still in contact after a guarded move.

use std::sync::{Arc, Mutex};

use machine::record::question::{AxisDirection, OperatorAnswer, OperatorQuestion};
use machine::{Axis, Position};
use simulator::{SimulatedOperator, SimulatedWorld, Speed};
use trued::commissioning::{
    AnswerFuture, CheckFinding, CheckPart, CheckStop, CheckSummary, CheckVerdict, MachineCheck, NoOperator,
    OperatorInterface,
};
use trued::setup::{self, MachineFile, ReopenableMachine, SimulationPace};
use trued::store::Journal;

use super::simulated_machine_checks::{
    changed_machine_toml, check_with_operator, failure_lines, runtime, toml_with_control_keys,
};
use crate::support::recording_control::{self, RecordingControl, WireRecord};

/// Z at contact with the top of the part: its height, the radius of the ball and the length of the tool, mm. All
/// are stated in `config/simulated.toml`; no planted error moves the top.
const CONTACT_Z_MM: f64 = 100.0 + 3.0 + 120.0;

type AnswerFn = dyn FnMut(&OperatorQuestion, &SimulatedOperator) -> Option<OperatorAnswer>;

/// Answers with `answer`; where it returns `None`, the simulated operator answers.
struct ScriptedOperator {
    simulated_operator: SimulatedOperator,
    answer: Box<AnswerFn>,
}

impl OperatorInterface for ScriptedOperator {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        let answer = (self.answer)(question, &self.simulated_operator);
        let answer = answer.unwrap_or_else(|| self.simulated_operator.answer(question));
        Box::pin(std::future::ready(answer))
    }
}

/// World after a guarded move onto the top of the part that ended by contact, and a further `deeper_mm`.
fn world_in_contact(file: &MachineFile, deeper_mm: f64) -> SimulatedWorld {
    let mut world = setup::build_world(file).unwrap();
    let down = Position::new().with(Axis::Z, CONTACT_Z_MM - 20.0);
    assert!(world.probe(&down, 3000.0, 0).contact.is_some());
    let rest = world.displayed_position().get_or_zero(Axis::Z) - deeper_mm;
    world.travel(&Position::new().with(Axis::Z, rest), Speed::Feed { mm_min: 60.0 });
    assert!(world.is_probe_closed());
    world
}

/// Result of a check with a control that records its lines, and the machine position before the check.
struct RecordedCheck {
    summary: CheckSummary,
    record: WireRecord,
    z_before_check_mm: f64,
    world: Arc<Mutex<SimulatedWorld>>,
}

/// Checks a machine whose stylus is in contact; `keys` are inserted before `[artefact]`.
fn run_recorded_check(
    deeper_mm: f64,
    keys: &str,
    person: impl FnOnce(SimulatedOperator, CheckStop) -> Box<dyn OperatorInterface>,
) -> RecordedCheck {
    let file = |address: &str| {
        let text = recording_control::machine_with_control(address)
            .replacen("kind = \"grbl\"", "kind = \"grbl\"\ndialect = \"grbl-m19\"", 1)
            .replacen("[artefact]", &format!("{keys}[artefact]"), 1);
        MachineFile::parse("machine.toml", text).unwrap()
    };
    let world = world_in_contact(&file("127.0.0.1:1"), deeper_mm);
    let z_before = world.displayed_position().get_or_zero(Axis::Z);
    let world = Arc::new(Mutex::new(world));
    let control = RecordingControl::start_with_world(world.clone());
    let file = file(&control.address());
    let stop = CheckStop::default();
    let mut person = person(SimulatedOperator::new(world.clone()), stop.clone());
    let summary = runtime().block_on(async {
        let site = ReopenableMachine::new(&file).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let journal = Journal::open(folder.path()).unwrap();
        let mut tell = |_: &CheckFinding| {};
        MachineCheck::new(&file, &site, SimulationPace::Immediate, &journal, person.as_mut(), stop, &mut tell)
            .run_all_parts()
            .await
    });
    RecordedCheck { summary, record: control.stop_and_take_record(), z_before_check_mm: z_before, world }
}

fn scripted_operator(
    answer: impl FnMut(&OperatorQuestion, &SimulatedOperator) -> Option<OperatorAnswer> + 'static,
) -> impl FnOnce(SimulatedOperator, CheckStop) -> Box<dyn OperatorInterface> {
    |simulated_operator, _| Box::new(ScriptedOperator { simulated_operator, answer: Box::new(answer) })
}

/// The first line that moves an axis.
fn first_motion_line(record: &WireRecord) -> Option<String> {
    let moves = |line: &String| {
        let mut words = line.split_whitespace();
        words.any(|word| matches!(word, "G0" | "G1" | "G2" | "G3") || word.starts_with("G38"))
    };
    record.received_lines().into_iter().find(moves)
}

fn assert_nothing_moved(checked: &RecordedCheck) {
    assert_eq!(first_motion_line(&checked.record), None, "{}", checked.summary);
    let z = checked.world.lock().unwrap().displayed_position().get_or_zero(Axis::Z);
    assert_eq!(z, checked.z_before_check_mm, "{}", checked.summary);
}

/// Asserts that only the retract moved the machine.
fn assert_check_ended_after_retract(summary: &CheckSummary) {
    assert_eq!(summary.finding_count(CheckVerdict::Failed), 1, "{summary}");
    let failed = failure_lines(summary);
    assert!(failed.contains("the stylus is out of contact and the probe reads open"), "{summary}");
    assert!(failed.contains("jog the machine clear at the control"), "{summary}");
    let axes = |finding: &&CheckFinding| finding.part == CheckPart::Axes && finding.verdict == CheckVerdict::Ok;
    assert_eq!(summary.findings.iter().filter(axes).count(), 0, "{summary}");
}

pub fn stylus_in_contact_is_retracted_in_steps_and_the_check_ends() {
    // Braking from 50 mm/s at 2000 mm/s² adds 0.6 mm: three steps.
    let checked = run_recorded_check(2.0, "", scripted_operator(|_, _| None));
    assert_check_ended_after_retract(&checked.summary);
    let lines = checked.record.received_lines();
    let steps: Vec<&String> = lines.iter().filter(|line| line.contains(" G1 Z")).take(3).collect();
    let number = |line: &str, letter: char| -> f64 {
        let mut words = line.split_whitespace();
        words.find_map(|word| word.strip_prefix(letter)).unwrap().parse().unwrap()
    };
    for (step, by) in steps.iter().zip([1.0, 2.0, 3.0]) {
        assert!((number(step, 'Z') - checked.z_before_check_mm - by).abs() < 1e-3, "{lines:#?}");
        assert_eq!(number(step, 'F'), 60.0, "{lines:#?}");
    }
    assert_eq!(first_motion_line(&checked.record).as_ref(), steps.first().copied(), "{lines:#?}");
    let last = lines.iter().rfind(|line| line.contains(" G1 ") || line.contains("G38"));
    assert_eq!(last, steps.last().copied(), "{lines:#?}");
}

/// Tests each simulated control. A resident program ends in an alarm if one step does not free the stylus, so its
/// deflection is smaller.
pub fn stylus_in_contact_is_retracted_with_each_control_protocol() {
    for (keys, pressed) in
        [("wire = \"memory\"", 1.5), ("speaks = \"modbus\"\nwire = \"tcp\"", 1.5), ("speaks = \"modbus-program\"", 0.5)]
    {
        let text = toml_with_control_keys(keys, &changed_machine_toml(&[]));
        let file = MachineFile::parse("machine.toml", text).unwrap();
        let summary = runtime().block_on(async {
            let site = ReopenableMachine::new(&file).unwrap();
            let simulated_operator = site.simulated_operator().unwrap();
            simulated_operator.move_axis_by_hand(Axis::Z, CONTACT_Z_MM - pressed - 450.0);
            let mut person = ScriptedOperator { simulated_operator, answer: Box::new(|_, _| None) };
            check_with_operator(&file, &site, &mut person).await
        });
        assert_check_ended_after_retract(&summary);
    }
}

pub fn nothing_moves_if_the_operator_refuses_the_retract() {
    let asked = Arc::new(Mutex::new(0));
    let count = asked.clone();
    let answer = move |question: &OperatorQuestion, _: &SimulatedOperator| match question {
        OperatorQuestion::RetractDirection { .. } => {
            *count.lock().unwrap() += 1;
            Some(OperatorAnswer::No)
        }
        OperatorQuestion::StylusState(_) => Some(OperatorAnswer::No),
        _ => None,
    };
    let checked = run_recorded_check(0.0, "", scripted_operator(answer));
    assert_eq!(*asked.lock().unwrap(), 1, "{}", checked.summary);
    assert_nothing_moved(&checked);
    assert!(failure_lines(&checked.summary).contains("the probe reads closed"), "{}", checked.summary);
    assert_eq!(checked.summary.finding_count(CheckVerdict::Failed), 1, "{}", checked.summary);
}

pub fn without_a_person_a_stylus_stays_in_contact_and_the_remedy_is_named() {
    let checked = run_recorded_check(0.0, "", |_, _| Box::new(NoOperator));
    assert_nothing_moved(&checked);
    let failed = failure_lines(&checked.summary);
    assert!(failed.contains("the probe reads closed"), "{}", checked.summary);
    assert!(failed.contains("run `trued check` on a terminal"), "{}", checked.summary);
}

pub fn stop_at_the_retract_direction_question_moves_nothing() {
    let checked = run_recorded_check(0.0, "", |simulated_operator, stop| {
        let answer = move |question: &OperatorQuestion, _: &SimulatedOperator| {
            if matches!(question, OperatorQuestion::RetractDirection { .. }) {
                stop.halt_handle().trigger();
            }
            None
        };
        Box::new(ScriptedOperator { simulated_operator, answer: Box::new(answer) })
    });
    assert_nothing_moved(&checked);
    assert!(checked.summary.stopped && !checked.summary.held, "{}", checked.summary);
}

/// The next question for a direction includes the refusal of the first one.
pub fn a_retract_towards_a_declared_body_is_refused_and_asked_for_again() {
    let results = Arc::new(Mutex::new(Vec::new()));
    let kept = results.clone();
    let answer = move |question: &OperatorQuestion, _: &SimulatedOperator| {
        let OperatorQuestion::RetractDirection { last_result, .. } = question else {
            return matches!(question, OperatorQuestion::StylusState(_)).then_some(OperatorAnswer::No);
        };
        let mut kept = kept.lock().unwrap();
        kept.push(last_result.clone());
        let towards = AxisDirection { axis: Axis::X, is_positive: true };
        Some(if kept.len() == 1 { OperatorAnswer::Retract(towards) } else { OperatorAnswer::No })
    };
    // The gap to the ball is 2.5 mm.
    let post = "[[keepout]]\nname = \"post\"\nmin_mm = [5.5, -5.0, 101.0]\nmax_mm = [9.0, 5.0, 110.0]\n";
    let checked = run_recorded_check(0.0, post, scripted_operator(answer));
    assert_nothing_moved(&checked);
    let results = results.lock().unwrap();
    let [None, Some(refused)] = results.as_slice() else { panic!("{results:?}") };
    assert!(refused.starts_with("X+: no motion: the collision check refuses the jog"), "{refused}");
    assert!(refused.contains("stylus ball would come within"), "{refused}");
    let probe = |finding: &&CheckFinding| finding.part == CheckPart::Probe;
    assert_eq!(checked.summary.findings.iter().filter(probe).count(), 1, "{}", checked.summary);
}
