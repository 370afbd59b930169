//! Persistent state of schedules: armings of cycles and outcomes of slots. A slot is identified by its instant,
//! so that no slot repeats when the clock is set back.

use jiff::{Timestamp, Unit};
use rusqlite::{Connection, OptionalExtension, Row, Transaction, params};
use serde::{Deserialize, Serialize};

use super::{AuditEntry, AwaitableWrite, Journal, RunId, StoreError, StoreFault, audit, columns, write};

/// Permission of a person that a cycle may start unattended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Arming {
    pub machine: String,
    /// Number by which the service starts the cycle, from 1.
    pub cycle: u16,
    /// Person who armed the cycle.
    pub who: String,
    /// Reason of the arming; may be empty.
    pub why: String,
    pub armed: Timestamp,
    /// Instant from which on the cycle may not start any more.
    pub until: Timestamp,
    /// Time and reason of an early end of the arming: disarmed, or replaced by another arming. `None` also after
    /// `until`.
    pub ended: Option<(Timestamp, String)>,
    /// First run of this machine that was held, failed or interrupted after the arming, which is no longer valid
    /// then. An acknowledgement does not restore the arming. `arm_cycle` ignores this value.
    #[serde(rename = "broken")]
    pub broken_by_run: Option<RunId>,
}

/// Outcome of a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SlotOutcome {
    /// The start of the cycle was requested; its result is not known yet.
    Started,
    /// The run that this slot started has an estimate, whatever its verdict.
    Ran,
    /// The cycle that this slot started ended without an estimate.
    Failed,
    /// The cycle was not started; `why` contains the reason.
    Skipped,
    /// The service was not running at the time of the slot, or the clock was set forward over it.
    Missed,
}

impl SlotOutcome {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Started => "started",
            Self::Ran => "ran",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
            Self::Missed => "missed",
        }
    }
}

/// One instant of one schedule, and its outcome.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScheduleSlot {
    pub machine: String,
    /// Name of the schedule.
    pub schedule: String,
    /// Number by which the service starts the cycle, from 1.
    pub cycle: u16,
    /// Planned time of the slot.
    pub at: Timestamp,
    pub outcome: SlotOutcome,
    /// Reason of the outcome, or the verdict of a run; empty for `Started`.
    pub why: String,
    /// Number of the run, 0 for none.
    pub run: i64,
}

impl Journal {
    /// Replaces the arming of the cycle by `arming`, and adds an entry to the audit log.
    pub fn arm_cycle(&self, arming: &Arming) -> AwaitableWrite<()> {
        let arming = arming.clone();
        self.submit_job(move |connection| insert_arming(connection, &arming))
    }

    /// Ends the armings of `machine`, of one cycle or of all. Returns how many armings ended, among them those past
    /// their `until`; each end is an entry in the audit log.
    pub fn disarm_cycles(&self, machine: &str, cycle: Option<u16>, who: &str, why: &str) -> AwaitableWrite<usize> {
        let [machine, who, why] = [machine, who, why].map(str::to_owned);
        self.submit_job(move |connection| {
            let transaction = write::begin_transaction(connection)?;
            let reason = if why.is_empty() { format!("by {who}") } else { format!("{why}, by {who}") };
            let ended = end_armings(&transaction, &machine, cycle, &reason)?;
            for arming in &ended {
                let arming = Arming { who: who.clone(), why: why.clone(), ..arming.clone() };
                insert_arming_audit_entry(&transaction, &arming, format!("cycle {} is disarmed", arming.cycle))?;
            }
            transaction.commit()?;
            Ok(ended.len())
        })
    }

    /// The last arming of each cycle of `machine`, whether it is still valid or not.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn last_arming_of_each_cycle(&self, machine: &str) -> Result<Vec<Arming>, StoreError> {
        self.query(|connection| select_last_armings(connection, machine))
    }

    /// Names of all machines with a run, a schedule or an arming, each once.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn machine_names(&self) -> Result<Vec<String>, StoreError> {
        let select = "SELECT machine FROM runs UNION SELECT machine FROM schedules
                       UNION SELECT machine FROM armings";
        self.query(|connection| columns::select_rows(connection, select, [], |row| row.get(0)))
    }

    /// Replaces the schedules of `machine`, by name and calendar; others are forgotten. Returns for each schedule the
    /// instant up to which its slots have an outcome; for a new schedule or a changed calendar, this is `now`.
    pub fn register_schedules(
        &self,
        machine: &str,
        names_and_calendars: Vec<(String, String)>,
        now: Timestamp,
    ) -> AwaitableWrite<Vec<Timestamp>> {
        let machine = machine.to_owned();
        self.submit_job(move |connection| {
            let transaction = write::begin_transaction(connection)?;
            let seen = names_and_calendars.iter().map(|(name, calendar)| {
                let seen = transaction.query_row(
                    "SELECT seen FROM schedules WHERE machine = ?1 AND schedule = ?2 AND calendar = ?3",
                    params![machine, name, calendar],
                    |row| columns::parse_text_column(row, 0),
                );
                Ok(seen.optional()?.unwrap_or_else(|| floor_to_whole_second(now)))
            });
            let seen = seen.collect::<Result<Vec<Timestamp>, StoreFault>>()?;
            transaction.execute("DELETE FROM schedules WHERE machine = ?1", [&machine])?;
            for ((name, calendar), seen) in names_and_calendars.iter().zip(&seen) {
                transaction.execute(
                    "INSERT INTO schedules (machine, schedule, calendar, seen) VALUES (?1, ?2, ?3, ?4)",
                    params![machine, name, calendar, slot_time_text(*seen)],
                )?;
            }
            transaction.commit()?;
            Ok(seen)
        })
    }

    /// Stores the outcome of a slot. `false`: an earlier outcome exists and is kept. Exceptions: a missed slot may
    /// still start if the clock is set back, and a started slot gets its run number and its final outcome.
    pub fn store_slot(&self, slot: &ScheduleSlot) -> AwaitableWrite<bool> {
        let slot = slot.clone();
        self.submit_job(move |connection| upsert_slot(connection, &slot))
    }

    /// At most `limit` slots of `machine`, latest planned time first.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn newest_slots(&self, machine: &str, limit: usize) -> Result<Vec<ScheduleSlot>, StoreError> {
        self.query(|connection| select_slots(connection, machine, limit))
    }
}

/// As [`Journal::arm_cycle`]. Slots after the arming count again if a wrong clock had settled them.
fn insert_arming(connection: &mut Connection, arming: &Arming) -> Result<(), StoreFault> {
    let Arming { machine, cycle, who, why, armed, until, .. } = arming;
    let transaction = write::begin_transaction(connection)?;
    end_armings(&transaction, machine, Some(*cycle), "replaced by a new arming")?;
    transaction.execute(
        "INSERT INTO armings (machine, cycle, who, why, armed, until, after_event)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, (SELECT coalesce(max(seq), 0) FROM events))",
        params![machine, cycle, who, why, armed.to_string(), until.to_string()],
    )?;
    // A `seen` later than now is reset to now: it comes from a clock that was wrong.
    transaction.execute(
        "UPDATE schedules SET seen = ?2 WHERE machine = ?1 AND seen > ?2",
        params![machine, slot_time_text(*armed)],
    )?;
    insert_arming_audit_entry(&transaction, arming, format!("cycle {cycle} is armed until {until}"))?;
    Ok(transaction.commit()?)
}

/// Ends the armings that have not ended before; returns them as they were.
fn end_armings(
    transaction: &Transaction<'_>,
    machine: &str,
    cycle: Option<u16>,
    why: &str,
) -> Result<Vec<Arming>, StoreFault> {
    let all = select_last_armings(transaction, machine)?.into_iter();
    let open = all.filter(|arming| arming.ended.is_none() && cycle.is_none_or(|cycle| cycle == arming.cycle));
    let open: Vec<Arming> = open.collect();
    transaction.execute(
        "UPDATE armings SET ended = ?3, ended_why = ?4
         WHERE machine = ?1 AND ended IS NULL AND (?2 IS NULL OR cycle = ?2)",
        params![machine, cycle, columns::now_text(), why],
    )?;
    Ok(open)
}

fn insert_arming_audit_entry(transaction: &Transaction<'_>, arming: &Arming, what: String) -> Result<(), StoreFault> {
    let Arming { machine, who, why, .. } = arming.clone();
    audit::insert_audit_entry(transaction, &AuditEntry { who, what, why, machine, run: 0, outcome: "done".to_owned() })
}

fn select_last_armings(connection: &Connection, machine: &str) -> Result<Vec<Arming>, StoreFault> {
    let select = "SELECT cycle, who, why, armed, until, ended, ended_why, after_event FROM armings
         WHERE seq IN (SELECT max(seq) FROM armings WHERE machine = ?1 GROUP BY cycle)
         ORDER BY cycle";
    let armings_and_events = columns::select_rows(connection, select, [machine], |row| {
        let ended = match row.get::<_, Option<String>>(5)? {
            Some(_) => Some((columns::parse_text_column(row, 5)?, row.get(6)?)),
            None => None,
        };
        let arming = Arming {
            machine: machine.to_owned(),
            cycle: row.get(0)?,
            who: row.get(1)?,
            why: row.get(2)?,
            armed: columns::parse_text_column(row, 3)?,
            until: columns::parse_text_column(row, 4)?,
            ended,
            broken_by_run: None,
        };
        Ok((arming, row.get::<_, i64>(7)?))
    })?;
    let with_broken_run = |(arming, after_event): (Arming, i64)| {
        let broken_by_run = first_run_broken_after_event(connection, machine, after_event);
        broken_by_run.map(|broken_by_run| Arming { broken_by_run, ..arming })
    };
    armings_and_events.into_iter().map(with_broken_run).collect()
}

/// The first run of `machine` that was held, failed or interrupted after the event `after_event`. Events are ordered
/// by sequence number, not by a clock that may be set.
fn first_run_broken_after_event(
    connection: &Connection,
    machine: &str,
    after_event: i64,
) -> Result<Option<RunId>, StoreFault> {
    let found = connection.query_row(
        "SELECT runs.id FROM runs WHERE machine = ?1 AND (
             state = 'interrupted'
             AND (SELECT max(seq) FROM events WHERE run = runs.id
                  AND json_extract(event, '$.event') <> 'acknowledged') > ?2
             OR id IN (SELECT run FROM events WHERE seq > ?2
                       AND json_extract(event, '$.event') IN ('held', 'faulted')))
         ORDER BY id LIMIT 1",
        params![machine, after_event],
        |row| row.get(0).map(RunId),
    );
    Ok(found.optional()?)
}

/// As [`Journal::store_slot`]; also advances the instant up to which the slots of the schedule have an outcome.
fn upsert_slot(connection: &mut Connection, slot: &ScheduleSlot) -> Result<bool, StoreFault> {
    let ScheduleSlot { machine, schedule, cycle, at, outcome, why, run } = slot;
    let (at, outcome) = (slot_time_text(*at), outcome.as_str());
    let transaction = write::begin_transaction(connection)?;
    let kept = transaction.execute(
        "INSERT INTO slots (machine, schedule, at, cycle, decided, outcome, why, run)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)
         ON CONFLICT (machine, schedule, at) DO UPDATE SET
             decided = excluded.decided, outcome = excluded.outcome, why = excluded.why,
             run = excluded.run
         WHERE outcome = 'missed' AND excluded.outcome <> 'missed'
            OR outcome = 'started' AND (excluded.outcome IN ('ran', 'failed', 'skipped')
                                        OR run = 0 AND excluded.run > 0)",
        params![machine, schedule, at, cycle, columns::now_text(), outcome, why, run],
    )?;
    transaction.execute(
        "UPDATE schedules SET seen = ?3 WHERE machine = ?1 AND schedule = ?2 AND seen < ?3",
        params![machine, schedule, at],
    )?;
    transaction.commit()?;
    Ok(kept > 0)
}

fn select_slots(connection: &Connection, machine: &str, limit: usize) -> Result<Vec<ScheduleSlot>, StoreFault> {
    let select = "SELECT schedule, at, cycle, outcome, why, run FROM slots
         WHERE machine = ?1 ORDER BY at DESC, schedule LIMIT ?2";
    let limit = i64::try_from(limit).unwrap_or(i64::MAX);
    columns::select_rows(connection, select, params![machine, limit], |row| slot_from_row(machine, row))
}

fn slot_from_row(machine: &str, row: &Row<'_>) -> rusqlite::Result<ScheduleSlot> {
    Ok(ScheduleSlot {
        machine: machine.to_owned(),
        schedule: row.get(0)?,
        at: columns::parse_text_column(row, 1)?,
        cycle: row.get(2)?,
        outcome: columns::parse_name_column(row, 3, "outcome")?,
        why: row.get(4)?,
        run: row.get(5)?,
    })
}

/// Text of a slot's time, rounded down to a whole second, so that the same instant gives the same text.
fn slot_time_text(at: Timestamp) -> String {
    floor_to_whole_second(at).to_string()
}

fn floor_to_whole_second(at: Timestamp) -> Timestamp {
    at.round(jiff::TimestampRound::new().smallest(Unit::Second).mode(jiff::RoundMode::Floor)).unwrap_or(at)
}
