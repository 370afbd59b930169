//! Keys of `[controller]` of kind `grbl`.

use std::path::PathBuf;
use std::sync::Arc;

use serde::Deserialize;

use super::{CONTROL_KIND, GrblDriver};
use crate::controllers::{
    ConnectionDiagnosisRequest, ControlDescription, Controller, ControllerConfig, DiagnosisFuture, OpenFuture,
};
use link::Clock;
use link::{HostPort, LinkKeys};
use machine::record::machine::Machine;
use planning::proof::ProvenModeText;

const DEFAULT_BAUD: u32 = 115_200;

/// Keys of `[controller]` of kind `grbl`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GrblConfigKeys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    tcp: Option<HostPort>,
    #[serde(default = "default_dialect")]
    dialect: String,
}

fn default_dialect() -> String {
    "grbl".to_owned()
}

#[derive(Debug, Deserialize)]
#[serde(try_from = "GrblConfigKeys")]
pub struct GrblConfig {
    pub(super) link: link::LinkConfig,
    dialect: String,
}

impl TryFrom<GrblConfigKeys> for GrblConfig {
    type Error = String;

    fn try_from(keys: GrblConfigKeys) -> Result<Self, String> {
        let GrblConfigKeys { serial, serial_id, baud, tcp, dialect } = keys;
        let link = link::LinkConfig::from_keys(LinkKeys { serial, serial_id, tcp, baud }, DEFAULT_BAUD)?;
        Ok(Self { link, dialect })
    }
}

impl GrblConfig {
    pub const DESCRIPTION: ControlDescription = ControlDescription {
        kind: CONTROL_KIND,
        hold_command_hint: "grblHAL: real-time command `!`",
        axis_direction_hint: Some("grblHAL: $3"),
        steps_per_unit_hint: Some("grblHAL: $100 and following, in axis order"),
    };
}

impl ControllerConfig for GrblConfig {
    fn dialect(&self) -> &str {
        &self.dialect
    }

    fn describe_address(&self) -> String {
        self.link.describe()
    }

    fn open<'a>(&'a self, machine: &'a Machine, modes: ProvenModeText, _clock: Arc<dyn Clock>) -> OpenFuture<'a> {
        Box::pin(async move {
            let link = link::open_line_link(&self.link.resolve_address()?).await?;
            let (driver, halt) = GrblDriver::new(link, machine, modes);
            Ok(Controller::spawn(driver, halt))
        })
    }

    fn diagnose_connection<'a>(&'a self, request: ConnectionDiagnosisRequest<'a>) -> DiagnosisFuture<'a> {
        Box::pin(self.diagnose_missing_answer(request))
    }
}
