//! Schedule on a machine's page: the next times, and the outcome of the last slots.

use jiff::Timestamp;
use minijinja::{Value, context};

use super::moment;
use crate::service::schedule_state::{Agenda, Planned};
use crate::store::{Arming, Slot};

/// Number of outcomes that are shown.
const LAST: usize = 5;

/// Values of the panel; `None` without a schedule.
pub fn panel(agenda: &Agenda) -> Option<Value> {
    let Agenda { planned, armed, last } = agenda;
    let now = Timestamp::now();
    let counts =
        |arming: &&Arming| arming.ended.is_none() && arming.broken.is_none() && arming.until > now;
    let armed_for = |cycle: u16| armed.iter().filter(counts).find(|arming| arming.cycle == cycle);
    (!planned.is_empty()).then(|| {
        context! {
            planned => planned.iter().map(|one| entry(one, armed_for(one.cycle))).collect::<Vec<_>>(),
            last => last.iter().take(LAST).map(outcome).collect::<Vec<_>>(),
        }
    })
}

fn entry(planned: &Planned, armed: Option<&Arming>) -> Value {
    context! {
        name => planned.name.as_str(),
        cycle => planned.cycle,
        next => planned.next.first().map(|at| at.strftime("%A, %-d %B, %H:%M %Z").to_string()),
        waiting => planned.waiting.as_deref(),
        armed => armed.map(|arming| context! {
            who => arming.who.as_str(),
            until => moment(arming.until),
        }),
    }
}

fn outcome(slot: &Slot) -> Value {
    context! {
        at => moment(slot.at),
        name => slot.schedule.as_str(),
        outcome => slot.outcome.as_str(),
        why => slot.why.as_str(),
        run => slot.run,
    }
}
