//! Keys of `[controller]` of kind `grbl`.

use std::path::PathBuf;
use std::sync::Arc;

use serde::Deserialize;

use super::Grbl;
use crate::controllers::{Controller, ControllerError, Diagnosing, Leave, Named, Opening};
use link::Clock;
use link::HostPort;
use machine::record::machine::Machine;
use planning::proof::ProvenModes;

const USUAL_BAUD: u32 = 115_200;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    tcp: Option<HostPort>,
    #[serde(default = "dialect")]
    dialect: String,
}

fn dialect() -> String {
    "grbl".to_owned()
}

#[derive(Debug, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Config {
    pub(super) link: link::Named,
    dialect: String,
}

impl TryFrom<Keys> for Config {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let Keys { serial, serial_id, baud, tcp, dialect } = keys;
        let link = link::Named::of((serial, serial_id, tcp), baud, USUAL_BAUD)?;
        Ok(Self { link, dialect })
    }
}

impl Named for Config {
    fn dialect(&self) -> &str {
        &self.dialect
    }

    fn at(&self) -> String {
        self.link.in_full()
    }

    fn open<'a>(
        &'a self,
        machine: &'a Machine,
        modes: ProvenModes,
        _clock: Arc<dyn Clock>,
    ) -> Opening<'a> {
        Box::pin(async move {
            let link = link::open(&self.link.address()?).await?;
            let (driver, halt) = Grbl::new(link, machine, modes);
            Ok(Controller::spawn(driver, halt))
        })
    }

    fn diagnose<'a>(
        &'a self,
        machine: &'a Machine,
        failed: &'a ControllerError,
        leave: Leave,
    ) -> Diagnosing<'a> {
        Box::pin(self.suspects(machine, failed, leave))
    }
}
