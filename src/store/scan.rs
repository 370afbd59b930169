//! All samples of one scan in one row, so that a scan is never stored in part. Temperatures belong to the row.

use rusqlite::{Connection, params};
use serde::{Deserialize, Serialize};

use super::{Fault, RunId, columns};
use machine::Axis;
use machine::record::reading::{Flag, Reading};

/// One stored sample, bit for bit: positions in the order of [`Axis::ALL`] (mm, rad), the value in mm, the time
/// in s.
#[derive(Serialize, Deserialize)]
struct Kept {
    at: [Option<f64>; Axis::ALL.len()],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mm: Option<f64>,
    t: f64,
    #[serde(default, skip_serializing_if = "is_none")]
    flag: Flag,
    /// Name of the sensor; absent if it is the sensor of the row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensor: Option<String>,
}

fn is_none(flag: &Flag) -> bool {
    *flag == Flag::None
}

pub(super) fn keep(
    connection: &mut Connection,
    run: RunId,
    samples: &[Reading],
) -> Result<(), Fault> {
    let Some(first) = samples.first() else { return Ok(()) };
    let what = || format!("the scan of step {}", first.step);
    if !samples.iter().all(columns::is_finite) {
        return Err(Fault::NotFinite { what: what() });
    }
    let kept: Vec<Kept> = samples.iter().map(|sample| Kept::of(sample, first)).collect();
    let text = columns::to_json(&what(), &kept)?;
    connection
        .execute(
            "INSERT INTO readings (run, step, repeat, sensor, t_s, flag, temperatures_c, kept, samples)
             VALUES (?1, ?2, ?3, ?4, ?5, '', ?6, ?7, ?8)",
            params![
                run.0,
                first.step,
                first.repeat,
                first.sensor,
                first.t_s,
                columns::to_json(&what(), &first.temperatures_c)?,
                columns::now(),
                text
            ],
        )
        .map_err(Fault::of_reading(run, first.step, first.repeat))?;
    Ok(())
}

/// Samples of a row whose other columns are in `row`.
pub(super) fn read(row: &Reading, samples: &str) -> Result<Vec<Reading>, serde_json::Error> {
    let kept: Vec<Kept> = serde_json::from_str(samples)?;
    let reading = |kept: Kept| {
        let axes = Axis::ALL.into_iter().zip(kept.at);
        Reading {
            position: axes.filter_map(|(axis, value)| Some((axis, value?))).collect(),
            value_mm: kept.mm,
            t_s: kept.t,
            flag: kept.flag,
            sensor: kept.sensor.unwrap_or_else(|| row.sensor.clone()),
            ..row.clone()
        }
    };
    Ok(kept.into_iter().map(reading).collect())
}

impl Kept {
    /// Converts a sample. `first`: the sample in the columns of the row.
    fn of(sample: &Reading, first: &Reading) -> Self {
        Self {
            sensor: (sample.sensor != first.sensor).then(|| sample.sensor.clone()),
            at: Axis::ALL.map(|axis| sample.position.get(axis)),
            mm: sample.value_mm,
            t: sample.t_s,
            flag: sample.flag,
        }
    }
}
