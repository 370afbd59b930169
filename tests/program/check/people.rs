//! Questions of a check to the operator, and its behaviour without an operator.

use machine::Axis;
use machine::record::question::{Answer, Jog, Question, Seen, Stylus};
use simulator::SimulatedOperator;
use trued::commissioning::{
    Answering, Check, Finding, Nobody, Part, Person, Stop, Summary, Verdict,
};
use trued::setup::{MachineFile, Pace, Site};
use trued::store::Journal;

use super::bench::{failures, machine, runtime, through};
use crate::support::recording_control::{self, RecordingControl};

fn file() -> MachineFile {
    MachineFile::parse("machine.toml", machine(&[])).unwrap()
}

pub fn without_anybody_nothing_moves_and_it_says_what_it_cannot_look_at() {
    let file = file();
    let summary = runtime().block_on(async {
        let site = Site::new(&file).unwrap();
        through(&file, &site, &mut Nobody).await
    });
    assert_eq!(summary.count(Verdict::Failed), 0, "{summary}");
    for part in [Part::Probe, Part::Axes, Part::Hold] {
        let open = |finding: &&trued::commissioning::Finding| {
            finding.part == part && finding.verdict == Verdict::NotLookedAt
        };
        assert!(summary.findings.iter().any(|finding| open(&finding)), "{part:?}\n{summary}");
    }
}

/// Refuses every motion; keeps the questions.
struct Careful {
    bystander: SimulatedOperator,
    asked: Vec<Question>,
}

impl Person for Careful {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a> {
        self.asked.push(question.clone());
        let answer = match question {
            Question::MayJog { .. } | Question::MayHold(_) | Question::May { .. } => Answer::No,
            other => self.bystander.answer(other),
        };
        Box::pin(std::future::ready(answer))
    }
}

pub fn whoever_says_no_sees_nothing_move() {
    let file = file();
    let (summary, asked) = runtime().block_on(async {
        let site = Site::new(&file).unwrap();
        let mut person = Careful { bystander: site.bystander().unwrap(), asked: Vec::new() };
        let summary = through(&file, &site, &mut person).await;
        (summary, person.asked)
    });
    assert!(!asked.iter().any(|question| matches!(question, Question::Jogged { .. })), "{asked:?}");
    let may = asked.iter().filter(|question| matches!(question, Question::MayJog { .. }));
    assert_eq!(may.count(), 5, "each axis is asked for");
    assert_eq!(summary.count(Verdict::Failed), 0, "{summary}");
}

/// Agrees to everything, except where `but` gives another answer.
struct Otherwise<'a> {
    bystander: &'a mut SimulatedOperator,
    but: fn(&Question) -> Option<Answer>,
    moves: usize,
}

impl Person for Otherwise<'_> {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a> {
        let may = matches!(
            question,
            Question::MayJog { .. } | Question::MayHold(_) | Question::May { .. }
        );
        self.moves += usize::from(may);
        let answer = (self.but)(question).unwrap_or_else(|| self.bystander.answer(question));
        Box::pin(std::future::ready(answer))
    }
}

/// Summary, number of questions for permission to move, and the simulated operator.
fn otherwise(but: fn(&Question) -> Option<Answer>) -> (Summary, usize, SimulatedOperator) {
    let file = file();
    runtime().block_on(async {
        let site = Site::new(&file).unwrap();
        let mut bystander = site.bystander().unwrap();
        let mut person = Otherwise { bystander: &mut bystander, but, moves: 0 };
        let summary = through(&file, &site, &mut person).await;
        let moves = person.moves;
        (summary, moves, bystander)
    })
}

pub fn with_a_probe_that_nobody_deflects_nothing_may_move() {
    let but = |question: &Question| {
        matches!(question, Question::Stylus(Stylus::Deflected)).then_some(Answer::No)
    };
    let (summary, moves, _) = otherwise(but);
    assert_eq!(moves, 0, "{summary}");
    assert_eq!(summary.count(Verdict::NotLookedAt), 4, "{summary}");
}

/// A sensor may still be mounted in place of the probe.
pub fn where_a_sensor_sits_in_the_probes_place_the_probe_is_asked_for() {
    let file =
        MachineFile::parse("laser.toml", include_str!("../../../config/laser.toml").to_owned());
    let file = file.unwrap();
    let checked = |answer: Option<Answer>| {
        runtime().block_on(async {
            let site = Site::new(&file).unwrap();
            let mut asked = Asked { bystander: site.bystander().unwrap(), answer, asked: 0 };
            let summary = through(&file, &site, &mut asked).await;
            assert_eq!((asked.asked, summary.count(Verdict::Failed)), (1, 0), "{summary}");
            summary.to_string()
        })
    };
    let told = checked(Some(Answer::No));
    assert!(
        told.contains("the touch probe does not sit in the spindle: whether it closes"),
        "{told}"
    );
    let told = checked(None);
    assert!(told.contains("open at rest, closed while deflected, open again"), "{told}");
}

/// Gives this answer to the question whether the probe is in the spindle; without an answer, that of the simulated
/// operator.
struct Asked {
    bystander: SimulatedOperator,
    answer: Option<Answer>,
    asked: usize,
}

impl Person for Asked {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a> {
        let mounted = matches!(question, Question::Stylus(Stylus::Mounted));
        self.asked += usize::from(mounted);
        let told = self.answer.filter(|_| mounted);
        let answer = told.unwrap_or_else(|| self.bystander.answer(question));
        Box::pin(std::future::ready(answer))
    }
}

pub fn whoever_leaves_while_an_axis_is_away_does_not_see_it_go_back() {
    let but =
        |question: &Question| matches!(question, Question::Jogged { .. }).then_some(Answer::Nobody);
    let (summary, moves, mut bystander) = otherwise(but);
    assert_eq!(moves, 1, "{summary}");
    assert!(summary.to_string().contains("it was not moved back"), "{summary}");
    let jog = Jog { axis: Axis::X, by: 1.0, feed_per_min: 60.0 };
    let stands = bystander.answer(&Question::Jogged { jog, look_for: String::new() });
    assert_eq!(stands, Answer::Saw(Seen::AsSaid), "it is where it was left");
}

/// Ends the check when it requests the deflection of the stylus.
struct Leaving(Stop);

impl Person for Leaving {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a> {
        if let Question::Stylus(_) = question {
            self.0.halt().now();
        }
        Box::pin(std::future::ready(Answer::Yes))
    }
}

pub fn regress_a_stop_while_nothing_moves_leaves_no_hold() {
    let control = RecordingControl::start();
    let text = recording_control::machine(&control.address());
    let file = MachineFile::parse("machine.toml", text).unwrap();
    let summary = runtime().block_on(async {
        let site = Site::new(&file).unwrap();
        let (folder, stop) = (tempfile::tempdir().unwrap(), Stop::default());
        let journal = Journal::open(folder.path()).unwrap();
        let (mut person, mut tell) = (Leaving(stop.clone()), |_: &Finding| {});
        let at = (&file, &site, Pace::Fast);
        Check::new(at, &journal, &mut person, stop, &mut tell).through().await
    });
    assert!(summary.stopped && summary.count(Verdict::Failed) == 0, "{summary}");
    assert!(!summary.to_string().contains("held"), "{summary}");
    let sent = control.end().lines().concat();
    assert!(sent.contains("$I") && !sent.contains('!'), "{sent}");
}

/// Moves another axis by hand before the jog is allowed.
struct Clumsy(SimulatedOperator);

impl Person for Clumsy {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a> {
        let Self(bystander) = self;
        let answer = bystander.answer(question);
        if let Question::MayJog { .. } = question {
            bystander.shove(Axis::Y, 0.5);
        }
        Box::pin(std::future::ready(answer))
    }
}

pub fn a_machine_that_was_moved_by_hand_is_not_jogged() {
    let file = file();
    runtime().block_on(async {
        let site = Site::new(&file).unwrap();
        let mut person = Clumsy(site.bystander().unwrap());
        let summary = through(&file, &site, &mut person).await;
        let told = "X +1 mm: it was moved by hand: Y stands at 0.500, not at 0.000";
        assert!(failures(&summary).contains(told), "{summary}");
        assert_eq!(summary.count(Verdict::Failed), 1, "nothing after it: {summary}");
        let jog = Jog { axis: Axis::X, by: 1.0, feed_per_min: 60.0 };
        let moved = person.0.answer(&Question::Jogged { jog, look_for: String::new() });
        assert_eq!(moved, Answer::Saw(Seen::Another(Axis::Y)), "what the hand moved, and no more");
    });
}
