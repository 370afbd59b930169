//! All samples of one scan in one row, so that a scan is never stored in part. Temperatures belong to the row.

use rusqlite::{Connection, params};
use serde::{Deserialize, Serialize};

use super::{AwaitableWrite, Journal, RunId, StoreFault, columns};
use machine::Axis;
use machine::record::reading::{Reading, ReadingFlag};

/// One stored sample, bit for bit: positions in the order of [`Axis::ALL`] (mm, rad), the value in mm, the time
/// in s.
#[derive(Serialize, Deserialize)]
struct StoredSample {
    /// Positions of the axes.
    #[serde(rename = "at")]
    positions_mm_or_rad: [Option<f64>; Axis::ALL.len()],
    #[serde(rename = "mm", default, skip_serializing_if = "Option::is_none")]
    value_mm: Option<f64>,
    #[serde(rename = "t")]
    t_s: f64,
    #[serde(default, skip_serializing_if = "is_none")]
    flag: ReadingFlag,
    /// Name of the sensor; absent if it is the sensor of the row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensor: Option<String>,
}

/// Whether the reading has no flag.
fn is_none(flag: &ReadingFlag) -> bool {
    *flag == ReadingFlag::None
}

impl Journal {
    /// Adds all samples of one scan as one row, all with the step, repeat and temperatures of the first sample; without
    /// samples nothing is stored.
    pub fn add_scan(&self, run: RunId, samples: &[Reading]) -> AwaitableWrite<()> {
        let samples = samples.to_vec();
        self.submit_job(move |connection| insert_scan(connection, run, &samples))
    }
}

fn insert_scan(connection: &mut Connection, run: RunId, samples: &[Reading]) -> Result<(), StoreFault> {
    let Some(first) = samples.first() else { return Ok(()) };
    let what = || format!("the scan of step {}", first.step);
    if !samples.iter().all(columns::has_only_finite_numbers) {
        return Err(StoreFault::NotFinite { what: what() });
    }
    let kept: Vec<StoredSample> = samples.iter().map(|sample| StoredSample::from_reading(sample, first)).collect();
    let text = columns::to_json_with_finite_numbers(&what(), &kept)?;
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
                columns::to_json_with_finite_numbers(&what(), &first.temperatures_c)?,
                columns::now_text(),
                text
            ],
        )
        .map_err(StoreFault::from_reading_error(run, first.step, first.repeat))?;
    Ok(())
}

/// Samples of a row whose other columns are in `row`.
pub(super) fn parse_samples(row: &Reading, samples: &str) -> Result<Vec<Reading>, serde_json::Error> {
    let kept: Vec<StoredSample> = serde_json::from_str(samples)?;
    let reading = |kept: StoredSample| {
        let axes = Axis::ALL.into_iter().zip(kept.positions_mm_or_rad);
        Reading {
            position: axes.filter_map(|(axis, value)| Some((axis, value?))).collect(),
            value_mm: kept.value_mm,
            t_s: kept.t_s,
            flag: kept.flag,
            sensor: kept.sensor.unwrap_or_else(|| row.sensor.clone()),
            ..row.clone()
        }
    };
    Ok(kept.into_iter().map(reading).collect())
}

impl StoredSample {
    /// Converts a sample. `first`: the sample in the columns of the row.
    fn from_reading(sample: &Reading, first: &Reading) -> Self {
        Self {
            sensor: (sample.sensor != first.sensor).then(|| sample.sensor.clone()),
            positions_mm_or_rad: Axis::ALL.map(|axis| sample.position.get(axis)),
            value_mm: sample.value_mm,
            t_s: sample.t_s,
            flag: sample.flag,
        }
    }
}
