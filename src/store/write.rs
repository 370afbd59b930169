//! Jobs of the writer's thread: each function is one transaction, committed when it returns.

use rusqlite::{Connection, Transaction, TransactionBehavior, params};

use super::columns::{has_only_finite_numbers, now_text, select_rows, to_json_with_finite_numbers};
use super::{AwaitableWrite, Journal, MachineLock, NewRun, RunId, RunState, StoreFault, read, sha256_text};
use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::Reading;

const PROGRAM_VERSION: &str = env!("CARGO_PKG_VERSION");

impl Journal {
    /// Adds a run in state `running`, with this program's version and the hashes of its inputs.
    pub fn begin_run(&self, new: &NewRun) -> AwaitableWrite<RunId> {
        let new = new.clone();
        self.submit_job(move |connection| insert_run(connection, &new))
    }

    /// Adds a stage that is about to run, and its new steps to the plan.
    pub fn add_stage(&self, run: RunId, stage: &Stage, new_steps: &[Step]) -> AwaitableWrite<()> {
        let (stage, steps) = (stage.clone(), new_steps.to_vec());
        self.submit_job(move |connection| {
            let text = to_json_with_finite_numbers("the stage", &stage)?;
            let transaction = begin_transaction(connection)?;
            transaction
                .execute("INSERT INTO stages (run, stage) VALUES (?1, ?2)", params![run.0, text])
                .map_err(StoreFault::from_run_error(run))?;
            add_steps(&transaction, run, &steps)?;
            Ok(transaction.commit()?)
        })
    }

    /// Adds the reading of one touch or of one sensor value; a second one of the same touch is refused.
    pub fn add_reading(&self, run: RunId, reading: &Reading) -> AwaitableWrite<()> {
        let reading = reading.clone();
        self.submit_job(move |connection| insert_reading(connection, run, &reading))
    }

    /// Adds an event; `Resumed` also adds an interruption to the plan.
    pub fn add_event(&self, run: RunId, event: &RunEvent) -> AwaitableWrite<()> {
        let event = event.clone();
        self.submit_job(move |connection| insert_event(connection, run, &event))
    }

    /// Adds an estimate; earlier estimates of the run stay. Returns its [`super::sha256_of_json`].
    pub fn add_estimate(&self, run: RunId, estimate: &Estimate) -> AwaitableWrite<String> {
        let estimate = estimate.clone();
        self.submit_job(move |connection| {
            let text = to_json_with_finite_numbers("the estimate", &estimate)?;
            let hash = sha256_text(&text);
            let insert = "INSERT INTO estimates (run, made, estimate, sha256, program_version)
             VALUES (?1, ?2, ?3, ?4, ?5)";
            connection
                .execute(insert, params![run.0, now_text(), text, hash, PROGRAM_VERSION])
                .map_err(StoreFault::from_run_error(run))?;
            Ok(hash)
        })
    }

    /// Sets the state of the run and the time of its end. `NotIdentified` is stored as `Finished`; both also store
    /// the mean temperatures of the run.
    pub fn set_state(&self, run: RunId, state: RunState) -> AwaitableWrite<()> {
        self.submit_job(move |connection| set_state(connection, run, state))
    }

    /// Marks as interrupted the runs whose process died in state `running`. Holding the machine's lock proves that the
    /// process is dead.
    pub fn mark_running_runs_interrupted(&self, lock: &MachineLock) -> AwaitableWrite<Vec<RunId>> {
        let machine = lock.machine().to_owned();
        self.submit_job(move |connection| {
            let update = "UPDATE runs SET state = ?1, ended = ?2 WHERE machine = ?3 AND state = ?4 RETURNING id";
            let (dead, alive) = (RunState::Interrupted.as_str(), RunState::Running.as_str());
            select_rows(connection, update, params![dead, now_text(), machine, alive], |row| row.get(0).map(RunId))
        })
    }
}

/// Stores the head of the plan and its steps in separate tables.
fn insert_run(connection: &mut Connection, new: &NewRun) -> Result<RunId, StoreFault> {
    let head = Plan { steps: Vec::new(), ..new.plan.clone() };
    let transaction = begin_transaction(connection)?;
    transaction.execute(
        "INSERT INTO runs (started, method, machine, state, program_version, config, config_sha256,
                           plan_head, plan_sha256)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, '')",
        params![
            now_text(),
            head.method,
            head.machine.name,
            RunState::Running.as_str(),
            PROGRAM_VERSION,
            new.machine_file_text,
            sha256_text(&new.machine_file_text),
            to_json_with_finite_numbers("the plan", &head)?,
        ],
    )?;
    let run = RunId(transaction.last_insert_rowid());
    add_steps(&transaction, run, &new.plan.steps)?;
    transaction.commit()?;
    Ok(run)
}

/// Adds steps to the plan and updates the hash of the plan.
fn add_steps(transaction: &Transaction<'_>, run: RunId, steps: &[Step]) -> Result<(), StoreFault> {
    for step in steps {
        let text = to_json_with_finite_numbers(&format!("step {}", step.id), step)?;
        transaction.execute("INSERT INTO steps (run, id, step) VALUES (?1, ?2, ?3)", params![run.0, step.id, text])?;
    }
    hash_plan(transaction, run)
}

/// Stores the hash of the plan with its steps and interruptions so far.
fn hash_plan(transaction: &Transaction<'_>, run: RunId) -> Result<(), StoreFault> {
    let hash = sha256_text(&to_json_with_finite_numbers("the plan", &read::load_plan(transaction, run)?)?);
    transaction.execute("UPDATE runs SET plan_sha256 = ?2 WHERE id = ?1", params![run.0, hash])?;
    Ok(())
}

fn insert_reading(connection: &mut Connection, run: RunId, reading: &Reading) -> Result<(), StoreFault> {
    // SQLite would store a NaN as NULL, and JSON has no infinity: both are refused.
    let what = || format!("the reading of step {}", reading.step);
    if !has_only_finite_numbers(reading) {
        return Err(StoreFault::NotFinite { what: what() });
    }
    let at = |axis| reading.position.get(axis);
    connection
        .execute(
            "INSERT INTO readings (run, step, repeat, x_mm, y_mm, z_mm, a_rad, b_rad, c_rad, s_rad,
                                   value_mm, sensor, t_s, flag, temperatures_c, kept)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16)",
            params![
                run.0,
                reading.step,
                reading.repeat,
                at(Axis::X),
                at(Axis::Y),
                at(Axis::Z),
                at(Axis::A),
                at(Axis::B),
                at(Axis::C),
                at(Axis::S),
                reading.value_mm,
                reading.sensor,
                reading.t_s,
                reading.flag.as_str(),
                to_json_with_finite_numbers(&what(), &reading.temperatures_c)?,
                now_text(),
            ],
        )
        .map_err(StoreFault::from_reading_error(run, reading.step, reading.repeat))?;
    Ok(())
}

fn insert_event(connection: &mut Connection, run: RunId, event: &RunEvent) -> Result<(), StoreFault> {
    let text = to_json_with_finite_numbers("an event", event)?;
    let transaction = begin_transaction(connection)?;
    transaction
        .execute("INSERT INTO events (run, at, event) VALUES (?1, ?2, ?3)", params![run.0, now_text(), text])
        .map_err(StoreFault::from_run_error(run))?;
    if matches!(event, RunEvent::Resumed { .. }) {
        hash_plan(&transaction, run)?;
    }
    Ok(transaction.commit()?)
}

/// As [`Journal::set_state`].
fn set_state(connection: &mut Connection, run: RunId, state: RunState) -> Result<(), StoreFault> {
    let ended = (state != RunState::Running).then(now_text);
    let is_measured = matches!(state, RunState::NotIdentified | RunState::Finished);
    // Only the estimates show whether the run is identified.
    let state = if is_measured { RunState::Finished } else { state };
    let transaction = begin_transaction(connection)?;
    let changed = transaction
        .execute("UPDATE runs SET state = ?2, ended = ?3 WHERE id = ?1", params![run.0, state.as_str(), ended])?;
    if changed != 1 {
        return Err(StoreFault::RunNotFound(run));
    }
    if is_measured {
        update_mean_temperatures(&transaction, run)?;
    }
    Ok(transaction.commit()?)
}

/// Stores the mean of each thermometer over the readings with a value. A scan counts as one reading; readings before
/// an interruption count as well.
fn update_mean_temperatures(transaction: &Transaction<'_>, run: RunId) -> Result<(), StoreFault> {
    transaction.execute(
        "UPDATE runs SET temperatures_c =
             (SELECT json_group_object(name, mean) FROM
                 (SELECT said.key AS name, avg(said.value) AS mean
                  FROM readings, json_each(readings.temperatures_c) AS said
                  WHERE readings.run = ?1 GROUP BY said.key))
         WHERE id = ?1",
        [run.0],
    )?;
    Ok(())
}

/// Begins an immediate transaction, so that a second writing process waits and does not fail in mid-transaction.
pub(super) fn begin_transaction(connection: &mut Connection) -> Result<Transaction<'_>, StoreFault> {
    Ok(connection.transaction_with_behavior(TransactionBehavior::Immediate)?)
}
