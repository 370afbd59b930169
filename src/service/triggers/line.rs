//! Text line protocol for any device with a serial port: `START 1 ENABLE AUTO DOOR`, `STOP`, `ACK`, `STATE`.
//! The interlocks are in the line of the request and are as fresh as the line. `TELL ENABLE AUTO DOOR IDLE` reports
//! them for a schedule, which starts without a request. Each line gets one response; that of a start is sent when
//! the run has its number.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::time::{Instant, sleep};

use crate::service::Log;
use crate::service::command_gate::CommandGate;
use crate::service::machine_state::{Interlocks, Refusal, State};
use crate::service::schedule_state::Readiness;
use crate::service::worker_command::Inspection;
use link::{Link, LinkError, Named, Received};

/// Time before a lost port is opened again.
const AGAIN: Duration = Duration::from_secs(2);
/// Time between two checks whether a started run has its number.
const POLL: Duration = Duration::from_millis(20);
const BY: &str = "the line";
/// Time for which a `TELL` stays valid.
const FRESH: Duration = Duration::from_secs(10);

/// Time and content of the last `TELL`.
type Last = Arc<Mutex<Option<(Instant, Readiness)>>>;

/// Never returns: a lost port is opened again.
pub async fn attend(named: Named, gate: CommandGate, log: Log) {
    let mut last = String::new();
    let told = Last::default();
    loop {
        if let Err(error) = listen(&named, &gate, &told).await {
            // An error is logged once, not at every attempt.
            let told = error.to_string();
            if told != last {
                log.fault(&format!("the trigger line: {told}"));
                last = told;
            }
        }
        sleep(AGAIN).await;
    }
}

fn fresh(last: &Last) -> Readiness {
    let told = *last.lock().unwrap_or_else(PoisonError::into_inner);
    told.filter(|(when, _)| when.elapsed() <= FRESH)
        .map_or_else(Readiness::default, |(_, told)| told)
}

async fn listen(named: &Named, gate: &CommandGate, told: &Last) -> Result<(), LinkError> {
    let mut link = link::open(&named.address()?).await?;
    let mut begins = false;
    loop {
        if let Some(received) = link.recv_deadline(Instant::now() + POLL).await? {
            begins |= answer(&received, &mut link, gate, told)?;
        }
        let machine_state = gate.machine_state();
        if begins && (machine_state.run > 0 || machine_state.state != State::Running) {
            begins = false;
            link.send_line(&match machine_state.run {
                0 => "FAILED before the run began".to_owned(),
                run => format!("OK run {run}"),
            })?;
        }
    }
}

/// Returns whether a run begins, so that its response is still to be sent.
fn answer(
    received: &Received,
    link: &mut Link,
    gate: &CommandGate,
    told: &Last,
) -> Result<bool, LinkError> {
    let Received::Line(line) = received else { return Ok(false) };
    let words: Vec<String> = line.split_whitespace().map(str::to_ascii_uppercase).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let said = match words.as_slice() {
        [] => return Ok(false),
        ["START", cycle, said @ ..] => match (cycle.parse(), inputs(said)) {
            (Ok(cycle), Some(said)) => match gate.start(cycle, said, BY) {
                Ok(()) => return Ok(true),
                Err(why) => format!("REFUSED {why}"),
            },
            _ => unreadable(gate),
        },
        ["TELL", words @ ..] => match tells(words) {
            Some(now) => {
                let mut last = told.lock().unwrap_or_else(PoisonError::into_inner);
                // The first `TELL` makes the line a source of readiness; a line that sends only commands is not one.
                if last.replace((Instant::now(), now)).is_none() {
                    let told = Arc::clone(told);
                    gate.add_readiness_source(move || fresh(&told));
                }
                "OK".to_owned()
            }
            None => unreadable(gate),
        },
        ["STOP"] => {
            let _ = gate.stop(BY);
            "OK".to_owned()
        }
        ["ACK"] => {
            // The reason of a refusal is in the machine state.
            let _ = gate.acknowledge(Inspection { who: BY, ..Inspection::default() });
            "OK".to_owned()
        }
        ["STATE"] => {
            let machine_state = gate.machine_state();
            let word = format!("{:?}", machine_state.state).to_uppercase();
            format!(
                "{word} cycle {} run {} {} %",
                machine_state.cycle, machine_state.run, machine_state.progress_percent
            )
        }
        _ => unreadable(gate),
    };
    link.send_line(&said)?;
    Ok(false)
}

fn unreadable(gate: &CommandGate) -> String {
    gate.refuse(Refusal::Unreadable, BY);
    format!("REFUSED {}", Refusal::Unreadable)
}

/// Readiness that the words of a `TELL` report; `None` for an unknown word.
fn tells(words: &[&str]) -> Option<Readiness> {
    let mut told = Readiness::default();
    let mut said = Vec::new();
    for word in words {
        match *word {
            "PROBE" => told.probe = true,
            "ARTEFACT" => told.artefact = true,
            "TEMPERATURE" => told.temperature = true,
            "IDLE" => told.idle = true,
            word => said.push(word),
        }
    }
    Some(Readiness { interlocks: inputs(&said)?, ..told })
}

/// Interlocks that the words of a line report; `None` for an unknown word.
fn inputs(words: &[&str]) -> Option<Interlocks> {
    let mut said = Interlocks { fresh: true, ..Interlocks::default() };
    for word in words {
        match *word {
            "ENABLE" => said.enable = true,
            "AUTO" => said.auto = true,
            "DOOR" => said.door = true,
            _ => return None,
        }
    }
    Some(said)
}
