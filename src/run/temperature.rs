//! Temperatures at the time of a reading. Thermometers are polled in parallel with the run. A reading waits for no
//! thermometer, and the run continues without the temperatures of thermometers that do not reply.

use std::collections::BTreeMap;

use super::{Run, RunError};
use crate::setup::Thermometers;
use devices::sensors::thermometer::ThermometerPoller;
use machine::record::reading::Temperatures;

/// Poller of the thermometers, and counts since the run began or was resumed.
#[derive(Default)]
pub(super) struct TemperatureLog {
    poller: Option<ThermometerPoller>,
    /// Number of touches and scans; a scan counts once.
    reading_count: u32,
    /// Number of touches and scans without a temperature, for each thermometer that has missed one.
    reading_counts_without_temperature: BTreeMap<String, u32>,
}

impl TemperatureLog {
    /// Starts the reading of the thermometers; waits for the first value of each that answers.
    pub async fn start_polling(&mut self, thermometers: &Thermometers) {
        let watch = thermometers.start_polling();
        watch.wait_for_first_values().await;
        self.poller = Some(watch);
    }

    /// Temperatures at a reading, and a message for each thermometer that misses a reading for the first time in the
    /// run.
    fn count_reading_and_get_temperatures(&mut self) -> (Temperatures, Vec<String>) {
        let Self { poller: watch, reading_count: readings, reading_counts_without_temperature: counts } = self;
        *readings += 1;
        let (mut temperatures, mut messages) = (BTreeMap::new(), Vec::new());
        for (name, said) in watch.iter().flat_map(ThermometerPoller::current_temperatures_c) {
            match said {
                Ok(celsius) => drop(temperatures.insert(name.to_owned(), celsius)),
                Err(why) => {
                    let count = counts.entry(name.to_owned()).or_default();
                    *count += 1;
                    if *count == 1 {
                        messages.push(format!(
                            "thermometer {name} does not reply: {why}; readings have no temperature of {name} until \
                            the thermometer replies again"
                        ));
                    }
                }
            }
        }
        (temperatures.into(), messages)
    }
}

impl Run<'_> {
    /// Temperatures for the newest reading: a touch, or all samples of a scan. Counts this reading, and reports a
    /// thermometer that misses a reading for the first time.
    pub(super) async fn temperatures_c(&mut self) -> Result<Temperatures, RunError> {
        let (temperatures, messages) = self.temperature_log.count_reading_and_get_temperatures();
        self.record_messages(messages).await?;
        Ok(temperatures)
    }

    /// Reports for each thermometer how many readings have no temperature, also if the thermometer replied again later.
    pub(super) async fn report_missing_temperatures(&mut self) -> Result<(), RunError> {
        let TemperatureLog { reading_count: readings, reading_counts_without_temperature: counts, .. } =
            &self.temperature_log;
        let message = |(name, count)| format!("thermometer {name}: {count} of {readings} readings have no temperature");
        let messages: Vec<String> = counts.iter().map(message).collect();
        self.record_messages(messages).await
    }
}
