//! The gate accepts one command at a time; a hold takes effect whatever the machine state is.

use tokio::sync::mpsc::Receiver;

use super::command_gate::CommandGate;
use super::machine_state::{CycleEnd, Interlocks, Refusal, State};
use super::worker_command::{Inspection, Stopped, WorkerCommand};
use crate::run::Rehearsed;
use crate::store::RunId;
use devices::controllers::Halt;

const SAID: Interlocks =
    Interlocks { fresh: true, enable: true, auto: true, door: true, stop: false, person: true };

fn held() -> (CommandGate, Receiver<WorkerCommand>) {
    let (gate, asks) = CommandGate::for_tests();
    gate.finish_command(State::Held);
    (gate, asks)
}

fn ada() -> Inspection<'static> {
    Inspection { who: "Ada", ..Inspection::default() }
}

type Asks = fn(&CommandGate) -> Result<(), Refusal>;

const START: Asks = |gate| gate.start(1, SAID, "Lise");
const LEAVE: Asks = |gate| gate.acknowledge(ada()).map(drop);
const RESUME: Asks = |gate| gate.resume(RunId(1), ada(), SAID).map(drop);

/// Until the first command has ended, no other command is accepted, so that nothing starts by itself afterwards.
#[test]
fn of_all_pairs_of_asks_the_second_waits_for_the_end_of_the_first() {
    for (first, state) in [(START, State::Waiting), (LEAVE, State::Held), (RESUME, State::Held)] {
        for second in [START, LEAVE, RESUME] {
            let (gate, mut asks) = held();
            gate.finish_command(state);
            assert_eq!(first(&gate), Ok(()));
            assert!(second(&gate).is_err());
            let mut taken = 0;
            while asks.try_recv().is_ok() {
                taken += 1;
            }
            assert_eq!(taken, 1);
            assert!(second(&gate).is_err(), "it is still at it");
            gate.finish_command(State::Waiting);
            assert_eq!(START(&gate), Ok(()));
        }
    }
}

/// A state change that is detected meanwhile does not end the command in progress, so no second command is
/// accepted behind it.
#[test]
fn what_is_seen_meanwhile_ends_nothing() {
    let (gate, _asks) = held();
    assert_eq!(LEAVE(&gate), Ok(()));
    assert!(!gate.set_state_if_idle(State::Waiting));
    assert_eq!((gate.machine_state().state, START(&gate).is_err()), (State::Held, true));
    gate.finish_command(State::Held);
    assert!(gate.set_state_if_idle(State::Waiting));
    assert_eq!(START(&gate), Ok(()));
}

#[test]
fn a_hold_is_heard_by_whatever_moves() {
    let (gate, _asks) = held();
    assert_eq!(gate.stop("Ada"), Stopped::Nothing);
    gate.update(|machine_state| machine_state.elsewhere = true);
    assert_eq!(gate.stop("Ada"), Stopped::Elsewhere);
    assert_eq!(RESUME(&gate), Ok(()));
    // The devices are not open yet; the stop takes effect as soon as they are.
    assert_eq!(gate.stop("Ada"), Stopped::Run);
    let (halt, halted) = seen();
    gate.register_halt(&halt);
    assert!(halted());
    gate.record_end(CycleEnd::in_state(State::Held));
    assert_eq!(gate.stop("Ada"), Stopped::Nothing);
    // The stop does not depend on the machine state.
    assert_eq!(RESUME(&gate), Ok(()));
    let (halt, halted) = seen();
    gate.register_halt(&halt);
    gate.update(|machine_state| machine_state.state = State::Waiting);
    assert!(!halted());
    assert_eq!((gate.stop("Ada"), halted()), (Stopped::Run, true));
}

/// The remaining time of a cycle comes from its rehearsal; that of a resumed run is unknown until the run reports it.
#[test]
fn the_time_left_is_never_made_up() {
    let (gate, _asks) = held();
    gate.finish_command(State::Waiting);
    gate.rehearsed([(1, Rehearsed { machine_s: 600.0, asks: true })].into());
    assert_eq!(START(&gate), Ok(()));
    assert_eq!(gate.machine_state().remaining_s, Some(600.0));
    gate.record_end(CycleEnd::in_state(State::Held));
    assert_eq!(gate.machine_state().remaining_s, None);
    assert_eq!(RESUME(&gate), Ok(()));
    assert_eq!(gate.machine_state().remaining_s, None);
}

/// A halt handle, and a function that returns whether it was triggered.
fn seen() -> (Halt, impl Fn() -> bool) {
    let halt = Halt::new(|| ());
    let seen = halt.clone();
    (halt, move || seen.is_halted())
}

/// A person's acknowledgement does not override the interlocks that the machine reports.
#[test]
fn a_machine_that_says_no_is_not_moved() {
    let (gate, _asks) = held();
    let stop = Interlocks { stop: true, ..SAID };
    assert_eq!(gate.resume(RunId(1), ada(), stop).map(drop), Err(Refusal::Stopped));
    let not_free = Interlocks { enable: false, ..SAID };
    assert_eq!(gate.resume(RunId(1), ada(), not_free).map(drop), Err(Refusal::NotEnabled));
}
