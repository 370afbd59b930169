//! One thing is asked for at a time, and a hold is heard whatever the board says.

use tokio::sync::mpsc::Receiver;

use super::ask::{Ask, Looked, Stopped};
use super::board::{Refusal, Said, State};
use super::desk::Desk;
use crate::run::Rehearsed;
use crate::store::RunId;
use devices::controllers::Halt;

const SAID: Said =
    Said { fresh: true, enable: true, auto: true, door: true, stop: false, person: true };

fn held() -> (Desk, Receiver<Ask>) {
    let (desk, asks) = Desk::for_tests();
    desk.becomes(State::Held);
    (desk, asks)
}

fn ada() -> Looked<'static> {
    Looked { who: "Ada", ..Looked::default() }
}

type Asks = fn(&Desk) -> Result<(), Refusal>;

const START: Asks = |desk| desk.start(1, SAID, "Lise");
const LEAVE: Asks = |desk| desk.acknowledge(ada()).map(drop);
const RESUME: Asks = |desk| desk.resume(RunId(1), ada(), SAID).map(drop);

/// Whatever was asked for first: until its end is on the board nothing else is accepted, so that nothing begins
/// by itself afterwards.
#[test]
fn of_all_pairs_of_asks_the_second_waits_for_the_end_of_the_first() {
    for (first, state) in [(START, State::Waiting), (LEAVE, State::Held), (RESUME, State::Held)] {
        for second in [START, LEAVE, RESUME] {
            let (desk, mut asks) = held();
            desk.becomes(state);
            assert_eq!(first(&desk), Ok(()));
            assert!(second(&desk).is_err());
            let mut taken = 0;
            while asks.try_recv().is_ok() {
                taken += 1;
            }
            assert_eq!(taken, 1);
            assert!(second(&desk).is_err(), "it is still at it");
            desk.becomes(State::Waiting);
            assert_eq!(START(&desk), Ok(()));
        }
    }
}

/// What is seen beside it does not end what is asked for: nothing may be accepted behind it.
#[test]
fn what_is_seen_meanwhile_ends_nothing() {
    let (desk, _asks) = held();
    assert_eq!(LEAVE(&desk), Ok(()));
    assert!(!desk.rests(State::Waiting));
    assert_eq!((desk.board().state, START(&desk).is_err()), (State::Held, true));
    desk.becomes(State::Held);
    assert!(desk.rests(State::Waiting));
    assert_eq!(START(&desk), Ok(()));
}

#[test]
fn a_hold_is_heard_by_whatever_moves() {
    let (desk, _asks) = held();
    assert_eq!(desk.stop("Ada"), Stopped::Nothing);
    desk.show(|board| board.elsewhere = true);
    assert_eq!(desk.stop("Ada"), Stopped::Elsewhere);
    assert_eq!(RESUME(&desk), Ok(()));
    // Before its devices are open: not forgotten.
    assert_eq!(desk.stop("Ada"), Stopped::Run);
    let (halt, halted) = seen();
    desk.under_way(&halt);
    assert!(halted());
    desk.ended(State::Held, None);
    assert_eq!(desk.stop("Ada"), Stopped::Nothing);
    // Whatever the board may say.
    assert_eq!(RESUME(&desk), Ok(()));
    let (halt, halted) = seen();
    desk.under_way(&halt);
    desk.show(|board| board.state = State::Waiting);
    assert!(!halted());
    assert_eq!((desk.stop("Ada"), halted()), (Stopped::Run, true));
}

/// What is left of a cycle is what its rehearsal says; of a run that goes on, only the run will know.
#[test]
fn the_time_left_is_never_made_up() {
    let (desk, _asks) = held();
    desk.becomes(State::Waiting);
    desk.rehearsed([(1, Rehearsed { machine_s: 600.0, asks: true })].into());
    assert_eq!(START(&desk), Ok(()));
    assert_eq!(desk.board().remaining_s, Some(600.0));
    desk.ended(State::Held, None);
    assert_eq!(desk.board().remaining_s, None);
    assert_eq!(RESUME(&desk), Ok(()));
    assert_eq!(desk.board().remaining_s, None);
}

/// A halt, and whether it was said.
fn seen() -> (Halt, impl Fn() -> bool) {
    let halt = Halt::new(|| ());
    let seen = halt.clone();
    (halt, move || seen.is_halted())
}

/// Against what the machine says itself no person's word counts.
#[test]
fn a_machine_that_says_no_is_not_moved() {
    let (desk, _asks) = held();
    let stop = Said { stop: true, ..SAID };
    assert_eq!(desk.resume(RunId(1), ada(), stop).map(drop), Err(Refusal::Stopped));
    let not_free = Said { enable: false, ..SAID };
    assert_eq!(desk.resume(RunId(1), ada(), not_free).map(drop), Err(Refusal::NotEnabled));
}
