//! Questions to the person at the terminal.

use std::io::{BufRead as _, IsTerminal as _};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::time::sleep;

use crate::commissioning::{AnswerFuture, CheckStop, OperatorInterface, describe_question};
use crate::run::{OpenPrompt, PromptAnswerSource};
use machine::Axis;
use machine::record::question::{AxisDirection, ObservedMotion, OperatorAnswer, OperatorQuestion};

/// Polling period for a stop request while the terminal waits for an answer.
const STOP_POLL_PERIOD: Duration = Duration::from_millis(50);

/// Prints `prompt` and reads a line; empty if standard input is no terminal.
pub fn prompt_line(prompt: &str) -> std::io::Result<String> {
    let mut line = String::new();
    if std::io::stdin().is_terminal() {
        errln!("{prompt}");
        std::io::stdin().lock().read_line(&mut line)?;
    }
    Ok(line.trim().to_owned())
}

/// Lines typed on standard input, read on a thread of their own.
fn spawn_line_reader() -> Receiver<String> {
    let (line, typed) = channel();
    // The thread is never joined, so that the device links stay active while it waits for a line.
    std::thread::spawn(move || {
        let mut lines = std::io::stdin().lines().map_while(Result::ok);
        lines.all(|typed| line.send(typed).is_ok())
    });
    typed
}

/// Answers of the operator `who`, who confirms prompts with Enter; without a terminal no prompt can be answered.
/// `show` is called with the text of the prompt.
pub fn enter_key_answer_source(who: String, show: impl Fn(&str) + Send + Sync + 'static) -> PromptAnswerSource {
    match std::io::stdin().is_terminal() {
        true => answer_source_from_typed_lines(who, show, spawn_line_reader),
        false => PromptAnswerSource::without_operator(),
    }
}

/// Login name of the user, from `USER` or else `LOGNAME`; `operator at the terminal` if both are missing or blank.
pub fn login_name() -> String {
    let known = ["USER", "LOGNAME"].iter().filter_map(|name| std::env::var(name).ok());
    let mut known = known.filter(|name| !name.trim().is_empty());
    known.next().unwrap_or_else(|| "operator at the terminal".to_owned())
}

/// Answers of `who` by the Enter key: any line typed after the prompt is displayed confirms it; earlier lines are
/// discarded. `start_line_reader` starts to read the typed lines at the first prompt.
fn answer_source_from_typed_lines(
    who: String,
    show: impl Fn(&str) + Send + Sync + 'static,
    start_line_reader: impl Fn() -> Receiver<String> + Send + Sync + 'static,
) -> PromptAnswerSource {
    let state: Mutex<(Option<Receiver<String>>, Option<OpenPrompt>)> = Mutex::default();
    PromptAnswerSource::new(move |asked| {
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        let (typed, shown) = &mut *state;
        let Some(typed) = typed else {
            // Standard input is read only now: a run without a prompt may run in the background. Lines typed
            // before the prompt arrive until the next poll, which discards them.
            *typed = Some(start_line_reader());
            return None;
        };
        if shown.as_ref() != Some(asked) {
            while typed.try_recv().is_ok() {}
            show(&format!("{}\nPress Enter when this is done. Ctrl-C holds the machine.", asked.text));
            *shown = Some(asked.clone());
        }
        typed.try_recv().is_ok().then(|| who.clone())
    })
}

/// Operator of `trued check` at the terminal.
pub struct TerminalOperator {
    stop: CheckStop,
    typed_lines: Receiver<String>,
}

impl TerminalOperator {
    pub fn new(stop: CheckStop) -> Self {
        Self { stop, typed_lines: spawn_line_reader() }
    }

    /// Repeats the question until the answer is valid; `NoOperator` if standard input has ended or a stop was
    /// requested.
    async fn read_answer(&self, question: &OperatorQuestion) -> OperatorAnswer {
        loop {
            // Lines typed before the question do not answer it.
            while self.typed_lines.try_recv().is_ok() {}
            errln!("\n{}", describe_question(question));
            let Some(line) = self.next_line().await else { return OperatorAnswer::NoOperator };
            let answer = match question {
                OperatorQuestion::ObservedJog { .. } => parse_observation(&line).map(OperatorAnswer::Motion),
                OperatorQuestion::RetractDirection { .. } => parse_retract_direction(&line),
                _ => parse_yes_no(&line),
            };
            match answer {
                Some(answer) => return answer,
                None => errln!("`{line}` is not a valid answer"),
            }
        }
    }

    /// The next line. `None`: standard input has ended, or a stop was requested.
    async fn next_line(&self) -> Option<String> {
        loop {
            match self.typed_lines.try_recv() {
                Ok(line) => return Some(line.trim().to_owned()),
                Err(TryRecvError::Disconnected) => return None,
                Err(TryRecvError::Empty) if self.stop.is_requested() => return None,
                Err(TryRecvError::Empty) => sleep(STOP_POLL_PERIOD).await,
            }
        }
    }
}

impl OperatorInterface for TerminalOperator {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        Box::pin(self.read_answer(question))
    }
}

fn parse_yes_no(line: &str) -> Option<OperatorAnswer> {
    match line.to_ascii_lowercase().as_str() {
        "y" | "yes" => Some(OperatorAnswer::Yes),
        "n" | "no" => Some(OperatorAnswer::No),
        _ => None,
    }
}

/// Parses a linear axis with a sign, such as `Z+`, or `no`. The answer `yes` is not accepted: it names no direction.
fn parse_retract_direction(line: &str) -> Option<OperatorAnswer> {
    let line = line.to_ascii_uppercase();
    let (letter, is_positive) = match (line.strip_suffix('+'), line.strip_suffix('-')) {
        (Some(letter), _) => (letter, true),
        (_, Some(letter)) => (letter, false),
        _ => return parse_yes_no(&line).filter(|answer| *answer == OperatorAnswer::No),
    };
    let axis: Axis = letter.parse().ok()?;
    axis.is_linear().then_some(OperatorAnswer::Retract(AxisDirection { axis, is_positive }))
}

/// Parses an observation: a letter, an axis, or a signed distance in mm or degrees.
fn parse_observation(line: &str) -> Option<ObservedMotion> {
    match line.to_ascii_lowercase().as_str() {
        "y" | "yes" => return Some(ObservedMotion::AsAnnounced),
        "r" => return Some(ObservedMotion::Opposite),
        "n" | "no" => return Some(ObservedMotion::NoMotion),
        "?" => return Some(ObservedMotion::Unclear),
        _ => {}
    }
    if let Ok(axis) = line.to_ascii_uppercase().parse::<Axis>() {
        return Some(ObservedMotion::OtherAxis(axis));
    }
    line.parse::<f64>().ok().filter(|by| by.is_finite()).map(ObservedMotion::Distance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn input_before_the_question_is_ignored() {
        let (line, typed) = channel();
        let person = TerminalOperator { stop: CheckStop::default(), typed_lines: typed };
        (0..3).for_each(|_| line.send("y".to_owned()).unwrap());
        let later = std::thread::spawn(move || {
            std::thread::sleep(4 * STOP_POLL_PERIOD);
            line.send("n".to_owned()).unwrap();
        });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let may = OperatorQuestion::AllowAction { action: "May it?".to_owned() };
        assert_eq!(runtime.block_on(person.read_answer(&may)), OperatorAnswer::No);
        later.join().unwrap();
        assert_eq!(runtime.block_on(person.read_answer(&may)), OperatorAnswer::NoOperator, "the terminal is gone");
    }

    #[test]
    fn enter_answers_only_the_question_shown() {
        let (line, typed) = channel();
        let (typed, shown) = (Mutex::new(Some(typed)), std::sync::Arc::new(Mutex::new(Vec::new())));
        let show = {
            let shown = shown.clone();
            move |words: &str| shown.lock().unwrap().push(words.to_owned())
        };
        let answers =
            answer_source_from_typed_lines("Ada".to_owned(), show, move || typed.lock().unwrap().take().unwrap());
        let asked = |step| OpenPrompt { step_id: step, repeat_number: 0, text: format!("do {step}") };
        let enter = || line.send(String::new()).unwrap();
        enter();
        assert_eq!([answers.poll(&asked(1)), answers.poll(&asked(1))], [None, None]);
        enter();
        enter();
        assert_eq!(answers.poll(&asked(1)).as_deref(), Some("Ada"));
        assert_eq!([answers.poll(&asked(2)), answers.poll(&asked(2))], [None, None]);
        enter();
        assert_eq!(answers.poll(&asked(2)).as_deref(), Some("Ada"));
        let shown = shown.lock().unwrap();
        assert!(shown.len() == 2 && shown[0].starts_with("do 1\n") && shown[1].starts_with("do 2\n"));
    }

    #[test]
    fn retract_is_entered_as_axis_and_sign() {
        let retract = |axis, is_positive| Some(OperatorAnswer::Retract(AxisDirection { axis, is_positive }));
        assert_eq!(parse_retract_direction("Z+"), retract(Axis::Z, true));
        assert_eq!(parse_retract_direction("x-"), retract(Axis::X, false));
        assert_eq!(parse_retract_direction("n"), Some(OperatorAnswer::No));
        for line in ["", "y", "Z", "+", "+Z", "C+", "Z+1", "Z++", "\u{fc}+", "\u{2212}"] {
            assert_eq!(parse_retract_direction(line), None, "{line}");
        }
    }

    #[test]
    fn observed_motion_is_parsed_from_letter_or_distance() {
        let typed = [
            ("y", Some(ObservedMotion::AsAnnounced)),
            ("R", Some(ObservedMotion::Opposite)),
            ("n", Some(ObservedMotion::NoMotion)),
            ("?", Some(ObservedMotion::Unclear)),
            ("c", Some(ObservedMotion::OtherAxis(Axis::C))),
            ("25.4", Some(ObservedMotion::Distance(25.4))),
            ("-3", Some(ObservedMotion::Distance(-3.0))),
            ("", None),
            ("maybe", None),
            ("inf", None),
        ];
        for (line, expected) in typed {
            assert_eq!(parse_observation(line), expected, "{line}");
        }
        assert_eq!(parse_yes_no("Yes"), Some(OperatorAnswer::Yes));
        assert_eq!(parse_yes_no(""), None, "a slip on the keyboard moves nothing");
    }
}
