//! Keys of `[controller]` of kind `linuxcnc`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;

use super::files::result_log_path;
use super::{
    CONTROL_KIND, LinuxCncDriver, LinuxCncSettings, SamplerClient, ToolCentreCommands, ToolCentreSettings, sampler,
};
use crate::controllers::{
    ConnectionDiagnosisRequest, ControlDescription, Controller, ControllerConfig, DiagnosisFuture, OpenFuture,
};
use link::Clock;
use link::{HostPort, LinkAddress};
use machine::Axis;
use machine::record::machine::Machine;
use planning::proof::ProvenModeText;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinuxCncConfig {
    /// Address of linuxcncrsh.
    #[serde(default = "default_address")]
    pub(super) tcp: HostPort,
    /// Folder of the programs and their result logs; the control must see the same folder.
    program_dir: PathBuf,
    /// INI file of the control, for values that the control does not report.
    ini: Option<PathBuf>,
    #[serde(default = "default_dialect")]
    dialect: String,
    /// Sampler that timestamps positions during motion.
    sampler: Option<sampler::SamplerConfig>,
    /// Commands that switch tool centre point control.
    tool_centre: Option<ToolCentreCommands>,
}

/// Port 5007 is linuxcncrsh's own default.
fn default_address() -> HostPort {
    HostPort::local(5007)
}

fn default_dialect() -> String {
    "linuxcnc".to_owned()
}

impl LinuxCncConfig {
    pub const DESCRIPTION: ControlDescription = ControlDescription {
        kind: CONTROL_KIND,
        hold_command_hint: "LinuxCNC: abort through linuxcncrsh",
        axis_direction_hint: Some("LinuxCNC: the sign of SCALE of the joint"),
        steps_per_unit_hint: Some("LinuxCNC: SCALE of the joint"),
    };
}

impl ControllerConfig for LinuxCncConfig {
    fn dialect(&self) -> &str {
        &self.dialect
    }

    fn result_log_path(&self) -> Option<String> {
        Some(result_log_path(&self.program_dir))
    }

    fn configuration_file(&self) -> Option<&Path> {
        self.ini.as_deref()
    }

    fn describe_address(&self) -> String {
        format!("{}, with files in {}", LinkAddress::from(&self.tcp), self.program_dir.display())
    }

    fn open<'a>(&'a self, machine: &'a Machine, modes: ProvenModeText, clock: Arc<dyn Clock>) -> OpenFuture<'a> {
        Box::pin(async move {
            let axes: Vec<Axis> = machine.axes.keys().copied().collect();
            let sampler = match &self.sampler {
                Some(sampler) => Some(SamplerClient::open(sampler, &axes, clock).await?),
                None => None,
            };
            let settings = LinuxCncSettings {
                address: (&self.tcp).into(),
                shared_directory: self.program_dir.clone(),
                axes,
                ini_path: self.ini.clone(),
            };
            let (driver, halt) = LinuxCncDriver::open(settings, modes).await?;
            let tool_centre = self
                .tool_centre
                .clone()
                .map(|commands| ToolCentreSettings { commands, stylus_length_mm: -machine.tool_mm[2] });
            Ok(Controller::spawn(driver.with_sampler(sampler).with_tool_centre(tool_centre), halt))
        })
    }

    fn diagnose_connection<'a>(&'a self, request: ConnectionDiagnosisRequest<'a>) -> DiagnosisFuture<'a> {
        Box::pin(self.diagnose_missing_answer(request))
    }
}
