//! Text line protocol for any device with a serial port: `START 1 ENABLE AUTO DOOR`, `STOP`, `ACK`, `STATE`.
//! A `START` line contains the interlocks, which are as fresh as this line. `TELL ENABLE AUTO DOOR IDLE` reports the
//! interlocks for a schedule, which starts without a request. Each line gets one response; the response to `START`
//! is sent when the run has its number.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::time::{Instant, sleep};

use crate::service::command_gate::CommandGate;
use crate::service::machine_state::{Interlocks, MachineState, Refusal, ServiceState};
use crate::service::schedule_state::Readiness;
use crate::service::worker_command::Inspection;
use crate::service::{Log, lock};
use link::{LineEvent, LineLink, LinkConfig, LinkError};

/// Time before a lost port is opened again.
const PORT_REOPEN_DELAY: Duration = Duration::from_secs(2);
/// Time between two checks whether a started run has its number.
const RUN_NUMBER_POLL_PERIOD: Duration = Duration::from_millis(20);
/// Name of the text line as a client, in the log and in the journal.
const TRIGGER_LINE_ACTOR: &str = "the trigger line";
/// Time for which a `TELL` stays valid.
const READINESS_REPORT_VALIDITY: Duration = Duration::from_secs(10);

/// Time and content of the last `TELL`.
type LastReadinessReport = Arc<Mutex<Option<(Instant, Readiness)>>>;

/// Serves the trigger line without end: a lost port is opened again.
pub async fn serve_trigger_line(config: LinkConfig, gate: CommandGate, log: Log) {
    let mut last = String::new();
    let last_readiness = LastReadinessReport::default();
    loop {
        if let Err(error) = serve_open_port(&config, &gate, &last_readiness).await {
            // An error is logged once, not at every attempt.
            let message = error.to_string();
            if message != last {
                log.error(&format!("the trigger line: {message}"));
                last = message;
            }
        }
        sleep(PORT_REOPEN_DELAY).await;
    }
}

/// Readiness of the last `TELL`; after [`READINESS_REPORT_VALIDITY`] no condition holds and the interlocks are not
/// fresh.
fn fresh_readiness(last: &LastReadinessReport) -> Readiness {
    let report = lock(last).filter(|(when, _)| when.elapsed() <= READINESS_REPORT_VALIDITY);
    report.map(|(_, readiness)| readiness).unwrap_or_default()
}

/// Opens the port and serves it until a link error.
async fn serve_open_port(
    config: &LinkConfig,
    gate: &CommandGate,
    last_readiness: &LastReadinessReport,
) -> Result<(), LinkError> {
    let mut link = link::open_line_link(&config.resolve_address()?).await?;
    let mut is_starting = false;
    loop {
        if let Some(received) = link.recv_deadline(Instant::now() + RUN_NUMBER_POLL_PERIOD).await? {
            is_starting |= execute_line_and_check_pending_start(&received, &mut link, gate, last_readiness)?;
        }
        let machine_state = gate.machine_state();
        if is_starting && (machine_state.run > 0 || machine_state.state != ServiceState::Running) {
            is_starting = false;
            link.send_line(&match machine_state.run {
                0 => "FAILED before the run began".to_owned(),
                run => format!("OK run {run}"),
            })?;
        }
    }
}

/// Executes a received line and sends its response. Returns whether a run begins: the response is then sent later,
/// with the number of the run.
fn execute_line_and_check_pending_start(
    received: &LineEvent,
    link: &mut LineLink,
    gate: &CommandGate,
    last_readiness: &LastReadinessReport,
) -> Result<bool, LinkError> {
    let LineEvent::Line(line) = received else { return Ok(false) };
    let words: Vec<String> = line.split_whitespace().map(str::to_ascii_uppercase).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let response = match words.as_slice() {
        [] => return Ok(false),
        ["START", cycle, words @ ..] => match (cycle.parse(), parse_interlocks(words)) {
            (Ok(cycle), Some(interlocks)) => match gate.start_cycle(cycle, interlocks, TRIGGER_LINE_ACTOR) {
                Ok(()) => return Ok(true),
                Err(why) => format!("REFUSED {why}"),
            },
            _ => refuse_unreadable_line(gate),
        },
        ["TELL", words @ ..] => match parse_readiness(words) {
            Some(readiness) => {
                let mut last = lock(last_readiness);
                // The first `TELL` makes the line a source of readiness; a line that sends only commands is not one.
                if last.replace((Instant::now(), readiness)).is_none() {
                    let last_readiness = Arc::clone(last_readiness);
                    gate.add_readiness_source(move || fresh_readiness(&last_readiness));
                }
                "OK".to_owned()
            }
            None => refuse_unreadable_line(gate),
        },
        ["STOP"] => {
            let _ = gate.hold_machine(TRIGGER_LINE_ACTOR);
            "OK".to_owned()
        }
        ["ACK"] => {
            // The reason of a refusal is in the machine state.
            let _ = gate.acknowledge(Inspection { who: TRIGGER_LINE_ACTOR, ..Inspection::default() });
            "OK".to_owned()
        }
        ["STATE"] => {
            let MachineState { state, cycle, run, progress_percent, .. } = gate.machine_state();
            format!("{} cycle {cycle} run {run} {progress_percent} %", state.label().to_uppercase())
        }
        _ => refuse_unreadable_line(gate),
    };
    link.send_line(&response)?;
    Ok(false)
}

/// Records the refusal of the line; returns the response.
fn refuse_unreadable_line(gate: &CommandGate) -> String {
    gate.record_refusal(Refusal::Unreadable, &format!("request of {TRIGGER_LINE_ACTOR}"));
    format!("REFUSED {}", Refusal::Unreadable)
}

/// Readiness that the words of a `TELL` report; a condition without its word does not hold. `None` for an unknown
/// word.
fn parse_readiness(words: &[&str]) -> Option<Readiness> {
    let mut readiness = Readiness::default();
    let mut interlock_words = Vec::new();
    for word in words {
        match *word {
            "PROBE" => readiness.is_probe_ready = true,
            "ARTEFACT" => readiness.is_artefact_in_place = true,
            "TEMPERATURE" => readiness.is_temperature_in_range = true,
            "IDLE" => readiness.is_control_idle = true,
            word => interlock_words.push(word),
        }
    }
    Some(Readiness { interlocks: parse_interlocks(&interlock_words)?, ..readiness })
}

/// Fresh interlocks that the words of a line report; one without its word does not hold, and a stop input is never
/// set. `None` for an unknown word.
fn parse_interlocks(words: &[&str]) -> Option<Interlocks> {
    let mut interlocks = Interlocks { is_fresh: true, ..Interlocks::default() };
    for word in words {
        match *word {
            "ENABLE" => interlocks.is_start_enabled = true,
            "AUTO" => interlocks.is_auto_mode = true,
            "DOOR" => interlocks.is_door_closed = true,
            _ => return None,
        }
    }
    Some(interlocks)
}
