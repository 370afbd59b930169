//! `trued watch`: shows a sensor's samples while the sensor is mounted or wired.

use tokio::sync::mpsc;

use super::args::WatchArgs;
use super::failure::CommandFailure;
use super::run::build_runtime;
use crate::setup::{self, MachineFile};
use devices::sensors::{Sample, SensorHandle};
use machine::record::reading::ReadingFlag;

pub fn watch_command(args: &WatchArgs) -> Result<(), CommandFailure> {
    let file = MachineFile::read(&args.machine).map_err(setup::SetupError::from)?;
    build_runtime()?.block_on(async {
        let sensor = setup::open_sensor(&file, &args.sensor).await?;
        let connection = file.sensors.iter().find(|entry| entry.sensor.name == args.sensor);
        let at = connection.map(|entry| entry.connection.describe_address()).unwrap_or_default();
        let mut printer = SamplePrinter { json: args.json, remaining_samples: args.samples, was_signal_missing: false };
        tokio::select! {
            ended = print_samples(&sensor, &at, &mut printer) => ended,
            ended = tokio::signal::ctrl_c() => ended.map_err(CommandFailure::without_remedy),
        }
    })
}

/// Prints every sample until the printer has printed its last. After the sensor has ended the watch, single samples
/// are read.
async fn print_samples(
    sensor: &SensorHandle,
    sensor_address: &str,
    printer: &mut SamplePrinter,
) -> Result<(), CommandFailure> {
    let (tell, mut samples) = mpsc::unbounded_channel();
    let good = move |sample: &Sample| tell.send(*sample).is_ok();
    sensor.watch(good, || {}).await?;
    errln!("reading samples from {sensor_address}; press Ctrl-C to end");
    while let Some(sample) = samples.recv().await {
        if printer.print_and_check_last(&sample) {
            return Ok(());
        }
    }
    // The sensor has failed, or it measures only on request.
    sensor.end_watch().await?;
    loop {
        for sample in sensor.read_samples(1).await? {
            if printer.print_and_check_last(&sample) {
                return Ok(());
            }
        }
    }
}

struct SamplePrinter {
    json: bool,
    /// Number of samples still to print, without samples that lack a signal; `None`: no limit.
    remaining_samples: Option<u64>,
    /// Whether the previous sample had no signal. A missing signal is printed once.
    was_signal_missing: bool,
}

impl SamplePrinter {
    /// Prints the sample, unless this sample and the previous sample both lack a signal. Returns whether the
    /// requested number of samples is reached.
    fn print_and_check_last(&mut self, sample: &Sample) -> bool {
        let Sample { received_s: t_s, value_mm, flag, lost_before_count: missing, encoder_count } = *sample;
        let is_signal_missing = flag == ReadingFlag::Stale;
        if !(is_signal_missing && self.was_signal_missing) {
            let flag = flag.as_str();
            if self.json {
                let mut line = serde_json::json!({
                    "t_s": t_s, "value_mm": value_mm, "flag": flag, "missing": missing,
                });
                if let Some(count) = encoder_count {
                    line["encoder_count"] = count.into();
                }
                outln!("{line}");
            } else {
                let value = value_mm.map_or("-".to_owned(), |mm| format!("{mm:.5}"));
                let missing = if missing > 0 { format!(" ({missing} missing)") } else { String::new() };
                let count = encoder_count.map(|n| format!("encoder {n} ")).unwrap_or_default();
                outln!("{t_s:12.6} s {value:>12} mm {count}{flag}{missing}");
            }
        }
        self.was_signal_missing = is_signal_missing;
        self.remaining_samples = match self.remaining_samples {
            Some(remaining_samples) if !is_signal_missing => Some(remaining_samples.saturating_sub(1)),
            remaining_samples => remaining_samples,
        };
        self.remaining_samples == Some(0)
    }
}
