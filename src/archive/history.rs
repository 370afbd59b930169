//! A machine's values over its runs.

use jiff::Timestamp;
use serde::Serialize;

use crate::decision::trend::{Point, Trend};
use crate::record::estimate::{Estimate, Unit};
use crate::store::{Journal, RunId, StoreError};

/// What one finished run said of one value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Value {
    pub run: RunId,
    pub started: Timestamp,
    pub value: f64,
    /// Expanded uncertainty.
    #[serde(rename = "U")]
    pub expanded: f64,
}

/// One value of one method over all finished runs in which it was identified, oldest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Series {
    pub method: String,
    pub symbol: String,
    pub unit: Unit,
    pub values: Vec<Value>,
    pub trend: Trend,
}

/// All series of `machine`, those of a method together, in the order in which they first came.
///
/// # Errors
/// The journal cannot be read.
pub fn history(journal: &Journal, machine: &str) -> Result<Vec<Series>, StoreError> {
    let mut all: Vec<(String, String, Unit, Vec<Value>)> = Vec::new();
    for measured in journal.measured(machine)? {
        let Estimate { parameters, .. } = measured.estimate;
        for parameter in parameters.into_iter().filter(|parameter| parameter.identifiable) {
            let value = Value {
                run: measured.run,
                started: measured.started,
                value: parameter.value,
                expanded: parameter.expanded,
            };
            let known = all.iter_mut().find(|(method, symbol, unit, _)| {
                (method, symbol, *unit) == (&measured.method, &parameter.symbol, parameter.unit)
            });
            match known {
                Some((.., values)) => values.push(value),
                None => {
                    all.push((
                        measured.method.clone(),
                        parameter.symbol,
                        parameter.unit,
                        vec![value],
                    ));
                }
            }
        }
    }
    all.sort_by(|(one, ..), (other, ..)| one.cmp(other));
    Ok(all.into_iter().map(series).collect())
}

fn series((method, symbol, unit, values): (String, String, Unit, Vec<Value>)) -> Series {
    let point = |value: &Value| Point {
        t_s: value.started.as_duration().as_secs_f64(),
        value: value.value,
    };
    let trend = Trend::of(values.iter().map(point).collect());
    Series { method, symbol, unit, values, trend }
}
