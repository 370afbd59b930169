//! The gate accepts one command at a time; a hold takes effect whatever the machine state is.

use tokio::sync::mpsc::Receiver;

use super::command_gate::CommandGate;
use super::machine_state::{CycleEnd, Interlocks, Refusal, ServiceState};
use super::worker_command::{HoldEffect, Inspection, WorkerCommand};
use crate::run::RehearsalResult;
use crate::store::RunId;
use devices::controllers::HaltHandle;

/// Interlocks that permit every start; the stop input is not set.
const START_PERMITTING_INTERLOCKS: Interlocks = Interlocks {
    is_fresh: true,
    is_start_enabled: true,
    is_auto_mode: true,
    is_door_closed: true,
    is_stop_set: false,
    has_person_for_prompts: true,
};

fn held_gate() -> (CommandGate, Receiver<WorkerCommand>) {
    let (gate, commands) = CommandGate::for_tests();
    gate.finish_command(ServiceState::Held);
    (gate, commands)
}

fn inspection_by_ada() -> Inspection<'static> {
    Inspection { who: "Ada", ..Inspection::default() }
}

type GateRequest = fn(&CommandGate) -> Result<(), Refusal>;

const START_REQUEST: GateRequest = |gate| gate.start_cycle(1, START_PERMITTING_INTERLOCKS, "Lise");
const ACKNOWLEDGE_REQUEST: GateRequest = |gate| gate.acknowledge(inspection_by_ada()).map(drop);
const RESUME_REQUEST: GateRequest =
    |gate| gate.resume_run(RunId(1), inspection_by_ada(), START_PERMITTING_INTERLOCKS).map(drop);

/// Until the first command has ended, no other command is accepted, so that nothing starts by itself afterwards.
#[test]
fn second_command_is_refused_until_the_first_has_ended() {
    for (first, state) in [
        (START_REQUEST, ServiceState::Waiting),
        (ACKNOWLEDGE_REQUEST, ServiceState::Held),
        (RESUME_REQUEST, ServiceState::Held),
    ] {
        for second in [START_REQUEST, ACKNOWLEDGE_REQUEST, RESUME_REQUEST] {
            let (gate, mut commands) = held_gate();
            gate.finish_command(state);
            assert_eq!(first(&gate), Ok(()));
            assert!(second(&gate).is_err());
            let mut taken = 0;
            while commands.try_recv().is_ok() {
                taken += 1;
            }
            assert_eq!(taken, 1);
            assert!(second(&gate).is_err(), "the first command is not finished");
            gate.finish_command(ServiceState::Waiting);
            assert_eq!(START_REQUEST(&gate), Ok(()));
        }
    }
}

/// A state change that is detected meanwhile does not end the command in progress, so no second command is
/// accepted behind it.
#[test]
fn state_updates_do_not_end_a_pending_command() {
    let (gate, _asks) = held_gate();
    assert_eq!(ACKNOWLEDGE_REQUEST(&gate), Ok(()));
    assert!(!gate.set_state_if_idle(ServiceState::Waiting));
    assert_eq!((gate.machine_state().state, START_REQUEST(&gate).is_err()), (ServiceState::Held, true));
    gate.finish_command(ServiceState::Held);
    assert!(gate.set_state_if_idle(ServiceState::Waiting));
    assert_eq!(START_REQUEST(&gate), Ok(()));
}

#[test]
fn hold_needs_neither_open_devices_nor_a_running_state() {
    let (gate, _asks) = held_gate();
    assert_eq!(gate.hold_machine("Ada"), HoldEffect::NoRunInProgress);
    gate.update_machine_state(|machine_state| machine_state.is_locked_by_other_process = true);
    assert_eq!(gate.hold_machine("Ada"), HoldEffect::OtherProcessCannotBeHeld);
    assert_eq!(RESUME_REQUEST(&gate), Ok(()));
    // The devices are not open yet; the stop takes effect as soon as they are.
    assert_eq!(gate.hold_machine("Ada"), HoldEffect::RunHeld);
    let (halt, halted) = halt_with_observer();
    gate.register_halt_handle(&halt);
    assert!(halted());
    gate.record_cycle_end(CycleEnd::in_state(ServiceState::Held));
    assert_eq!(gate.hold_machine("Ada"), HoldEffect::NoRunInProgress);
    // The stop does not depend on the machine state.
    assert_eq!(RESUME_REQUEST(&gate), Ok(()));
    let (halt, halted) = halt_with_observer();
    gate.register_halt_handle(&halt);
    gate.update_machine_state(|machine_state| machine_state.state = ServiceState::Waiting);
    assert!(!halted());
    assert_eq!((gate.hold_machine("Ada"), halted()), (HoldEffect::RunHeld, true));
}

/// The remaining time of a cycle comes from its rehearsal; that of a resumed run is unknown until the run reports it.
#[test]
fn time_left_comes_from_the_rehearsal_and_is_absent_after_resume() {
    let (gate, _asks) = held_gate();
    gate.finish_command(ServiceState::Waiting);
    gate.set_rehearsal_results([(1, RehearsalResult { machine_time_s: 600.0, has_prompts: true })].into());
    assert_eq!(START_REQUEST(&gate), Ok(()));
    assert_eq!(gate.machine_state().remaining_s, Some(600.0));
    gate.record_cycle_end(CycleEnd::in_state(ServiceState::Held));
    assert_eq!(gate.machine_state().remaining_s, None);
    assert_eq!(RESUME_REQUEST(&gate), Ok(()));
    assert_eq!(gate.machine_state().remaining_s, None);
}

/// A halt handle, and a function that returns whether it was triggered.
fn halt_with_observer() -> (HaltHandle, impl Fn() -> bool) {
    let halt = HaltHandle::new(|| ());
    let observer = halt.clone();
    (halt, move || observer.is_halt_requested())
}

/// A person's acknowledgement does not override the interlocks that the machine reports.
#[test]
fn acknowledgement_does_not_override_the_interlocks() {
    let (gate, _asks) = held_gate();
    let stop = Interlocks { is_stop_set: true, ..START_PERMITTING_INTERLOCKS };
    assert_eq!(gate.resume_run(RunId(1), inspection_by_ada(), stop).map(drop), Err(Refusal::Stopped));
    let not_free = Interlocks { is_start_enabled: false, ..START_PERMITTING_INTERLOCKS };
    assert_eq!(gate.resume_run(RunId(1), inspection_by_ada(), not_free).map(drop), Err(Refusal::NotEnabled));
}
