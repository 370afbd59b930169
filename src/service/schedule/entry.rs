//! `[[serve.schedule]]` of the machine file: when a cycle is due, and the conditions of its start.

use std::time::Duration;

use serde::Deserialize;

use super::calendar::Calendar;
use crate::service::key_range::check_key_range;

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
pub enum OverlapPolicy {
    /// Waits for the end of the run, until the latest start.
    #[default]
    Wait,
    /// Skips the slot at once.
    Skip,
}

/// Keys of `[[serve.schedule]]`, before validation.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ScheduleKeys {
    name: String,
    /// Number of the cycle that the schedule starts.
    cycle: u16,
    /// Cron pattern of five fields, e.g. `30 5 * * 1-5`.
    at: String,
    /// Name of the time zone of the pattern, e.g. `Europe/Berlin`.
    zone: String,
    /// Maximum delay of the start after the scheduled time, minutes; default 30.
    latest_min: Option<u32>,
    /// Minimum time for which the control must have executed no program, minutes; 0: no condition.
    #[serde(default)]
    idle_min: u32,
    /// Further conditions that the machine must report.
    #[serde(default)]
    ready: Vec<ReadinessCondition>,
    #[serde(default)]
    overlap: OverlapPolicy,
}

/// One schedule, validated.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "ScheduleKeys")]
pub struct ScheduleEntry {
    pub name: String,
    pub cycle: u16,
    /// Pattern as written in the machine file.
    pub cron_pattern: String,
    /// Name of the time zone as written in the machine file.
    pub zone: String,
    pub calendar: Calendar,
    /// Maximum delay of the start after the scheduled time.
    pub max_start_delay: Duration,
    /// Minimum time for which the control must have executed no program; 0: no condition.
    pub min_idle_time: Duration,
    /// Conditions that the machine must report in addition to the interlocks that `[serve]` demands.
    pub required_conditions: Vec<ReadinessCondition>,
    pub overlap_policy: OverlapPolicy,
}

/// Prefix of the schedule name of starts that a person or a timer requests; the cycle number follows. No schedule of
/// the machine file may have this name.
pub const DUE_REQUEST_SCHEDULE_NAME_PREFIX: &str = "due";

impl TryFrom<ScheduleKeys> for ScheduleEntry {
    type Error = String;

    fn try_from(keys: ScheduleKeys) -> Result<Self, String> {
        let ScheduleKeys { name, cycle, at, zone, latest_min, idle_min, ready, overlap } = keys;
        let is_valid_name = !name.is_empty() && name.chars().count() <= 60 && name != DUE_REQUEST_SCHEDULE_NAME_PREFIX;
        if !is_valid_name || name.chars().any(char::is_control) {
            return Err(format!(
                "name = \"{name}\" of a schedule is not valid: use 1 to 60 printable characters, and not \"{DUE_REQUEST_SCHEDULE_NAME_PREFIX}\""
            ));
        }
        let latest_min = latest_min.unwrap_or(30);
        check_key_range(&format!("latest_min of schedule {name}"), latest_min, 1, 1440)?;
        check_key_range(&format!("idle_min of schedule {name}"), idle_min, 0, 1440)?;
        let calendar = Calendar::new(&at, &zone).map_err(|why| format!("schedule {name}: {why}"))?;
        let [max_delay, min_idle] = [latest_min, idle_min].map(|min| Duration::from_secs(60 * u64::from(min)));
        Ok(Self {
            name,
            cycle,
            cron_pattern: at,
            zone,
            calendar,
            max_start_delay: max_delay,
            min_idle_time: min_idle,
            required_conditions: ready,
            overlap_policy: overlap,
        })
    }
}

/// Checks that each schedule has a unique name and starts one of `cycles`.
///
/// # Errors
/// A schedule has the name of another one, or an unknown cycle.
pub fn validate_schedule_entries(entries: &[ScheduleEntry], cycles: &[u16]) -> Result<(), String> {
    for (index, ScheduleEntry { name, cycle, .. }) in entries.iter().enumerate() {
        if !cycles.contains(cycle) {
            return Err(format!("schedule {name} starts cycle {cycle}, which is not configured"));
        }
        if entries.iter().take(index).any(|other| other.name == *name) {
            return Err(format!("two schedules have the name {name}"));
        }
    }
    Ok(())
}
