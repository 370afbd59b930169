//! Whom a check asks, and what happens without them.

use trued::commissioning::{Answering, Nobody, Part, Person, Verdict};
use trued::record::question::{Answer, Question};
use trued::setup::{MachineFile, Site};
use trued::world::Bystander;

use super::bench::{machine, runtime, through};

fn file() -> MachineFile {
    MachineFile::parse("machine.toml", machine(&[])).unwrap()
}

#[test]
fn without_anybody_nothing_moves_and_it_says_what_it_cannot_look_at() {
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

/// Says no to whatever moves; keeps what was asked.
struct Careful {
    bystander: Bystander,
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

#[test]
fn whoever_says_no_sees_nothing_move() {
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
