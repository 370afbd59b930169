//! The seam to whoever stands at the machine.

use std::pin::Pin;

use crate::record::question::{Answer, Question};
use crate::world::Bystander;

pub type Answering<'a> = Pin<Box<dyn Future<Output = Answer> + 'a>>;

/// Somebody who can be asked. While an answer is waited for, the links live on: a person may take as
/// long as they like, and must not block the runtime.
pub trait Person {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a>;
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
}
