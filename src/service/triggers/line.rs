//! A line of text, for whatever has a serial port: `START 1 ENABLE AUTO DOOR`, `STOP`, `ACK`, `STATE`.
//! What the machine says of itself stands in the line that asks, and is as fresh as the line; `TELL ENABLE
//! AUTO DOOR IDLE` says it for a schedule, which asks when nobody presses a button. Each
//! line gets one answer; that of a start comes when the run has its number.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::time::{Instant, sleep};

use crate::service::Log;
use crate::service::ask::Looked;
use crate::service::board::{Refusal, Said, State};
use crate::service::desk::Desk;
use crate::service::rota::Told;
use link::{Link, LinkError, Named, Received};

/// How long a port that has gone is left alone.
const AGAIN: Duration = Duration::from_secs(2);
/// How often a run that begins is looked for.
const POLL: Duration = Duration::from_millis(20);
const BY: &str = "the line";
/// What was told counts for so long.
const FRESH: Duration = Duration::from_secs(10);

/// What the line has told last, and when.
type Last = Arc<Mutex<Option<(Instant, Told)>>>;

/// For ever: a port that is lost is opened again.
pub async fn attend(named: Named, desk: Desk, log: Log) {
    let mut last = String::new();
    let told = Last::default();
    loop {
        if let Err(error) = listen(&named, &desk, &told).await {
            // Once, not every two seconds.
            let told = error.to_string();
            if told != last {
                log.fault(&format!("the trigger line: {told}"));
                last = told;
            }
        }
        sleep(AGAIN).await;
    }
}

fn fresh(last: &Last) -> Told {
    let told = *last.lock().unwrap_or_else(PoisonError::into_inner);
    told.filter(|(when, _)| when.elapsed() <= FRESH).map_or_else(Told::default, |(_, told)| told)
}

async fn listen(named: &Named, desk: &Desk, told: &Last) -> Result<(), LinkError> {
    let mut link = link::open(&named.address()?).await?;
    let mut begins = false;
    loop {
        if let Some(received) = link.recv_deadline(Instant::now() + POLL).await? {
            begins |= answer(&received, &mut link, desk, told)?;
        }
        let board = desk.board();
        if begins && (board.run > 0 || board.state != State::Running) {
            begins = false;
            link.send_line(&match board.run {
                0 => "FAILED before the run began".to_owned(),
                run => format!("OK run {run}"),
            })?;
        }
    }
}

/// Whether a run begins now; its answer is owed.
fn answer(
    received: &Received,
    link: &mut Link,
    desk: &Desk,
    told: &Last,
) -> Result<bool, LinkError> {
    let Received::Line(line) = received else { return Ok(false) };
    let words: Vec<String> = line.split_whitespace().map(str::to_ascii_uppercase).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let said = match words.as_slice() {
        [] => return Ok(false),
        ["START", cycle, said @ ..] => match (cycle.parse(), inputs(said)) {
            (Ok(cycle), Some(said)) => match desk.start(cycle, said, BY) {
                Ok(()) => return Ok(true),
                Err(why) => format!("REFUSED {why}"),
            },
            _ => unreadable(desk),
        },
        ["TELL", words @ ..] => match tells(words) {
            Some(now) => {
                let mut last = told.lock().unwrap_or_else(PoisonError::into_inner);
                // A line of buttons alone tells nothing; one that has told is waited for.
                if last.replace((Instant::now(), now)).is_none() {
                    let told = Arc::clone(told);
                    desk.rota().tells(move || fresh(&told));
                }
                "OK".to_owned()
            }
            None => unreadable(desk),
        },
        ["STOP"] => {
            let _ = desk.stop(BY);
            "OK".to_owned()
        }
        ["ACK"] => {
            // Why not stands on the board.
            let _ = desk.acknowledge(Looked { who: BY, ..Looked::default() });
            "OK".to_owned()
        }
        ["STATE"] => {
            let board = desk.board();
            let word = format!("{:?}", board.state).to_uppercase();
            format!("{word} cycle {} run {} {} %", board.cycle, board.run, board.progress_percent)
        }
        _ => unreadable(desk),
    };
    link.send_line(&said)?;
    Ok(false)
}

fn unreadable(desk: &Desk) -> String {
    desk.refuse(Refusal::Unreadable, BY);
    format!("REFUSED {}", Refusal::Unreadable)
}

/// `None` for a word that is none.
fn tells(words: &[&str]) -> Option<Told> {
    let mut told = Told::default();
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
    Some(Told { said: inputs(&said)?, ..told })
}

/// `None` for a word that is none.
fn inputs(words: &[&str]) -> Option<Said> {
    let mut said = Said { fresh: true, ..Said::default() };
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
