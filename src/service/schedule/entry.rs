//! `[[serve.schedule]]` of the machine file: when a cycle is due, and the conditions of its start.

use std::time::Duration;

use serde::Deserialize;

use super::calendar::Calendar;

/// Condition of a scheduled start beyond the `demand` of `[serve]`; the machine reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReadinessCondition {
    /// The probe is in the spindle and operational.
    Probe,
    /// The artefact is at the position of the machine file.
    Artefact,
    /// The machine and its surroundings are at the agreed temperature.
    Temperature,
}

/// Behaviour if a run is in progress at the time of a slot.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overlap {
    /// Waits for the end of the run, until the latest start.
    #[default]
    Wait,
    Skip,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    name: String,
    cycle: u16,
    at: String,
    zone: String,
    #[serde(default = "latest_min")]
    latest_min: u32,
    #[serde(default)]
    idle_min: u32,
    #[serde(default)]
    ready: Vec<ReadinessCondition>,
    #[serde(default)]
    overlap: Overlap,
}

/// One schedule, validated.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Entry {
    pub name: String,
    pub cycle: u16,
    /// Pattern as written in the machine file.
    pub at: String,
    pub zone: String,
    pub calendar: Calendar,
    /// Maximum delay of the start after the scheduled time.
    pub latest: Duration,
    /// Minimum time for which the control must have executed no program.
    pub idle: Duration,
    pub ready: Vec<ReadinessCondition>,
    pub overlap: Overlap,
}

/// Schedule name of starts that a person or a timer requests.
pub const BY_CALL: &str = "due";

fn latest_min() -> u32 {
    30
}

impl TryFrom<Keys> for Entry {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let Keys { name, cycle, at, zone, latest_min, idle_min, ready, overlap } = keys;
        let sound = !name.is_empty() && name.chars().count() <= 60 && name != BY_CALL;
        if !sound || name.chars().any(char::is_control) {
            return Err(format!(
                "name = \"{name}\" of a schedule: a few letters, and not \"{BY_CALL}\""
            ));
        }
        if !(1..=1440).contains(&latest_min) {
            return Err(format!("latest_min of schedule {name} is {latest_min}; from 1 to 1440"));
        }
        if idle_min > 1440 {
            return Err(format!("idle_min of schedule {name} is {idle_min}; up to 1440"));
        }
        let calendar =
            Calendar::new(&at, &zone).map_err(|why| format!("schedule {name}: {why}"))?;
        let [latest, idle] =
            [latest_min, idle_min].map(|min| Duration::from_secs(60 * u64::from(min)));
        Ok(Self { name, cycle, at, zone, calendar, latest, idle, ready, overlap })
    }
}

/// Checks that each schedule has a unique name and starts one of `cycles`.
///
/// # Errors
/// A schedule has the name of another one, or an unknown cycle.
pub fn check(entries: &[Entry], cycles: &[u16]) -> Result<(), String> {
    for (index, Entry { name, cycle, .. }) in entries.iter().enumerate() {
        if !cycles.contains(cycle) {
            return Err(format!("schedule {name} starts cycle {cycle}, which there is not"));
        }
        if entries.iter().take(index).any(|other| other.name == *name) {
            return Err(format!("there are two schedules {name}"));
        }
    }
    Ok(())
}
