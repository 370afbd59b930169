//! Interface to the operator at the machine.

use std::pin::Pin;
use std::time::Duration;

use machine::record::question::{OperatorAnswer, OperatorQuestion};
use simulator::SimulatedOperator;

pub type AnswerFuture<'a> = Pin<Box<dyn Future<Output = OperatorAnswer> + 'a>>;

/// Operator who answers questions. The links stay active during the wait: an operator may take any time and
/// must not block the runtime.
pub trait OperatorInterface {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a>;
    /// Maximum time from an answer to the end of the operator's action at the machine.
    fn max_action_time(&self) -> Duration {
        Duration::from_secs(20)
    }
}

/// No operator is present: nothing moves.
pub struct NoOperator;

impl OperatorInterface for NoOperator {
    fn wait_for_answer<'a>(&'a mut self, _: &'a OperatorQuestion) -> AnswerFuture<'a> {
        Box::pin(std::future::ready(OperatorAnswer::NoOperator))
    }
}

impl OperatorInterface for SimulatedOperator {
    fn wait_for_answer<'a>(&'a mut self, question: &'a OperatorQuestion) -> AnswerFuture<'a> {
        Box::pin(std::future::ready(self.answer(question)))
    }

    /// The simulated operator acts before the answer; the control may report the action late.
    fn max_action_time(&self) -> Duration {
        Duration::from_millis(300)
    }
}
