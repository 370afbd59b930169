//! Schedule on a machine's page: the next times, and the outcome of the last slots.

use jiff::Timestamp;
use minijinja::value::Serde;
use minijinja::{Value, context};

use crate::report::time::format_local_time;
use crate::service::machine_state::PlannedSchedule;
use crate::service::schedule_state::Agenda;
use crate::store::{Arming, ScheduleSlot};

/// Maximum number of slots whose outcome is shown.
const MAX_SHOWN_SLOTS: usize = 5;

/// Template values of the schedule's panel; `None` if the machine has no schedule.
pub fn schedule_values(agenda: &Agenda) -> Option<Value> {
    let Agenda { planned, last_armings: armed, newest_slots: last } = agenda;
    let now = Timestamp::now();
    let counts = |arming: &&Arming| arming.ended.is_none() && arming.broken_by_run.is_none() && arming.until > now;
    let armed_for = |cycle: u16| armed.iter().filter(counts).find(|arming| arming.cycle == cycle);
    (!planned.is_empty()).then(|| {
        context! {
            planned => planned.iter().map(|slot| planned_schedule_values(slot, armed_for(slot.cycle))).collect::<Vec<_>>(),
            last => last.iter().take(MAX_SHOWN_SLOTS).map(slot_values).collect::<Vec<_>>(),
        }
    })
}

/// Template values of one schedule; `armed`: the valid arming of its cycle.
fn planned_schedule_values(planned: &PlannedSchedule, armed: Option<&Arming>) -> Value {
    context! {
        next => planned.next.first().map(|at| at.strftime("%A, %-d %B, %H:%M %Z").to_string()),
        armed => armed.map(|arming| context! {
            who => arming.who.as_str(),
            until => format_local_time(arming.until),
        }),
        ..Serde(planned)
    }
}

fn slot_values(slot: &ScheduleSlot) -> Value {
    context! {
        at => format_local_time(slot.at),
        name => slot.schedule.as_str(),
        ..Serde(slot)
    }
}
