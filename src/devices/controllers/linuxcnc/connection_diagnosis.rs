//! Finds out why no linuxcncrsh answers: the port, or another control at the port.

use super::{CONTROL_KIND, LinuxCncConfig};
use crate::controllers::{
    ConnectionDiagnosisRequest, ControllerError, DiagnosisMode, PossibleCause, port_diagnosis, port_scan,
};
use link::{LinkAddress, LinkConfig};

/// Default TCP port of linuxcncrsh.
const DEFAULT_PORT: u16 = 5007;

impl LinuxCncConfig {
    pub(super) async fn diagnose_missing_answer(&self, request: ConnectionDiagnosisRequest<'_>) -> Vec<PossibleCause> {
        let ConnectionDiagnosisRequest { failure, mode, .. } = request;
        let named_address = LinkConfig::Tcp(self.tcp.clone());
        let Ok(address) = named_address.resolve_address() else { return Vec::new() };
        if let Err(error) = link::open_line_link(&address).await {
            let mut link_findings = port_diagnosis::diagnose_open_failure(&named_address, &error.into());
            link_findings.splice(0..0, self.diagnose_default_port(&address, mode).await);
            return link_findings;
        }
        let is_foreign = matches!(
            failure,
            ControllerError::NoAnswer { .. } | ControllerError::UnreadableReply { .. } | ControllerError::Link(_)
        );
        match mode {
            DiagnosisMode::OtherSettings if is_foreign => {
                let found = port_scan::scan_tcp(&named_address, CONTROL_KIND).await;
                let evidence =
                    format!("{failure}; requests in the protocols of other controls also had no valid reply");
                vec![found.unwrap_or_else(|| port_scan::no_known_control_diagnosis(&address.to_string(), &evidence))]
            }
            DiagnosisMode::ConfiguredSettings if is_foreign => {
                let remedy = "compare [controller] tcp and kind with the start command of the control";
                let cause = "wrong port, or another kind of control";
                vec![PossibleCause::suspected(cause, failure.to_string(), remedy).before_search()]
            }
            _ => Vec::new(),
        }
    }

    /// Possible cause: linuxcncrsh listens at its default port on the host of `address`. Searched only with
    /// `OtherSettings`.
    async fn diagnose_default_port(&self, address: &LinkAddress, mode: DiagnosisMode) -> Option<PossibleCause> {
        let LinkAddress::Tcp { host, port } = address else { return None };
        let default_address = LinkAddress::Tcp { host: host.clone(), port: DEFAULT_PORT };
        if mode != DiagnosisMode::OtherSettings || *port == DEFAULT_PORT {
            return None;
        }
        let reply = port_scan::query_linuxcncrsh(&default_address).await?;
        Some(PossibleCause::observed(
            format!("wrong port: linuxcncrsh listens at {default_address}, not at {address}"),
            format!("linuxcncrsh replied `{reply}`"),
            format!("in the machine file, set [controller] tcp = \"{default_address}\""),
        ))
    }
}
