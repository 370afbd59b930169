//! Somebody at the terminal is asked.

use std::io::BufRead as _;
use std::time::Duration;

use tokio::sync::oneshot;
use tokio::sync::oneshot::error::TryRecvError;
use tokio::time::sleep;

use crate::base::Axis;
use crate::commissioning::{Answering, Person, Stop, words_of};
use crate::record::question::{Answer, Question, Seen};

/// How often a stop is looked for while an answer is waited for.
const STOP_POLL: Duration = Duration::from_millis(50);

pub struct Terminal {
    stop: Stop,
}

impl Terminal {
    pub fn new(stop: Stop) -> Self {
        Self { stop }
    }

    async fn answer(&self, question: &Question) -> Answer {
        loop {
            tell!("\n{}", words_of(question));
            let Some(line) = self.line().await else { return Answer::Nobody };
            let answer = match question {
                Question::Jogged { .. } => seen(&line).map(Answer::Saw),
                _ => yes_or_no(&line),
            };
            match answer {
                Some(answer) => return answer,
                None => tell!("`{line}` is none of the answers"),
            }
        }
    }

    /// `None`: nobody is there any more, or a stop was asked for.
    async fn line(&self) -> Option<String> {
        let (answer, mut typed) = oneshot::channel();
        // On a thread of its own, left behind after a stop: the links live on meanwhile.
        std::thread::spawn(move || {
            let mut line = String::new();
            let read = std::io::stdin().lock().read_line(&mut line);
            drop(answer.send(read.ok().filter(|count| *count > 0).map(|_| line)));
        });
        loop {
            match typed.try_recv() {
                Ok(line) => return line.map(|line| line.trim().to_owned()),
                Err(TryRecvError::Closed) => return None,
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

/// A letter, an axis, or a distance.
fn seen(line: &str) -> Option<Seen> {
    match line.to_ascii_lowercase().as_str() {
        "y" | "yes" => return Some(Seen::AsSaid),
        "r" => return Some(Seen::OtherWay),
        "n" | "no" => return Some(Seen::Nothing),
        "?" => return Some(Seen::Again),
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
    fn what_was_seen_is_typed_in_a_word() {
        let typed = [
            ("y", Some(Seen::AsSaid)),
            ("R", Some(Seen::OtherWay)),
            ("n", Some(Seen::Nothing)),
            ("?", Some(Seen::Again)),
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
