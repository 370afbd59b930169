//! Client of linuxcncrsh: `get` and `set` lines, one at a time on one connection.

use std::time::Duration;

use tokio::time::Instant;

use crate::controllers::{ControllerError, HaltHandle};
use link::{LineEvent, LineLink, LinkAddress, LinkError};

/// Maximum time for an answer. A healthy linuxcncrsh answers within 0.1 s, and a task accepts a command
/// within 5 ms.
const REPLY_TIMEOUT: Duration = Duration::from_secs(3);
/// Maximum time for an answer after a halt was requested.
const HALT_REPLY_TIMEOUT: Duration = Duration::from_millis(300);
const HALT_POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Connection to linuxcncrsh, with one request at a time.
pub(super) struct RshClient {
    pub link: LineLink,
    /// Name and version that linuxcncrsh reports.
    pub server_identity: String,
    /// Halt of the machine. After a halt request, an answer is awaited for `HALT_REPLY_TIMEOUT` only.
    pub halt_handle: Option<HaltHandle>,
}

impl RshClient {
    /// Connects and performs the handshake. This alone gives no right to command: see
    /// [`RshClient::acquire_command_right`].
    pub async fn open(address: &LinkAddress) -> Result<Self, ControllerError> {
        let link = link::open_line_link(address).await.map_err(|error| connection_error(address, error))?;
        let mut rsh = Self { link, server_identity: String::new(), halt_handle: None };
        let answer = rsh.send_request("hello EMC trued 1.0", &["HELLO"]).await?;
        let Some(server) = answer.strip_prefix("ACK") else {
            let meaning = "linuxcncrsh requires another password";
            return Err(ControllerError::line_refused("hello EMC trued 1.0", answer, meaning));
        };
        rsh.server_identity = server.trim().to_owned();
        // This command is not answered, but perhaps echoed.
        rsh.link.send_line("set echo off")?;
        rsh.set("verbose on").await?;
        Ok(rsh)
    }

    /// Acquires the right to command; the connection that had this right loses it.
    pub async fn acquire_command_right(&mut self) -> Result<(), ControllerError> {
        self.set("enable EMCTOO").await
    }

    /// Returns what follows the key in the answer to `get KEY`.
    pub async fn get(&mut self, key: &str) -> Result<String, ControllerError> {
        let key = key.to_ascii_uppercase();
        let line = format!("get {key}");
        let refusal = format!("GET {key}");
        let answer = self.send_request(&line, &[&key, &refusal]).await?;
        if answer == "NAK" {
            let meaning = "this linuxcncrsh does not support the command";
            return Err(ControllerError::line_refused(&line, answer, meaning));
        }
        Ok(answer)
    }

    /// Sends a `set` that linuxcncrsh executes itself, without the task.
    pub async fn set(&mut self, command: &str) -> Result<(), ControllerError> {
        let line = format!("set {command}");
        let key = command.split_whitespace().next().unwrap_or_default().to_ascii_uppercase();
        let answer = self.send_request(&line, &[&format!("SET {key}")]).await?;
        if answer == "ACK" {
            return Ok(());
        }
        let meaning = "the command is not allowed now, or another program has taken control";
        Err(ControllerError::line_refused(&line, answer, meaning))
    }

    /// Sends a `set` that the task must accept; linuxcncrsh acknowledges it when the task has accepted it.
    pub async fn send_task_command(&mut self, command: &str) -> Result<(), ControllerError> {
        match self.set(command).await {
            Err(ControllerError::NoAnswer { .. }) => Err(ControllerError::ControlFrozen),
            answer => answer,
        }
    }

    /// Sends `line`; returns the rest of the first reply line that begins with one of `reply_prefixes`.
    async fn send_request(&mut self, line: &str, reply_prefixes: &[&str]) -> Result<String, ControllerError> {
        self.link.send_line(line)?;
        let mut deadline = Instant::now() + REPLY_TIMEOUT;
        loop {
            if self.halt_handle.as_ref().is_some_and(HaltHandle::is_halt_requested) {
                deadline = deadline.min(Instant::now() + HALT_REPLY_TIMEOUT);
            }
            let poll_at = deadline.min(Instant::now() + HALT_POLL_INTERVAL);
            match self.link.recv_deadline(poll_at).await? {
                None if poll_at < deadline => {}
                // An acknowledgement ends in \n\r: the \r arrives at the beginning of the next line.
                Some(LineEvent::Line(text)) => {
                    let text = text.trim();
                    let rest = reply_prefixes
                        .iter()
                        .find_map(|start| text.strip_prefix(start).filter(|r| r.is_empty() || r.starts_with(' ')));
                    if let Some(rest) = rest {
                        return Ok(rest.trim().to_owned());
                    }
                    // Words of another connection's line may be mixed into this line (see
                    // `program_runner::abort_until_at_rest`).
                    if text.ends_with("NAK") {
                        return Ok("NAK".to_owned());
                    }
                }
                Some(LineEvent::Noise { bytes }) => {
                    return Err(ControllerError::UnreadableReply { text: format!("{bytes} unreadable bytes") });
                }
                None => return Err(ControllerError::no_answer(line, REPLY_TIMEOUT)),
            }
        }
    }

    /// Reads the messages for the operator. Each kind has one slot, which is overwritten: suitable for
    /// display, not for results.
    pub async fn read_messages(&mut self) -> Result<Vec<String>, ControllerError> {
        let mut messages = Vec::new();
        for key in ["ERROR", "OPERATOR_DISPLAY", "OPERATOR_TEXT"] {
            for _ in 0..8 {
                let text = self.get(key).await?;
                if text == "OK" {
                    break;
                }
                messages.push(text);
            }
        }
        Ok(messages)
    }
}

fn connection_error(address: &LinkAddress, error: LinkError) -> ControllerError {
    match error {
        LinkError::NotListening { .. } => ControllerError::not_ready(
            format!("no linuxcncrsh listens at {address}"),
            "start LinuxCNC and linuxcncrsh (as its display, or in addition to its display); check [controller] tcp",
        ),
        other => other.into(),
    }
}
