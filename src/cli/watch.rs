//! `trued watch`: shows a sensor's samples while the sensor is mounted or wired.

use tokio::sync::mpsc;

use super::Exit;
use super::args::WatchArgs;
use super::failure::Failure;
use crate::setup::{self, MachineFile};
use devices::sensors::{Sample, Sensor};
use machine::record::reading::Flag;

pub fn watch(args: &WatchArgs) -> Result<Exit, Failure> {
    let file = MachineFile::read(&args.machine).map_err(setup::SetupError::from)?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(Failure::plain)?;
    runtime.block_on(async {
        let sensor = setup::sensor(&file, &args.sensor).await?;
        let reached = file.sensors.iter().find(|entry| entry.sensor.name == args.sensor);
        let at = reached.map(|entry| entry.reached.at()).unwrap_or_default();
        let mut shown = Shown { json: args.json, left: args.samples, silent: false };
        tokio::select! {
            ended = show(&sensor, &at, &mut shown) => ended,
            ended = tokio::signal::ctrl_c() => ended.map_err(Failure::plain),
        }
    })?;
    Ok(Exit::Pass)
}

/// Shows every sample.
async fn show(sensor: &Sensor, at: &str, shown: &mut Shown) -> Result<(), Failure> {
    let (tell, mut told) = mpsc::unbounded_channel();
    let good = move |sample: &Sample| tell.send(*sample).is_ok();
    sensor.watch(good, || {}).await?;
    tell!("listening: {at}; Ctrl-C ends it");
    while let Some(sample) = told.recv().await {
        if shown.ends_with(&sample) {
            return Ok(());
        }
    }
    // The sensor has failed, or it measures only on request.
    sensor.rest().await?;
    loop {
        for sample in sensor.take(1).await? {
            if shown.ends_with(&sample) {
                return Ok(());
            }
        }
    }
}

struct Shown {
    json: bool,
    left: Option<u64>,
    /// Whether the missing signal has been reported; it is reported once.
    silent: bool,
}

impl Shown {
    /// Shows the sample; returns whether it is the last.
    fn ends_with(&mut self, sample: &Sample) -> bool {
        let Sample { t_s, value_mm, flag, missing, encoder_count } = *sample;
        let silent = flag == Flag::Stale;
        if !(silent && self.silent) {
            let flag = flag.as_str();
            if self.json {
                let mut line = serde_json::json!({
                    "t_s": t_s, "value_mm": value_mm, "flag": flag, "missing": missing,
                });
                if let Some(count) = encoder_count {
                    line["encoder_count"] = count.into();
                }
                say!("{line}");
            } else {
                let value = value_mm.map_or("-".to_owned(), |mm| format!("{mm:.5}"));
                let missing =
                    if missing > 0 { format!(" ({missing} missing)") } else { String::new() };
                let count = encoder_count.map(|n| format!("encoder {n} ")).unwrap_or_default();
                say!("{t_s:12.6} s {value:>12} mm {count}{flag}{missing}");
            }
        }
        self.silent = silent;
        self.left = match self.left {
            Some(left) if !silent => Some(left.saturating_sub(1)),
            left => left,
        };
        self.left == Some(0)
    }
}
