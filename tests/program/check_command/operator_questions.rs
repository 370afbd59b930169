//! Questions of a check to the operator, and its behaviour without an operator.

use machine::Axis;
use machine::record::question::{Jog, ObservedMotion, OperatorAnswer, OperatorQuestion, StylusState};
use simulator::SimulatedOperator;
use trued::commissioning::{
    AnswerFuture, CheckFinding, CheckPart, CheckStop, CheckSummary, CheckVerdict, MachineCheck, NoOperator,
    OperatorInterface,
};
use trued::setup::{MachineFile, ReopenableMachine, SimulationPace};
use trued::store::Journal;

use super::simulated_machine_checks::{changed_machine_toml, check_with_operator, failure_lines, runtime};
use crate::support::recording_control::{self, RecordingControl};

fn machine_file() -> MachineFile {
    MachineFile::parse("machine.toml", changed_machine_toml(&[])).unwrap()
}

pub fn without_operator_probe_axes_and_hold_are_unchecked() {
    let file = machine_file();
    let summary = runtime().block_on(async {
        let site = ReopenableMachine::new(&file).unwrap();
        check_with_operator(&file, &site, &mut NoOperator).await
    });
    assert_eq!(summary.finding_count(CheckVerdict::Failed), 0, "{summary}");
    for part in [CheckPart::Probe, CheckPart::Axes, CheckPart::Hold] {
        let open = |finding: &&trued::commissioning::CheckFinding| {
            finding.part == part && finding.verdict == CheckVerdict::NotChecked
        };
        assert!(summary.findings.iter().any(|finding| open(&finding)), "{part:?}\n{summary}");
    }
}

/// Refuses every motion; keeps the questions.
struct MotionRefusingOperator {
    simulated_operator: SimulatedOperator,
    questions: Vec<OperatorQuestion>,
}

impl OperatorInterface for MotionRefusingOperator {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        self.questions.push(question.clone());
        let answer = match question {
            OperatorQuestion::AllowJog { .. }
            | OperatorQuestion::AllowJogWithHold(_)
            | OperatorQuestion::AllowAction { .. } => OperatorAnswer::No,
            other => self.simulated_operator.answer(other),
        };
        Box::pin(std::future::ready(answer))
    }
}

pub fn a_refusal_by_the_operator_prevents_motion() {
    let file = machine_file();
    let (summary, asked) = runtime().block_on(async {
        let site = ReopenableMachine::new(&file).unwrap();
        let mut person =
            MotionRefusingOperator { simulated_operator: site.simulated_operator().unwrap(), questions: Vec::new() };
        let summary = check_with_operator(&file, &site, &mut person).await;
        (summary, person.questions)
    });
    assert!(!asked.iter().any(|question| matches!(question, OperatorQuestion::ObservedJog { .. })), "{asked:?}");
    let may = asked.iter().filter(|question| matches!(question, OperatorQuestion::AllowJog { .. }));
    assert_eq!(may.count(), 5, "each axis is asked for");
    assert_eq!(summary.finding_count(CheckVerdict::Failed), 0, "{summary}");
}

/// Agrees to everything, except where the exception gives another answer.
struct OperatorWithException<'a> {
    simulated_operator: &'a mut SimulatedOperator,
    exception_answer: fn(&OperatorQuestion) -> Option<OperatorAnswer>,
    motion_question_count: usize,
}

impl OperatorInterface for OperatorWithException<'_> {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        let may = matches!(
            question,
            OperatorQuestion::AllowJog { .. }
                | OperatorQuestion::AllowJogWithHold(_)
                | OperatorQuestion::AllowAction { .. }
        );
        self.motion_question_count += usize::from(may);
        let answer = (self.exception_answer)(question).unwrap_or_else(|| self.simulated_operator.answer(question));
        Box::pin(std::future::ready(answer))
    }
}

/// Summary, number of questions for permission to move, and the simulated operator.
fn check_with_exception(
    exception: fn(&OperatorQuestion) -> Option<OperatorAnswer>,
) -> (CheckSummary, usize, SimulatedOperator) {
    let file = machine_file();
    runtime().block_on(async {
        let site = ReopenableMachine::new(&file).unwrap();
        let mut simulated_operator = site.simulated_operator().unwrap();
        let mut person = OperatorWithException {
            simulated_operator: &mut simulated_operator,
            exception_answer: exception,
            motion_question_count: 0,
        };
        let summary = check_with_operator(&file, &site, &mut person).await;
        let moves = person.motion_question_count;
        (summary, moves, simulated_operator)
    })
}

pub fn no_motion_is_requested_before_the_probe_was_deflected() {
    let but = |question: &OperatorQuestion| {
        matches!(question, OperatorQuestion::StylusState(StylusState::Deflected)).then_some(OperatorAnswer::No)
    };
    let (summary, moves, _) = check_with_exception(but);
    assert_eq!(moves, 0, "{summary}");
    assert_eq!(summary.finding_count(CheckVerdict::NotChecked), 4, "{summary}");
}

/// A sensor may still be mounted in place of the probe.
pub fn laser_machine_check_asks_whether_the_probe_is_mounted() {
    let file = MachineFile::parse("laser.toml", include_str!("../../../config/laser.toml").to_owned());
    let file = file.unwrap();
    let checked = |answer: Option<OperatorAnswer>| {
        runtime().block_on(async {
            let site = ReopenableMachine::new(&file).unwrap();
            let mut asked = ProbeMountingOperator {
                simulated_operator: site.simulated_operator().unwrap(),
                mounted_answer: answer,
                mounted_question_count: 0,
            };
            let summary = check_with_operator(&file, &site, &mut asked).await;
            assert_eq!(
                (asked.mounted_question_count, summary.finding_count(CheckVerdict::Failed)),
                (1, 0),
                "{summary}"
            );
            summary.to_string()
        })
    };
    let told = checked(Some(OperatorAnswer::No));
    assert!(told.contains("whether the input closes is unknown: the touch probe is not in the spindle"), "{told}");
    let told = checked(None);
    assert!(told.contains("open at rest, closed while the stylus is deflected, then open again"), "{told}");
}

/// Gives this answer to the question whether the probe is in the spindle; without an answer, that of the simulated
/// operator.
struct ProbeMountingOperator {
    simulated_operator: SimulatedOperator,
    mounted_answer: Option<OperatorAnswer>,
    mounted_question_count: usize,
}

impl OperatorInterface for ProbeMountingOperator {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        let mounted = matches!(question, OperatorQuestion::StylusState(StylusState::Mounted));
        self.mounted_question_count += usize::from(mounted);
        let told = self.mounted_answer.filter(|_| mounted);
        let answer = told.unwrap_or_else(|| self.simulated_operator.answer(question));
        Box::pin(std::future::ready(answer))
    }
}

pub fn axis_is_not_moved_back_after_the_operator_leaves() {
    let but = |question: &OperatorQuestion| {
        matches!(question, OperatorQuestion::ObservedJog { .. }).then_some(OperatorAnswer::NoOperator)
    };
    let (summary, moves, mut simulated_operator) = check_with_exception(but);
    assert_eq!(moves, 1, "{summary}");
    assert!(summary.to_string().contains("the axis was not moved back"), "{summary}");
    let jog = Jog { axis: Axis::X, by: 1.0, feed_per_min: 60.0 };
    let stands = simulated_operator.answer(&OperatorQuestion::ObservedJog { jog, visible_motion: String::new() });
    assert_eq!(stands, OperatorAnswer::Motion(ObservedMotion::AsAnnounced), "it is where it was left");
}

/// Ends the check when it requests the deflection of the stylus.
struct StoppingOperator(CheckStop);

impl OperatorInterface for StoppingOperator {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        if let OperatorQuestion::StylusState(_) = question {
            self.0.halt_handle().trigger();
        }
        Box::pin(std::future::ready(OperatorAnswer::Yes))
    }
}

pub fn a_stop_at_rest_leaves_no_hold() {
    let control = RecordingControl::start();
    let text = recording_control::machine_with_control(&control.address());
    let file = MachineFile::parse("machine.toml", text).unwrap();
    let summary = runtime().block_on(async {
        let site = ReopenableMachine::new(&file).unwrap();
        let (folder, stop) = (tempfile::tempdir().unwrap(), CheckStop::default());
        let journal = Journal::open(folder.path()).unwrap();
        let (mut person, mut tell) = (StoppingOperator(stop.clone()), |_: &CheckFinding| {});
        MachineCheck::new(&file, &site, SimulationPace::Immediate, &journal, &mut person, stop, &mut tell)
            .run_all_parts()
            .await
    });
    assert!(summary.stopped && summary.finding_count(CheckVerdict::Failed) == 0, "{summary}");
    assert!(!summary.to_string().contains("held"), "{summary}");
    let sent = control.stop_and_take_record().received_lines().concat();
    assert!(sent.contains("$I") && !sent.contains('!'), "{sent}");
}

/// Moves another axis by hand before the jog is allowed.
struct HandMovingOperator(SimulatedOperator);

impl OperatorInterface for HandMovingOperator {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        let Self(simulated_operator) = self;
        let answer = simulated_operator.answer(question);
        if let OperatorQuestion::AllowJog { .. } = question {
            simulated_operator.move_axis_by_hand(Axis::Y, 0.5);
        }
        Box::pin(std::future::ready(answer))
    }
}

pub fn a_machine_that_was_moved_by_hand_is_not_jogged() {
    let file = machine_file();
    runtime().block_on(async {
        let site = ReopenableMachine::new(&file).unwrap();
        let mut person = HandMovingOperator(site.simulated_operator().unwrap());
        let summary = check_with_operator(&file, &site, &mut person).await;
        let told = "X +1 mm: the machine was moved by hand: Y is at 0.500, not at 0.000";
        assert!(failure_lines(&summary).contains(told), "{summary}");
        assert_eq!(summary.finding_count(CheckVerdict::Failed), 1, "nothing after it: {summary}");
        let jog = Jog { axis: Axis::X, by: 1.0, feed_per_min: 60.0 };
        let moved = person.0.answer(&OperatorQuestion::ObservedJog { jog, visible_motion: String::new() });
        assert_eq!(
            moved,
            OperatorAnswer::Motion(ObservedMotion::OtherAxis(Axis::Y)),
            "what the hand moved, and no more"
        );
    });
}
