//! Does each sensor speak, and does what it says make sense? Nothing moves.

use std::time::Instant;

use super::{Check, Ended, Part};
use crate::record::reading::Flag;
use crate::record::sensor;
use crate::sensors::{Entry, Prepared, Sample, SensorError};

/// It is listened to for so long, s, and for so many samples at least and at most.
const LISTEN_S: f64 = 0.5;
const FEWEST: u32 = 20;
const MOST: u32 = 500;
/// More noise than so many times what is declared is another sensor, or another place.
const NOISY: f64 = 5.0;

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    for Entry { sensor, reached } in &check.file.sensors {
        check.go_on()?;
        let since = Instant::now();
        let name = format!("{} ({})", sensor.name, reached.at());
        match listen(check, &sensor.name).await {
            Ok((prepared, samples)) => match mistake(sensor, &samples) {
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
    Ok(())
}

async fn listen(check: &Check<'_>, name: &str) -> Result<(Prepared, Vec<Sample>), SensorError> {
    let devices = check.devices.as_ref().ok_or(SensorError::Gone)?;
    let sensor = devices.sensors.open(name).await?;
    let prepared = sensor.prepare().await?;
    let count = (prepared.rate_hz * LISTEN_S).clamp(FEWEST.into(), MOST.into());
    let samples = sensor.take(count as u32).await?;
    Ok((prepared, samples))
}

/// What is wrong with what it says, and what to do.
fn mistake(sensor: &sensor::Sensor, samples: &[Sample]) -> Option<(String, &'static str)> {
    let missing: u64 = samples.iter().map(|sample| u64::from(sample.missing)).sum();
    let stale = samples.iter().filter(|sample| sample.flag == Flag::Stale).count();
    let values = values(samples);
    let [least, greatest] = sensor.range_mm;
    if missing > 0 {
        let what = format!("loses samples: {missing} are missing beside {}", samples.len());
        return Some((what, "see to its cable and its speed; is the bus overloaded?"));
    }
    if stale > 0 {
        let what = format!("falls silent: {stale} of {} samples did not come", samples.len());
        return Some((
            what,
            "see to its cable, its power and its rate; is its time-out too short?",
        ));
    }
    if let Some(value) = values.iter().find(|value| !(least..=greatest).contains(*value)) {
        let what = format!(
            "says {value:.3} mm, beyond its range of [{least}, {greatest}] mm, and does not call it so"
        );
        let remedy = "compare scale, offset, sign, byte or word order of its layout with its manual, \
                      and range_mm";
        return Some((what, remedy));
    }
    let (_, sd) = statistics(&values)?;
    if sd == 0.0 && sensor.noise_um.is_some_and(|noise| noise > 0.0) {
        let what = "says the same to the last digit all the time".to_owned();
        return Some((what, "does it measure? See to its trigger, its hold input and its layout"));
    }
    if let Some(noise) = sensor.noise_um.filter(|noise| 1e3 * sd > NOISY * noise) {
        let what = format!("scatters by {:.2} µm, where noise_um says {noise} µm", 1e3 * sd);
        let remedy = "let it look at a clean surface that stands still; if that is so, correct noise_um \
                      or its layout";
        return Some((what, remedy));
    }
    None
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

/// Mean and standard deviation; `None` of fewer than two.
fn statistics(values: &[f64]) -> Option<(f64, f64)> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() > 1).then(|| (mean, (square / (count - 1.0)).sqrt()))
}
