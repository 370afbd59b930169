//! A journal as left by a process that was killed during the identification.

use trued::store::{Journal, NewRun, RunId, RunState};

use crate::support::machine_shop::MachineShop;

/// Adds a copy of run 1 with its first `readings` readings and without its estimate.
pub fn copy_run_1_without_estimate(shop: &MachineShop, readings: usize) -> RunId {
    let journal = Journal::open(&shop.state_folder()).unwrap();
    let whole = journal.load_run(RunId(1)).unwrap();
    let new = NewRun { machine_file_text: whole.machine_file_text, plan: whole.plan };
    let run = journal.begin_run(&new).wait().unwrap();
    for stage in &whole.stages {
        journal.add_stage(run, stage, &[]).wait().unwrap();
    }
    for reading in &whole.readings[..readings.min(whole.readings.len())] {
        journal.add_reading(run, reading).wait().unwrap();
    }
    for (_, event) in &whole.events {
        journal.add_event(run, event).wait().unwrap();
    }
    journal.set_state(run, RunState::Finished).wait().unwrap();
    run
}
