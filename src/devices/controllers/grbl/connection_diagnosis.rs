//! Finds out why no Grbl answers: the port, its baud rate, or another control at the port.

use super::{CONTROL_KIND, GrblConfig};
use crate::controllers::{
    ConnectionDiagnosisRequest, ControllerError, DiagnosisMode, PossibleCause, port_diagnosis, port_scan,
};
use link::{LinkAddress, LinkError};

impl GrblConfig {
    pub(super) async fn diagnose_missing_answer(&self, request: ConnectionDiagnosisRequest<'_>) -> Vec<PossibleCause> {
        let ConnectionDiagnosisRequest { failure, mode, .. } = request;
        let link_findings = port_diagnosis::diagnose_open_failure(&self.link, failure);
        let Some(received) = describe_received(failure) else { return link_findings };
        let Ok(address) = self.link.resolve_address() else { return link_findings };
        match (mode, &address) {
            (DiagnosisMode::ConfiguredSettings, _) => passive_diagnosis(&address, &received),
            (DiagnosisMode::OtherSettings, LinkAddress::Serial { path, baud }) => {
                self.search_answering_serial_settings(path, *baud, &received).await
            }
            (DiagnosisMode::OtherSettings, LinkAddress::Tcp { .. }) => {
                self.search_other_tcp_control(&address, &received).await
            }
        }
    }

    /// Sends Grbl requests at other baud rates, then requests in other protocols; returns the first cause found.
    async fn search_answering_serial_settings(&self, path: &str, baud: u32, received: &str) -> Vec<PossibleCause> {
        for other in port_scan::BAUD_RATES.into_iter().filter(|rate| *rate != baud) {
            let address = LinkAddress::Serial { path: path.to_owned(), baud: other };
            if let Some(reply) = port_scan::query_grbl(&address).await {
                return vec![wrong_baud_diagnosis(baud, other, &reply)];
            }
        }
        let other = port_scan::scan_serial(path, baud, CONTROL_KIND).await;
        let evidence = || format!("{received}; requests at other baud rates and in Modbus also had no valid reply");
        vec![other.unwrap_or_else(|| port_scan::no_known_control_diagnosis(path, &evidence()))]
    }

    async fn search_other_tcp_control(&self, address: &LinkAddress, received: &str) -> Vec<PossibleCause> {
        let other = port_scan::scan_tcp(&self.link, CONTROL_KIND).await;
        let evidence = || format!("{received}; requests in the protocols of other controls also had no valid reply");
        vec![other.unwrap_or_else(|| port_scan::no_known_control_diagnosis(&address.to_string(), &evidence()))]
    }
}

/// Describes the data that the failed attempt has received; `None` if the error does not concern the answers.
fn describe_received(failure: &ControllerError) -> Option<String> {
    match failure {
        ControllerError::NoAnswer { .. } => Some("no reply".to_owned()),
        ControllerError::UnreadableReply { .. } => Some("the received bytes are not text".to_owned()),
        ControllerError::UnexpectedDevice { state, .. } => Some(state.clone()),
        ControllerError::Link(LinkError::Lost { why, .. }) => Some(why.clone()),
        _ => None,
    }
}

/// Suspected causes that need no further request to the device.
fn passive_diagnosis(address: &LinkAddress, received: &str) -> Vec<PossibleCause> {
    let (cause, remedy) = match address {
        LinkAddress::Serial { baud, .. } => (
            format!("wrong baud rate ({baud}), wrong port, or another kind of control"),
            "compare [controller] baud with the control's manual, or permit the search at other baud rates",
        ),
        LinkAddress::Tcp { .. } => (
            "wrong port, or another kind of control".to_owned(),
            "compare [controller] tcp and kind with the control's manual, or permit the search for other controls",
        ),
    };
    vec![PossibleCause::suspected(cause, received, remedy).before_search()]
}

fn wrong_baud_diagnosis(baud: u32, actual_baud: u32, reply: &str) -> PossibleCause {
    PossibleCause::observed(
        format!("wrong baud rate: the control communicates at {actual_baud} baud, not at {baud}"),
        format!("at {actual_baud} baud the control replies `{reply}`"),
        format!("in the machine file, set [controller] baud = {actual_baud}"),
    )
}
