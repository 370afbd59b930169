//! Interface to the operator at the machine.

use std::pin::Pin;
use std::time::Duration;

use machine::record::question::{Answer, Question};
use simulator::SimulatedOperator;

pub type Answering<'a> = Pin<Box<dyn Future<Output = Answer> + 'a>>;

/// Operator who answers questions. The links stay active during the wait: an operator may take any time and
/// must not block the runtime.
pub trait Person {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a>;
    /// Maximum time from an answer to the end of the manual action.
    fn takes(&self) -> Duration {
        Duration::from_secs(20)
    }
}

/// No operator is present: nothing moves.
pub struct Nobody;

impl Person for Nobody {
    fn ask<'a>(&'a mut self, _: &'a Question) -> Answering<'a> {
        Box::pin(std::future::ready(Answer::Nobody))
    }
}

impl Person for SimulatedOperator {
    fn ask<'a>(&'a mut self, question: &'a Question) -> Answering<'a> {
        Box::pin(std::future::ready(self.answer(question)))
    }

    /// The simulated operator acts before the answer; the control may report it late.
    fn takes(&self) -> Duration {
        Duration::from_millis(300)
    }
}
