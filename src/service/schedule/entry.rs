//! `[[serve.schedule]]` of the machine file: what is due when, and what must hold before it starts.

use std::time::Duration;

use serde::Deserialize;

use super::calendar::Calendar;

/// What a cycle of the schedule needs beyond the `demand` of `[serve]`. The machine tells it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Need {
    /// The probe is in the spindle and works.
    Probe,
    /// The artefact stands where the machine file says.
    Artefact,
    /// The machine and its surroundings are at the temperature that was agreed.
    Temperature,
}

/// When a run is on at the time of a slot.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overlap {
    /// Until the latest start.
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
    ready: Vec<Need>,
    #[serde(default)]
    overlap: Overlap,
}

/// One schedule, found sound.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Entry {
    pub name: String,
    pub cycle: u16,
    /// As it was written.
    pub at: String,
    pub zone: String,
    pub calendar: Calendar,
    /// After its time nothing starts any more.
    pub latest: Duration,
    /// The control must have executed no program for so long.
    pub idle: Duration,
    pub ready: Vec<Need>,
    pub overlap: Overlap,
}

/// Of what a person or a timer asks to start as if it were on the schedule.
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

/// Each has a name of its own, and starts one of these `cycles`.
///
/// # Errors
/// Which has not.
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
