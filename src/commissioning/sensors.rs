//! Checks that each sensor answers with plausible samples. Nothing moves.

use super::{CheckEnd, CheckPart, MachineCheck, PartTimer, thermometers};
use crate::setup::machine_file::SensorEntry;
use devices::sensors::{Sample, SensorError, SensorInfo};
use machine::record::reading::ReadingFlag;

/// Duration of the test of a sensor, s.
const SENSOR_TEST_DURATION_S: f64 = 0.5;
/// Minimum number of samples of the test: a slow sensor is tested for longer.
const MIN_TEST_SAMPLES: u32 = 20;
/// Maximum number of samples of the test: a fast sensor is tested for a shorter time.
const MAX_TEST_SAMPLES: u32 = 500;
/// Maximum ratio of the measured noise (standard deviation) to the declared noise. A larger ratio indicates another
/// sensor or another mounting place.
const MAX_NOISE_RATIO: f64 = 5.0;
/// Maximum relative deviation of the sample rate from `rate_hz`. The computer may be late with the first or the last
/// sample.
const MAX_RELATIVE_RATE_DEVIATION: f64 = 0.2;

/// Description and remedy of a fault.
type SensorFault = (String, &'static str);

pub(super) async fn check_sensors(check: &mut MachineCheck<'_>) -> Result<(), CheckEnd> {
    for entry in &check.machine_file.sensors {
        check.require_no_stop_request()?;
        let timer = PartTimer::start(CheckPart::Sensors);
        let name = format!("{} ({})", entry.sensor.name, entry.connection.describe_address());
        match record_samples(check, &entry.sensor.name).await {
            Ok((prepared, samples)) => match sensor_fault(entry, &samples) {
                Some((what, remedy)) => {
                    check.report_failed(timer, format!("{name} {what}"), remedy);
                }
                None => check.report_ok(timer, describe_samples(&name, &prepared, &samples)),
            },
            Err(error) => {
                let what = format!("{name}: {error}");
                check.report_failed(timer, what, error.remedy());
            }
        }
    }
    thermometers::check_thermometers(check).await
}

async fn record_samples(check: &MachineCheck<'_>, name: &str) -> Result<(SensorInfo, Vec<Sample>), SensorError> {
    let devices = check.devices.as_ref().ok_or(SensorError::TaskEnded)?;
    let sensor = devices.sensor_opener.open(name).await?;
    let prepared = sensor.prepare().await?;
    let count =
        (prepared.sample_rate_hz * SENSOR_TEST_DURATION_S).clamp(MIN_TEST_SAMPLES.into(), MAX_TEST_SAMPLES.into());
    let samples = sensor.read_samples(count as u32).await?;
    Ok((prepared, samples))
}

/// The first fault: missing or late samples, then noise, then sample rate. Noise and rate are checked only if the
/// machine file states them.
fn sensor_fault(
    SensorEntry { sensor, sample_rate_hz: rate_hz, .. }: &SensorEntry,
    samples: &[Sample],
) -> Option<SensorFault> {
    let values = sample_values(samples);
    missing_samples_fault(samples)
        .or_else(|| noise_fault(sensor.noise_um?, &values))
        .or_else(|| rate_fault((*rate_hz)?, samples))
}

/// Fault of a sensor whose samples are missing or late.
fn missing_samples_fault(samples: &[Sample]) -> Option<SensorFault> {
    let missing = missing_sample_count(samples);
    let jumps = samples.iter().filter(|sample| sample.lost_before_count > 0).count();
    if 2 * jumps > samples.len() {
        let what = format!(
            "increments its sample counter by more than one between most samples: {missing} samples would \
            be missing in addition to the {} received",
            samples.len()
        );
        let remedy = "compare `counter` of the sensor layout with the manual of the sensor (position, \
            width, byte order; the counter may count time or measurements that are not sent), and set the \
            sensor to send each sample";
        return Some((what, remedy));
    }
    if missing > 0 {
        let what = format!("loses samples: {missing} are missing, {} were received", samples.len());
        return Some((what, "check the cable and the data rate of the sensor, and whether the bus is overloaded"));
    }
    let stale = samples.iter().filter(|sample| sample.flag == ReadingFlag::Stale).count();
    let what = format!("sends no data at times: {stale} of {} samples were not received in time", samples.len());
    let remedy = "check the cable, the power supply and the rate of the sensor, and whether its time-out is too short";
    (stale > 0).then_some((what, remedy))
}

/// Fault if all values are equal (unless the declared noise is 0), or if their standard deviation is more than
/// `MAX_NOISE_RATIO` times the declared noise.
fn noise_fault(declared_noise_um: f64, values: &[f64]) -> Option<SensorFault> {
    let (_, sd) = mean_and_standard_deviation(values)?;
    if values.iter().all(|value| *value == values[0]) && declared_noise_um > 0.0 {
        let what = "reports exactly the same value in every sample".to_owned();
        return Some((what, "check that the sensor is measuring: check its trigger, its hold input and its layout"));
    }
    let what = format!("has a noise of {:.2} µm; the machine file states noise_um = {declared_noise_um}", 1e3 * sd);
    let remedy = "point the sensor at a clean surface at rest; if the noise stays the same, correct \
        noise_um or the layout of the sensor";
    (1e3 * sd > MAX_NOISE_RATIO * declared_noise_um).then_some((what, remedy))
}

/// Fault of the sample rate, for which lost samples count as sent.
fn rate_fault(declared_hz: f64, samples: &[Sample]) -> Option<SensorFault> {
    let (first, rest) = samples.split_first()?;
    let span_s = rest.last()?.received_s - first.received_s;
    let measured_hz = (rest.len() as u64 + missing_sample_count(rest)) as f64 / span_s;
    let what = format!("sends {measured_hz:.0} samples/s; the machine file states rate_hz = {declared_hz}");
    let remedy = "set the sensor to the required rate (averaging reduces the rate), or correct rate_hz";
    let off = (measured_hz / declared_hz - 1.0).abs() > MAX_RELATIVE_RATE_DEVIATION;
    (span_s > 0.0 && off).then_some((what, remedy))
}

/// Number of missing samples according to the counter of the sensor.
fn missing_sample_count(samples: &[Sample]) -> u64 {
    samples.iter().map(|sample| u64::from(sample.lost_before_count)).sum()
}

fn describe_samples(name: &str, prepared: &SensorInfo, samples: &[Sample]) -> String {
    let rate = format!("{name}: {}, {:.0} samples/s", prepared.identity, prepared.sample_rate_hz);
    match mean_and_standard_deviation(&sample_values(samples)) {
        Some((mean, sd)) => format!("{rate}, {mean:.4} mm, noise {:.2} µm", 1e3 * sd),
        None => format!("{rate}; no surface is within the range of the sensor now"),
    }
}

fn sample_values(samples: &[Sample]) -> Vec<f64> {
    samples.iter().filter_map(|sample| sample.value_mm).collect()
}

/// Mean and standard deviation; `None` for fewer than two values.
fn mean_and_standard_deviation(values: &[f64]) -> Option<(f64, f64)> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() > 1).then(|| (mean, (square / (count - 1.0)).sqrt()))
}
