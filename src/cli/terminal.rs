//! Questions to the person at the terminal.

use std::io::{BufRead as _, IsTerminal as _};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::time::sleep;

use crate::commissioning::{Answering, Person, Stop, words_of};
use crate::run::{Asked, PromptAnswers};
use machine::Axis;
use machine::record::question::{Answer, AxisDirection, Question, Seen};

/// Polling period of a stop while the terminal waits for an answer.
const STOP_POLL: Duration = Duration::from_millis(50);

/// A typed line; empty if standard input is no terminal.
pub fn typed(words: &str) -> std::io::Result<String> {
    let mut line = String::new();
    if std::io::stdin().is_terminal() {
        tell!("{words}");
        std::io::stdin().lock().read_line(&mut line)?;
    }
    Ok(line.trim().to_owned())
}

/// Typed lines, in their order.
fn lines() -> Receiver<String> {
    let (line, typed) = channel();
    // On a thread of its own that is never joined, so that the links stay active meanwhile.
    std::thread::spawn(move || {
        let mut lines = std::io::stdin().lines().map_while(Result::ok);
        lines.all(|typed| line.send(typed).is_ok())
    });
    typed
}

/// Answers of the person `who` at the terminal, who confirms with Enter; nobody answers without a terminal.
/// `show` is called with the text of the prompt.
pub fn by_enter(who: String, show: impl Fn(&str) + Send + Sync + 'static) -> PromptAnswers {
    match std::io::stdin().is_terminal() {
        true => entered(who, show, lines),
        false => PromptAnswers::nobody(),
    }
}

/// Login name of the user.
pub fn login() -> String {
    let known = ["USER", "LOGNAME"].iter().filter_map(|name| std::env::var(name).ok());
    let mut known = known.filter(|name| !name.trim().is_empty());
    known.next().unwrap_or_else(|| "somebody at the terminal".to_owned())
}

fn entered(
    who: String,
    show: impl Fn(&str) + Send + Sync + 'static,
    listen: impl Fn() -> Receiver<String> + Send + Sync + 'static,
) -> PromptAnswers {
    let state: Mutex<(Option<Receiver<String>>, Option<Asked>)> = Mutex::default();
    PromptAnswers::new(move |asked| {
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        let (typed, shown) = &mut *state;
        let Some(typed) = typed else {
            // Standard input is read only now: a run without a prompt may run in the background. Lines typed
            // before the prompt arrive until the next poll.
            *typed = Some(listen());
            return None;
        };
        if shown.as_ref() != Some(asked) {
            while typed.try_recv().is_ok() {}
            show(&format!(
                "{}\npress Enter once that is done; Ctrl-C holds the machine",
                asked.text
            ));
            *shown = Some(asked.clone());
        }
        typed.try_recv().is_ok().then(|| who.clone())
    })
}

pub struct Terminal {
    stop: Stop,
    typed: Receiver<String>,
}

impl Terminal {
    pub fn new(stop: Stop) -> Self {
        Self { stop, typed: lines() }
    }

    async fn answer(&self, question: &Question) -> Answer {
        loop {
            // Lines typed before the question do not answer it.
            while self.typed.try_recv().is_ok() {}
            tell!("\n{}", words_of(question));
            let Some(line) = self.line().await else { return Answer::Nobody };
            let answer = match question {
                Question::Jogged { .. } => seen(&line).map(Answer::Saw),
                Question::RetractDirection { .. } => retract_direction(&line),
                _ => yes_or_no(&line),
            };
            match answer {
                Some(answer) => return answer,
                None => tell!("`{line}` is none of the answers"),
            }
        }
    }

    /// The next line. `None`: standard input has ended, or a stop was requested.
    async fn line(&self) -> Option<String> {
        loop {
            match self.typed.try_recv() {
                Ok(line) => return Some(line.trim().to_owned()),
                Err(TryRecvError::Disconnected) => return None,
                Err(TryRecvError::Empty) if self.stop.is_asked() => return None,
                Err(TryRecvError::Empty) => sleep(STOP_POLL).await,
            }
        }
    }
}

impl Person for Terminal {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a> {
        Box::pin(self.answer(question))
    }
}

fn yes_or_no(line: &str) -> Option<Answer> {
    match line.to_ascii_lowercase().as_str() {
        "y" | "yes" => Some(Answer::Yes),
        "n" | "no" => Some(Answer::No),
        _ => None,
    }
}

/// A linear axis and a sign, or no. Yes alone is not accepted, as it names no direction.
fn retract_direction(line: &str) -> Option<Answer> {
    let line = line.to_ascii_uppercase();
    let (letter, is_positive) = match (line.strip_suffix('+'), line.strip_suffix('-')) {
        (Some(letter), _) => (letter, true),
        (_, Some(letter)) => (letter, false),
        _ => return yes_or_no(&line).filter(|answer| *answer == Answer::No),
    };
    let axis: Axis = letter.parse().ok()?;
    axis.is_linear().then_some(Answer::Retract(AxisDirection { axis, is_positive }))
}

/// Parses an observation: a letter, an axis, or a distance.
fn seen(line: &str) -> Option<Seen> {
    match line.to_ascii_lowercase().as_str() {
        "y" | "yes" => return Some(Seen::AsSaid),
        "r" => return Some(Seen::OtherWay),
        "n" | "no" => return Some(Seen::Nothing),
        "?" => return Some(Seen::ResumableRun),
        _ => {}
    }
    if let Ok(axis) = line.to_ascii_uppercase().parse::<Axis>() {
        return Some(Seen::Another(axis));
    }
    line.parse::<f64>().ok().filter(|by| by.is_finite()).map(Seen::Distance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_typed_before_the_question_is_no_answer() {
        let (line, typed) = channel();
        let person = Terminal { stop: Stop::default(), typed };
        (0..3).for_each(|_| line.send("y".to_owned()).unwrap());
        let later = std::thread::spawn(move || {
            std::thread::sleep(4 * STOP_POLL);
            line.send("n".to_owned()).unwrap();
        });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let may = Question::May { what: "May it?".to_owned() };
        assert_eq!(runtime.block_on(person.answer(&may)), Answer::No);
        later.join().unwrap();
        assert_eq!(runtime.block_on(person.answer(&may)), Answer::Nobody, "the terminal is gone");
    }

    #[test]
    fn enter_answers_the_question_that_is_shown_and_no_later_one() {
        let (line, typed) = channel();
        let (typed, shown) = (Mutex::new(Some(typed)), std::sync::Arc::new(Mutex::new(Vec::new())));
        let show = {
            let shown = shown.clone();
            move |words: &str| shown.lock().unwrap().push(words.to_owned())
        };
        let answers =
            entered("Ada".to_owned(), show, move || typed.lock().unwrap().take().unwrap());
        let asked = |step| Asked { step, repeat: 0, text: format!("do {step}") };
        let enter = || line.send(String::new()).unwrap();
        enter();
        assert_eq!([answers.look(&asked(1)), answers.look(&asked(1))], [None, None]);
        enter();
        enter();
        assert_eq!(answers.look(&asked(1)).as_deref(), Some("Ada"));
        assert_eq!([answers.look(&asked(2)), answers.look(&asked(2))], [None, None]);
        enter();
        assert_eq!(answers.look(&asked(2)).as_deref(), Some("Ada"));
        let shown = shown.lock().unwrap();
        assert!(
            shown.len() == 2 && shown[0].starts_with("do 1\n") && shown[1].starts_with("do 2\n")
        );
    }

    #[test]
    fn a_retract_is_typed_as_axis_and_sign() {
        let retract =
            |axis, is_positive| Some(Answer::Retract(AxisDirection { axis, is_positive }));
        assert_eq!(retract_direction("Z+"), retract(Axis::Z, true));
        assert_eq!(retract_direction("x-"), retract(Axis::X, false));
        assert_eq!(retract_direction("n"), Some(Answer::No));
        for line in ["", "y", "Z", "+", "+Z", "C+", "Z+1", "Z++", "\u{fc}+", "\u{2212}"] {
            assert_eq!(retract_direction(line), None, "{line}");
        }
    }

    #[test]
    fn what_was_seen_is_typed_in_a_word() {
        let typed = [
            ("y", Some(Seen::AsSaid)),
            ("R", Some(Seen::OtherWay)),
            ("n", Some(Seen::Nothing)),
            ("?", Some(Seen::ResumableRun)),
            ("c", Some(Seen::Another(Axis::C))),
            ("25.4", Some(Seen::Distance(25.4))),
            ("-3", Some(Seen::Distance(-3.0))),
            ("", None),
            ("maybe", None),
            ("inf", None),
        ];
        for (line, expected) in typed {
            assert_eq!(seen(line), expected, "{line}");
        }
        assert_eq!(yes_or_no("Yes"), Some(Answer::Yes));
        assert_eq!(yes_or_no(""), None, "a slip on the keyboard moves nothing");
    }
}
