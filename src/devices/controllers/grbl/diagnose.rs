//! Finds out why no Grbl answers: the port, its baud rate, or another control at the port.

use super::{Config, KIND};
use crate::controllers::{ControllerError, Diagnosis, Leave, port, port_scan};
use link::{Address, LinkError};
use machine::record::machine::Machine;

impl Config {
    pub(super) async fn suspects(
        &self,
        _machine: &Machine,
        failed: &ControllerError,
        leave: Leave,
    ) -> Vec<Diagnosis> {
        let closed = port::suspects(&self.link, failed);
        let Some(heard) = heard(failed) else { return closed };
        let Ok(address) = self.link.address() else { return closed };
        match (leave, &address) {
            (Leave::Listen, _) => from_far(&address, &heard),
            (Leave::Ask, Address::Serial { path, baud }) => self.at_port(path, *baud, &heard).await,
            (Leave::Ask, Address::Tcp { .. }) => self.at_socket(&address, &heard).await,
        }
    }

    async fn at_port(&self, path: &str, baud: u32, heard: &str) -> Vec<Diagnosis> {
        for other in port_scan::SPEEDS.into_iter().filter(|speed| *speed != baud) {
            let address = Address::Serial { path: path.to_owned(), baud: other };
            if let Some(said) = port_scan::greets_as_grbl(&address).await {
                return vec![wrong_speed(baud, other, &said)];
            }
        }
        let other = port_scan::on_serial(path, baud, KIND).await;
        let because = || format!("{heard}; asked at other speeds and in Modbus as well");
        vec![other.unwrap_or_else(|| port_scan::no_known_device(path, &because()))]
    }

    async fn at_socket(&self, address: &Address, heard: &str) -> Vec<Diagnosis> {
        let other = port_scan::on_tcp(&self.link, KIND).await;
        let because = || format!("{heard}; asked in the languages of other controls as well");
        vec![other.unwrap_or_else(|| port_scan::no_known_device(&address.to_string(), &because()))]
    }
}

/// Describes what the failed attempt has received; `None` if the error does not concern the answers.
fn heard(failed: &ControllerError) -> Option<String> {
    match failed {
        ControllerError::NoAnswer { .. } => Some("nothing came".to_owned()),
        ControllerError::Garbled { .. } => Some("bytes came that are no text".to_owned()),
        ControllerError::UnexpectedDevice { state, .. } => Some(state.clone()),
        ControllerError::Link(LinkError::Lost { why, .. }) => Some(why.clone()),
        _ => None,
    }
}

/// Suspected causes that need no further request to the device.
fn from_far(address: &Address, heard: &str) -> Vec<Diagnosis> {
    let (what, remedy) = match address {
        Address::Serial { baud, .. } => (
            format!("wrong speed ({baud} baud), wrong port, or another kind of control"),
            "compare [controller] baud with the control's manual, or let other speeds be tried",
        ),
        Address::Tcp { .. } => (
            "wrong port, or another kind of control".to_owned(),
            "compare [controller] tcp and kind with the control's manual, or let others be tried",
        ),
    };
    vec![Diagnosis {
        seen: false,
        vague: true,
        what,
        because: heard.to_owned(),
        remedy: remedy.to_owned(),
    }]
}

fn wrong_speed(baud: u32, right: u32, said: &str) -> Diagnosis {
    Diagnosis {
        seen: true,
        vague: false,
        what: format!("wrong baud rate: the control speaks at {right} baud, not at {baud}"),
        because: format!("at {right} baud it answers `{said}`"),
        remedy: format!("in the machine file: [controller] baud = {right}"),
    }
}
