//! Checks that each sensor answers with plausible samples. Nothing moves.

use std::time::Instant;

use super::{Check, Ended, Part, thermometers};
use crate::setup::machine_file::SensorEntry;
use devices::sensors::{Prepared, Sample, SensorError};
use machine::record::reading::Flag;

/// Duration of the test of a sensor, s, and its minimum and maximum number of samples.
const LISTEN_S: f64 = 0.5;
const FEWEST: u32 = 20;
const MOST: u32 = 500;
/// Maximum ratio of the measured noise to the declared noise. More indicates another sensor, or another
/// mounting place.
const NOISY: f64 = 5.0;
/// Maximum relative deviation of the sample rate. The computer may be late with the first or the last sample.
const OFF_RATE: f64 = 0.2;

/// A fault and its remedy.
type Mistake = (String, &'static str);

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    for entry in &check.file.sensors {
        check.go_on()?;
        let since = Instant::now();
        let name = format!("{} ({})", entry.sensor.name, entry.reached.at());
        match listen(check, &entry.sensor.name).await {
            Ok((prepared, samples)) => match mistake(entry, &samples) {
                Some((what, remedy)) => {
                    check.failed(Part::Sensors, since, format!("{name} {what}"), remedy);
                }
                None => check.well(Part::Sensors, since, told(&name, &prepared, &samples)),
            },
            Err(error) => {
                let what = format!("{name}: {error}");
                check.failed(Part::Sensors, since, what, error.remedy());
            }
        }
    }
    thermometers::look(check).await
}

async fn listen(check: &Check<'_>, name: &str) -> Result<(Prepared, Vec<Sample>), SensorError> {
    let devices = check.devices.as_ref().ok_or(SensorError::Gone)?;
    let sensor = devices.sensors.open(name).await?;
    let prepared = sensor.prepare().await?;
    let count = (prepared.rate_hz * LISTEN_S).clamp(FEWEST.into(), MOST.into());
    let samples = sensor.take(count as u32).await?;
    Ok((prepared, samples))
}

fn mistake(
    SensorEntry { sensor, rate_hz, .. }: &SensorEntry,
    samples: &[Sample],
) -> Option<Mistake> {
    let values = values(samples);
    lost(samples)
        .or_else(|| scatter(sensor.noise_um?, &values))
        .or_else(|| rate((*rate_hz)?, samples))
}

/// Fault of missing samples.
fn lost(samples: &[Sample]) -> Option<Mistake> {
    let missing = missing(samples);
    let jumps = samples.iter().filter(|sample| sample.missing > 0).count();
    if 2 * jumps > samples.len() {
        let what = format!(
            "counts on by more than one from most samples to the next: {missing} would be missing beside {}",
            samples.len()
        );
        let remedy = "compare `counter` of its layout with its manual (place, width, order; a counter may \
                      count time or measurements that are not sent); is it set to send each sample?";
        return Some((what, remedy));
    }
    if missing > 0 {
        let what = format!("loses samples: {missing} are missing beside {}", samples.len());
        return Some((what, "see to its cable and its speed; is the bus overloaded?"));
    }
    let stale = samples.iter().filter(|sample| sample.flag == Flag::Stale).count();
    let what = format!("falls silent: {stale} of {} samples did not come", samples.len());
    let remedy = "see to its cable, its power and its rate; is its time-out too short?";
    (stale > 0).then_some((what, remedy))
}

fn scatter(noise_um: f64, values: &[f64]) -> Option<Mistake> {
    let (_, sd) = statistics(values)?;
    if values.iter().all(|value| *value == values[0]) && noise_um > 0.0 {
        let what = "says the same to the last digit all the time".to_owned();
        return Some((what, "does it measure? See to its trigger, its hold input and its layout"));
    }
    let what = format!("scatters by {:.2} µm, where noise_um says {noise_um} µm", 1e3 * sd);
    let remedy = "let it look at a clean surface that stands still; if that is so, correct noise_um or its \
                  layout";
    (1e3 * sd > NOISY * noise_um).then_some((what, remedy))
}

fn rate(declared_hz: f64, samples: &[Sample]) -> Option<Mistake> {
    let (first, rest) = samples.split_first()?;
    let span_s = rest.last()?.t_s - first.t_s;
    let gives_hz = (rest.len() as u64 + missing(rest)) as f64 / span_s;
    let what = format!("gives {gives_hz:.0} samples a second, where rate_hz says {declared_hz}");
    let remedy =
        "set the sensor to the rate that is wanted (averaging makes it slower), or correct rate_hz";
    let off = (gives_hz / declared_hz - 1.0).abs() > OFF_RATE;
    (span_s > 0.0 && off).then_some((what, remedy))
}

/// Number of missing samples by the sensor's counter.
fn missing(samples: &[Sample]) -> u64 {
    samples.iter().map(|sample| u64::from(sample.missing)).sum()
}

fn told(name: &str, prepared: &Prepared, samples: &[Sample]) -> String {
    let rate = format!("{name}: {}, {:.0} samples/s", prepared.identity, prepared.rate_hz);
    match statistics(&values(samples)) {
        Some((mean, sd)) => format!("{rate}, {mean:.4} mm, scatters by {:.2} µm", 1e3 * sd),
        None => format!("{rate}; nothing is in its range now"),
    }
}

fn values(samples: &[Sample]) -> Vec<f64> {
    samples.iter().filter_map(|sample| sample.value_mm).collect()
}

/// Mean and standard deviation; `None` for fewer than two values.
fn statistics(values: &[f64]) -> Option<(f64, f64)> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() > 1).then(|| (mean, (square / (count - 1.0)).sqrt()))
}
