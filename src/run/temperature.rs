//! Temperatures at the time of a reading. Thermometers are read in parallel to the run, which waits for none
//! and continues without those that do not answer.

use std::collections::BTreeMap;

use super::{Run, RunError};
use crate::setup::Thermometers;
use devices::sensors::thermometer::Watch;
use machine::record::event::Event;
use machine::record::reading::Temperatures;

#[derive(Default)]
pub(super) struct TemperatureLog {
    watch: Option<Watch>,
    readings: u32,
    /// Number of readings without a temperature, for each thermometer.
    missed: BTreeMap<String, u32>,
}

impl TemperatureLog {
    /// Starts the reading of the thermometers; waits for the first value of each that answers.
    pub async fn begin(&mut self, thermometers: &Thermometers) {
        let watch = thermometers.watch();
        watch.begun().await;
        self.watch = Some(watch);
    }

    /// Temperatures at a reading, and the cause for each thermometer that does not answer for the first time.
    fn at_a_reading(&mut self) -> (Temperatures, Vec<(String, String)>) {
        let Self { watch, readings, missed } = self;
        *readings += 1;
        let (mut felt, mut away) = (BTreeMap::new(), Vec::new());
        for (name, said) in watch.iter().flat_map(Watch::now) {
            match said {
                Ok(celsius) => drop(felt.insert(name.to_owned(), celsius)),
                Err(why) => {
                    let count = missed.entry(name.to_owned()).or_default();
                    *count += 1;
                    away.extend((*count == 1).then(|| (name.to_owned(), why)));
                }
            }
        }
        (felt.into(), away)
    }
}

impl Run<'_> {
    /// Temperatures for the newest reading: a touch, or all samples of a scan.
    pub(super) async fn temperatures_c(&mut self) -> Result<Temperatures, RunError> {
        let (felt, away) = self.warmth.at_a_reading();
        for (name, why) in away {
            let text = format!(
                "thermometer {name} says nothing: {why}; readings have no temperature of it until it is back"
            );
            self.note(Event::Announced { text }).await?;
        }
        Ok(felt)
    }

    /// Reports how many readings each thermometer has missed, if any: it may have answered again later.
    pub(super) async fn tell_of_thermometers(&mut self) -> Result<(), RunError> {
        let TemperatureLog { readings, missed, .. } = &self.warmth;
        let told = missed.iter().map(|(name, count)| {
            format!("thermometer {name}: {count} of {readings} readings are without it")
        });
        for text in told.collect::<Vec<_>>() {
            self.note(Event::Announced { text }).await?;
        }
        Ok(())
    }
}
