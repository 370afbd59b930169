//! Draft of a machine file for an undescribed control, from the data that the control reports. Missing data
//! gets a marked default that the operator corrects.

mod topology;

use std::sync::Arc;

use minijinja::Environment;
use minijinja::value::Value;

use super::{SetupError, controls, modes};
use devices::controllers::{ControllerError, DeviceInfo, Diagnosis, Leave, Named, ReportedAxis};
use link::clock::HostClock;
use machine::Axis;
use machine::record::machine::{Machine, Sense};
use planning::gcode::Dialect;

const TEMPLATE: &str = include_str!("machine.toml.j2");

/// Data for a draft: `[controller]` as in a machine file, and the user's optional entries.
pub struct Draft {
    /// Keys of `[controller]`, with `kind`.
    pub controller: toml::Table,
    pub name: Option<String>,
    /// Topology, if the user has given it.
    pub topology: Option<String>,
}

impl Draft {
    /// Configuration of the control in `[controller]`.
    ///
    /// # Errors
    /// The driver refuses the keys.
    pub fn control(&self) -> Result<Arc<dyn Named>, SetupError> {
        let mut keys = self.controller.clone();
        let kind = keys.remove("kind");
        let kind = kind.as_ref().and_then(toml::Value::as_str).unwrap_or_default().to_owned();
        let control = controls::configure(&kind, toml::Value::Table(keys));
        control.map_err(|error| SetupError::Draft { why: error.message().to_owned() })
    }

    /// Opens `control` and reads its device information. Nothing moves. Call inside a tokio runtime.
    ///
    /// # Errors
    /// The control cannot be opened or does not answer.
    pub async fn introduce(&self, control: &dyn Named) -> Result<DeviceInfo, SetupError> {
        let modes = modes(&Dialect::named(control.dialect())?, &nobodys(), control.log())?;
        let controller = control.open(&nobodys(), modes, Arc::new(HostClock::start())).await?;
        Ok(controller.introduce().await?)
    }

    /// Possible causes why [`Self::introduce`] has `failed`.
    pub async fn diagnose(
        &self,
        control: &dyn Named,
        failed: &ControllerError,
        leave: Leave,
    ) -> Vec<Diagnosis> {
        control.diagnose(&nobodys(), failed, leave).await
    }

    /// Text of the machine file.
    ///
    /// # Errors
    /// A topology with an axis that the control does not drive.
    pub fn write(&self, said: &DeviceInfo) -> Result<String, SetupError> {
        let driven: Vec<Axis> = said.axes.keys().copied().collect();
        let topology = match &self.topology {
            Some(topology) => topology.clone(),
            None => topology::usual(&driven),
        };
        let axes = topology::axes(&topology);
        if let Some(missing) = axes.iter().find(|axis| !driven.contains(axis)) {
            let why = format!("the topology names {missing}, which the control does not drive");
            return Err(SetupError::Draft { why });
        }
        let says = |axis: &Axis| lines(*axis, said.axes.get(axis).copied().unwrap_or_default());
        let axes: Vec<Value> = axes.iter().map(says).collect();
        let remarks = said.remarks.iter().map(|remark| {
            Value::from_pairs([
                ("hinders", Value::from(remark.hinders)),
                ("what", Value::from(one_line(&remark.what))),
                ("remedy", Value::from(one_line(&remark.remedy))),
            ])
        });
        let name = self.name.clone().unwrap_or_else(|| "my five-axis machine".to_owned());
        let names = Value::from_pairs([
            ("version", Value::from(env!("CARGO_PKG_VERSION"))),
            ("identity", Value::from(one_line(&said.identity))),
            ("remarks", remarks.collect()),
            ("name", Value::from(quoted(&name))),
            ("in_words", Value::from(topology::in_words(&topology))),
            ("topology", Value::from(quoted(&topology))),
            ("axes", Value::from(axes)),
            ("controller", self.controller.iter().map(key_and_value).collect()),
        ]);
        let mut text = render(names)?;
        text.push('\n');
        Ok(text)
    }
}

fn render(names: Value) -> Result<String, SetupError> {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(minijinja::UndefinedBehavior::Strict);
    let rendered = environment.render_str(TEMPLATE, names);
    rendered.map_err(|error| SetupError::Draft { why: error.to_string() })
}

fn key_and_value((key, value): (&String, &toml::Value)) -> Value {
    Value::from(format!("{key} = {value}"))
}

fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

/// Replaces control characters, as the control's text is written into a comment.
fn one_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// Template values of one axis. Without limits from the control the range is kept short.
fn lines(axis: Axis, says: ReportedAxis) -> Value {
    let turns = !axis.is_linear();
    let half = match axis {
        Axis::C => 360.0,
        _ if turns => 90.0,
        _ => 100.0,
    };
    let half = says.travel.map_or(half, |travel| travel / 2.0);
    let ends = says.min.zip(says.max);
    let (min, max) = ends.unwrap_or((-half, half));
    // Steps are decimal fractions of a millimetre.
    let resolution = says.step.map(|step| (step * 1e6).round() / 1e3);
    Value::from_pairs([
        ("letter", Value::from(axis.letter())),
        ("turns", Value::from(turns)),
        ("positive_said", Value::from(says.positive.is_some())),
        ("positive", Value::from(positive(says.positive.unwrap_or_default()))),
        ("unit", Value::from(if turns { "degrees" } else { "mm" })),
        ("unhomed", Value::from(turns && says.homes == Some(false))),
        ("homing_unknown", Value::from(turns && says.homes.is_none())),
        ("ends", Value::from(ends.is_some())),
        ("travel", Value::from(says.travel)),
        ("min", Value::from(min)),
        ("max", Value::from(max)),
        ("rapid", Value::from(says.rapid_per_min.unwrap_or(1_000.0))),
        ("rapid_said", Value::from(says.rapid_per_min.is_some())),
        ("acceleration", Value::from(says.acceleration_per_s2.unwrap_or(100.0))),
        ("acceleration_said", Value::from(says.acceleration_per_s2.is_some())),
        ("resolution", Value::from(resolution)),
    ])
}

fn positive(sense: Sense) -> &'static str {
    match sense {
        Sense::Iso => "iso",
        Sense::Reversed => "reversed",
    }
}

/// A machine without any data, to identify the control only.
fn nobodys() -> Machine {
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
