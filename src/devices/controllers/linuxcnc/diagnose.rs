//! Finds out why no linuxcncrsh answers: the port, or another control at the port.

use super::{Config, KIND};
use crate::controllers::{ControllerError, Diagnosis, Leave, port, port_scan};
use link::{Address, Named};
use machine::record::machine::Machine;

/// Default TCP port of linuxcncrsh.
const USUAL_PORT: u16 = 5007;

impl Config {
    pub(super) async fn suspects(
        &self,
        _machine: &Machine,
        failed: &ControllerError,
        leave: Leave,
    ) -> Vec<Diagnosis> {
        let at = Named::Tcp(self.tcp.clone());
        let Ok(address) = at.address() else { return Vec::new() };
        if let Err(error) = link::open(&address).await {
            let mut closed = port::suspects(&at, &error.into());
            closed.splice(0..0, self.usual_port(&address, leave).await);
            return closed;
        }
        let strange = matches!(
            failed,
            ControllerError::NoAnswer { .. }
                | ControllerError::Garbled { .. }
                | ControllerError::Link(_)
        );
        match leave {
            Leave::Ask if strange => {
                let other = port_scan::on_tcp(&at, KIND).await;
                let because = format!("{failed}; asked in the languages of other controls as well");
                vec![
                    other.unwrap_or_else(|| {
                        port_scan::no_known_device(&address.to_string(), &because)
                    }),
                ]
            }
            Leave::Listen if strange => vec![Diagnosis {
                seen: false,
                vague: true,
                what: "wrong port, or another kind of control".to_owned(),
                because: failed.to_string(),
                remedy: "compare [controller] tcp and kind with how the control was started"
                    .to_owned(),
            }],
            _ => Vec::new(),
        }
    }

    /// Suspected cause: linuxcncrsh listens at its default port on the same computer.
    async fn usual_port(&self, address: &Address, leave: Leave) -> Option<Diagnosis> {
        let Address::Tcp { host, port } = address else { return None };
        let usual = Address::Tcp { host: host.clone(), port: USUAL_PORT };
        if leave != Leave::Ask || *port == USUAL_PORT {
            return None;
        }
        let said = port_scan::greets_as_rsh(&usual).await?;
        Some(Diagnosis {
            seen: true,
            vague: false,
            what: format!("wrong port: linuxcncrsh listens at {usual}, not at {address}"),
            because: format!("it says `{said}`"),
            remedy: format!("in the machine file: [controller] tcp = \"{usual}\""),
        })
    }
}
