//! The seam to whoever stands at the machine.

use std::pin::Pin;
use std::time::Duration;

use machine::record::question::{Answer, Question};
use simulator::Bystander;

pub type Answering<'a> = Pin<Box<dyn Future<Output = Answer> + 'a>>;

/// Somebody who can be asked. While an answer is waited for, the links live on: a person may take as
/// long as they like, and must not block the runtime.
pub trait Person {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a>;
    /// After an answer, what a hand does is done within this time.
    fn takes(&self) -> Duration {
        Duration::from_secs(20)
    }
}

/// Nobody is there: nothing moves.
pub struct Nobody;

impl Person for Nobody {
    fn ask<'a>(&'a mut self, _: &'a Question) -> Answering<'a> {
        Box::pin(std::future::ready(Answer::Nobody))
    }
}

impl Person for Bystander {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a> {
        Box::pin(std::future::ready(self.answer(question)))
    }

    /// It is done with the answer; the control may be slow to show it.
    fn takes(&self) -> Duration {
        Duration::from_millis(300)
    }
}
