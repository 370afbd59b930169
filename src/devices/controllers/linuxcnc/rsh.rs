//! Client of linuxcncrsh: `get` and `set` lines, one at a time on one connection.

use std::time::Duration;

use tokio::time::Instant;

use super::not_ready::not_ready;
use crate::controllers::{ControllerError, Halt};
use link::{Address, Link, LinkError, Received};

/// Maximum time for an answer. A healthy linuxcncrsh answers within 0.1 s, and a task accepts a command
/// within 5 ms.
const ANSWER: Duration = Duration::from_secs(3);
/// Maximum time for an answer once the machine is to hold.
const UNANSWERED: Duration = Duration::from_millis(300);
const LOOK: Duration = Duration::from_millis(20);

pub(super) struct Rsh {
    pub link: Link,
    /// Name and version that linuxcncrsh reports.
    pub server: String,
    /// Halt of the machine. Once it is requested, a lost answer is not waited for.
    pub halt: Option<Halt>,
}

impl Rsh {
    /// Connects and performs the handshake. This alone gives no right to command: see [`Rsh::enable`].
    pub async fn open(address: &Address) -> Result<Self, ControllerError> {
        let link = link::open(address).await.map_err(|error| not_there(address, error))?;
        let mut rsh = Self { link, server: String::new(), halt: None };
        let answer = rsh.ask("hello EMC trued 1.0", &["HELLO"]).await?;
        let Some(server) = answer.strip_prefix("ACK") else {
            return Err(refused("hello EMC trued 1.0", answer, "it wants another password"));
        };
        rsh.server = server.trim().to_owned();
        // This command is not answered, but perhaps echoed.
        rsh.link.send_line("set echo off")?;
        rsh.set("verbose on").await?;
        Ok(rsh)
    }

    /// Takes the right to command; the connection that had it loses it.
    pub async fn enable(&mut self) -> Result<(), ControllerError> {
        self.set("enable EMCTOO").await
    }

    /// Returns what follows the key in the answer to `get KEY`.
    pub async fn get(&mut self, key: &str) -> Result<String, ControllerError> {
        let key = key.to_ascii_uppercase();
        let line = format!("get {key}");
        let refusal = format!("GET {key}");
        let answer = self.ask(&line, &[&key, &refusal]).await?;
        if answer == "NAK" {
            return Err(refused(&line, answer, "this linuxcncrsh does not know it"));
        }
        Ok(answer)
    }

    /// Sends a `set` that concerns linuxcncrsh alone.
    pub async fn set(&mut self, what: &str) -> Result<(), ControllerError> {
        let line = format!("set {what}");
        let key = what.split_whitespace().next().unwrap_or_default().to_ascii_uppercase();
        let answer = self.ask(&line, &[&format!("SET {key}")]).await?;
        if answer == "ACK" {
            return Ok(());
        }
        Err(refused(&line, answer, "it is not allowed now, or another program has taken command"))
    }

    /// Sends a `set` that the task must accept; linuxcncrsh acknowledges it when the task has accepted it.
    pub async fn command(&mut self, what: &str) -> Result<(), ControllerError> {
        match self.set(what).await {
            Err(ControllerError::NoAnswer { .. }) => Err(ControllerError::Frozen),
            answer => answer,
        }
    }

    /// Sends `line`; returns the rest of the first line that begins with one of `starts`.
    async fn ask(&mut self, line: &str, starts: &[&str]) -> Result<String, ControllerError> {
        self.link.send_line(line)?;
        let mut deadline = Instant::now() + ANSWER;
        loop {
            if self.halt.as_ref().is_some_and(Halt::is_halted) {
                deadline = deadline.min(Instant::now() + UNANSWERED);
            }
            let look = deadline.min(Instant::now() + LOOK);
            match self.link.recv_deadline(look).await? {
                None if look < deadline => {}
                // An acknowledgement ends in \n\r: the \r arrives at the beginning of the next line.
                Some(Received::Line(text)) => {
                    let text = text.trim();
                    let rest = starts.iter().find_map(|start| {
                        text.strip_prefix(start).filter(|r| r.is_empty() || r.starts_with(' '))
                    });
                    if let Some(rest) = rest {
                        return Ok(rest.trim().to_owned());
                    }
                    // Words of another connection's line may be mixed into this one (see `watch::stop`).
                    if text.ends_with("NAK") {
                        return Ok("NAK".to_owned());
                    }
                }
                Some(Received::Noise { bytes }) => {
                    return Err(ControllerError::Garbled { text: format!("{bytes} odd bytes") });
                }
                None => {
                    let seconds = ANSWER.as_secs_f64();
                    return Err(ControllerError::NoAnswer { line: line.to_owned(), seconds });
                }
            }
        }
    }

    /// Reads the messages for the operator. Each kind has one slot, which is overwritten: suitable for
    /// display, not for results.
    pub async fn messages(&mut self) -> Result<Vec<String>, ControllerError> {
        let mut said = Vec::new();
        for key in ["ERROR", "OPERATOR_DISPLAY", "OPERATOR_TEXT"] {
            for _ in 0..8 {
                let text = self.get(key).await?;
                if text == "OK" {
                    break;
                }
                said.push(text);
            }
        }
        Ok(said)
    }
}

fn not_there(address: &Address, error: LinkError) -> ControllerError {
    match error {
        LinkError::NotListening { .. } => not_ready(
            &format!("no linuxcncrsh listens at {address}"),
            "start LinuxCNC and linuxcncrsh (as its display, or beside it); check [controller] tcp",
        ),
        other => other.into(),
    }
}

fn refused(line: &str, reply: String, meaning: &str) -> ControllerError {
    ControllerError::Refused { line: line.to_owned(), reply, meaning: meaning.to_owned() }
}
