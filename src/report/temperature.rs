//! Temperatures over a run: mean, range, and change from the first reading to the last, and their curves.

use std::collections::BTreeMap;

use super::figure::TemperatureCurves;
use super::number::format_fixed;
use super::rows::NameTextRows;
use machine::record::reading::Reading;

/// Decimals of a temperature in °C; thermometers at machines are not more accurate.
const TEMPERATURE_DECIMALS: usize = 2;
/// Maximum number of points of a curve, apart from its last point, which is always kept.
const MAX_CURVE_POINTS: usize = 200;

/// One row per thermometer with a value.
pub fn temperature_rows(readings: &[Reading]) -> NameTextRows {
    let row = |(name, values): (&str, Vec<TimedTemperature>)| (name.to_owned(), describe_temperatures(&values));
    values_by_thermometer(readings).into_iter().map(row).collect()
}

/// Temperatures of each thermometer over the time since the first reading, s.
pub fn temperature_curves(readings: &[Reading]) -> TemperatureCurves {
    let begin_s = readings.first().map_or(0.0, |first| first.t_s);
    let curve = |values: Vec<TimedTemperature>| {
        // More values than a picture can show are thinned out.
        let every = values.len().div_ceil(MAX_CURVE_POINTS).max(1);
        let last = values.last().filter(|_| !(values.len().max(1) - 1).is_multiple_of(every));
        let shown = values.iter().step_by(every).chain(last);
        shown.map(|value| (value.t_s - begin_s, Some(value.celsius))).collect()
    };
    values_by_thermometer(readings).into_iter().map(|(name, values)| (name.to_owned(), curve(values))).collect()
}

/// Temperature at the time of a reading.
#[derive(Debug, Clone, Copy)]
struct TimedTemperature {
    t_s: f64,
    celsius: f64,
}

/// Temperatures of each thermometer in the order of the readings; a scan counts once.
fn values_by_thermometer(readings: &[Reading]) -> BTreeMap<&str, Vec<TimedTemperature>> {
    let mut by_thermometer = BTreeMap::<&str, Vec<TimedTemperature>>::new();
    // All samples of a scan have the temperature of the scan.
    let scans = readings.chunk_by(|one, next| (one.step, one.repeat) == (next.step, next.repeat));
    for first in scans.filter_map(<[Reading]>::first) {
        for (name, celsius) in first.temperatures_c.iter() {
            by_thermometer.entry(name).or_default().push(TimedTemperature { t_s: first.t_s, celsius });
        }
    }
    by_thermometer
}

fn describe_temperatures(values: &[TimedTemperature]) -> String {
    let all: Vec<f64> = values.iter().map(|value| value.celsius).collect();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    let least = all.iter().copied().fold(f64::INFINITY, f64::min);
    let most = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let change = all.last().zip(all.first()).map_or(0.0, |(last, first)| last - first);
    let [mean, least, most, by] = [mean, least, most, change].map(|value| format_fixed(value, TEMPERATURE_DECIMALS));
    let sign = if change > 0.0 { "+" } else { "" };
    let count = all.len();
    format!(
        "mean {mean} °C, from {least} to {most} °C, change {sign}{by} K from the first to the last of {count} readings"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading_with_temperatures(step: u32, said: &[(&str, f64)]) -> Reading {
        let all: BTreeMap<String, f64> = said.iter().map(|(name, celsius)| ((*name).to_owned(), *celsius)).collect();
        Reading {
            step,
            repeat: 0,
            position: Default::default(),
            value_mm: None,
            sensor: "probe".to_owned(),
            t_s: 0.0,
            flag: Default::default(),
            temperatures_c: all.into(),
        }
    }

    #[test]
    fn scan_counts_once_and_missing_temperatures_do_not_count() {
        let touches = [
            reading_with_temperatures(0, &[("spindle", 21.0), ("table", 20.0)]),
            reading_with_temperatures(1, &[("spindle", 24.5)]),
            reading_with_temperatures(2, &[("spindle", 22.0), ("table", 19.25)]),
            reading_with_temperatures(2, &[("spindle", 22.0), ("table", 19.25)]),
            reading_with_temperatures(2, &[("spindle", 22.0), ("table", 19.25)]),
            reading_with_temperatures(3, &[]),
        ];
        let rows = temperature_rows(&touches);
        let wanted = [
            (
                "spindle",
                "mean 22.50 °C, from 21.00 to 24.50 °C, change +1.00 K from the first to the last of 3 \
                readings",
            ),
            (
                "table",
                "mean 19.62 °C, from 19.25 to 20.00 °C, change −0.75 K from the first to the last of 2 \
                readings",
            ),
        ];
        assert_eq!(rows, wanted.map(|(name, said)| (name.to_owned(), said.to_owned())));
    }
}
