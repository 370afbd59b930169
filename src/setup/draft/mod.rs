//! Draft of a machine file for an undescribed control, from the data that the control reports. Missing data
//! gets a marked default that the operator corrects.

mod topology;

use std::sync::Arc;

use minijinja::value::Value;
use minijinja::{Environment, context};

use super::{SetupError, controls, prove_mode_text};
use devices::controllers::{
    ConnectionDiagnosisRequest, ControllerConfig, ControllerError, DeviceInfo, DiagnosisMode, PossibleCause,
    ReportedAxisProperties,
};
use link::clock::HostClock;
use machine::Axis;
use machine::record::machine::Machine;
use planning::gcode::Dialect;

const DRAFT_TEMPLATE: &str = include_str!("machine.toml.j2");

/// Data for a draft: `[controller]` as in a machine file, and the user's optional entries.
pub struct MachineFileDraft {
    /// Keys of `[controller]`, with `kind`.
    pub controller_keys: toml::Table,
    /// `None`: the draft gets a name that the operator must replace.
    pub machine_name: Option<String>,
    /// Topology that the user has given; `None`: that of a trunnion table with the axes that the control drives.
    pub topology: Option<String>,
}

impl MachineFileDraft {
    /// Configuration of the control in `[controller]`.
    ///
    /// # Errors
    /// The driver refuses the keys.
    pub fn control_config(&self) -> Result<Arc<dyn ControllerConfig>, SetupError> {
        let mut keys = self.controller_keys.clone();
        let kind = keys.remove("kind");
        let kind = kind.as_ref().and_then(toml::Value::as_str).unwrap_or_default().to_owned();
        let control = controls::configure_control(&kind, toml::Value::Table(keys));
        control.map_err(|error| SetupError::MachineFileDraft { why: error.message().to_owned() })
    }

    /// Opens `control` and reads its device information. Nothing moves. Call inside a tokio runtime.
    ///
    /// # Errors
    /// The control cannot be opened or does not answer.
    pub async fn query_device_info(&self, control: &dyn ControllerConfig) -> Result<DeviceInfo, SetupError> {
        let modes =
            prove_mode_text(&Dialect::from_name(control.dialect())?, &empty_machine(), control.result_log_path())?;
        let controller = control.open(&empty_machine(), modes, Arc::new(HostClock::start())).await?;
        Ok(controller.identify_device().await?)
    }

    /// Possible causes why the query of the device information ended with `failure`, the most likely first.
    pub async fn diagnose_connection_failure(
        &self,
        control: &dyn ControllerConfig,
        failure: &ControllerError,
        mode: DiagnosisMode,
    ) -> Vec<PossibleCause> {
        control.diagnose_connection(ConnectionDiagnosisRequest { machine: &empty_machine(), failure, mode }).await
    }

    /// Text of the machine file.
    ///
    /// # Errors
    /// A topology with an axis that the control does not drive.
    pub fn render(&self, info: &DeviceInfo) -> Result<String, SetupError> {
        let driven: Vec<Axis> = info.axes.keys().copied().collect();
        let topology = self.topology.clone().unwrap_or_else(|| topology::default_topology(&driven));
        let axes = topology::moving_axes(&topology);
        if let Some(missing) = axes.iter().find(|axis| !driven.contains(axis)) {
            let why = format!("the topology contains the axis {missing}, but the control does not have this axis");
            return Err(SetupError::MachineFileDraft { why });
        }
        let reported = |axis: &Axis| axis_template_values(*axis, info.axes.get(axis).copied().unwrap_or_default());
        let axes: Vec<Value> = axes.iter().map(reported).collect();
        let remarks = info.findings.iter().map(|remark| {
            context! {
                hinders => remark.is_blocking,
                what => replace_control_characters(&remark.description),
                remedy => replace_control_characters(&remark.remedy),
            }
        });
        let names = context! {
            version => env!("CARGO_PKG_VERSION"),
            identity => replace_control_characters(&info.identity),
            remarks => remarks.collect::<Vec<_>>(),
            name => quote_toml_string(self.machine_name.as_deref().unwrap_or("my five-axis machine")),
            in_words => topology::describe_topology(&topology),
            topology => quote_toml_string(&topology),
            axes,
            controller => self.controller_keys.iter().map(|(key, value)| format!("{key} = {value}")).collect::<Vec<_>>(),
        };
        let mut environment = Environment::new();
        environment.set_undefined_behavior(minijinja::UndefinedBehavior::Strict);
        let rendered = environment.render_str(DRAFT_TEMPLATE, names);
        rendered.map(|text| text + "\n").map_err(|error| SetupError::MachineFileDraft { why: error.to_string() })
    }
}

fn quote_toml_string(text: &str) -> String {
    toml::Value::from(text).to_string()
}

/// Replaces control characters by spaces, because the text of the control is written into a one-line comment.
fn replace_control_characters(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// Template values of one axis; linear axes in mm, with the resolution in µm; rotary axes in degrees, whose resolution
/// is not used. Without limits from the control the range is kept short: ±100 mm, ±360° for C, ±90° for A and B; a
/// reported travel length is centred at zero.
fn axis_template_values(axis: Axis, reported: ReportedAxisProperties) -> Value {
    let turns = !axis.is_linear();
    let half = match axis {
        Axis::C => 360.0,
        _ if turns => 90.0,
        _ => 100.0,
    };
    let half = reported.travel_length.map_or(half, |travel| travel / 2.0);
    let ends = reported.travel_min.zip(reported.travel_max);
    let (min, max) = ends.unwrap_or((-half, half));
    // Steps are decimal fractions of a millimetre.
    let resolution = reported.resolution.map(|step| (step * 1e6).round() / 1e3);
    context! {
        letter => axis.letter(),
        turns,
        positive_said => reported.positive_sense.is_some(),
        positive => format!("{:?}", reported.positive_sense.unwrap_or_default()).to_lowercase(),
        unit => if turns { "degrees" } else { "mm" },
        unhomed => turns && reported.has_homing == Some(false),
        homing_unknown => turns && reported.has_homing.is_none(),
        ends => ends.is_some(),
        travel => reported.travel_length,
        min,
        max,
        rapid => reported.rapid_per_min.unwrap_or(1_000.0),
        rapid_said => reported.rapid_per_min.is_some(),
        acceleration => reported.acceleration_per_s2.unwrap_or(100.0),
        acceleration_said => reported.acceleration_per_s2.is_some(),
        resolution,
    }
}

/// A machine without any data, to identify the control only.
fn empty_machine() -> Machine {
    Machine {
        name: "not described yet".to_owned(),
        topology: String::new(),
        axes: Default::default(),
        tool_mm: [0.0; 3],
        drift_um_per_h: 0.0,
        squareness_urad: 0.0,
    }
}

#[cfg(test)]
mod tests;
