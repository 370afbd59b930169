//! `[tolerance]`: tolerances for the verdict; each key is the symbol of a parameter and the unit.

use std::collections::BTreeMap;

use super::document::TomlDocument;
use super::error::MachineFileError;
use machine::record::estimate::{ParameterTolerance, Unit};

/// Key suffixes that state a unit; the first suffix that fits counts.
const UNIT_SUFFIXES: [(&str, Unit); 5] =
    [("_um_per_m", Unit::UmPerM), ("_urad", Unit::Urad), ("_um", Unit::Um), ("_mm", Unit::Mm), ("_ms", Unit::Ms)];

/// Tolerances in the alphabetical order of their keys; none without `[tolerance]`.
pub fn read_tolerances(document: &TomlDocument) -> Result<Vec<ParameterTolerance>, MachineFileError> {
    if document.key_names(&["tolerance"])?.is_empty() {
        return Ok(Vec::new());
    }
    let raw: BTreeMap<String, f64> = document.deserialize_required_section(&["tolerance"])?;
    raw.iter()
        .map(|(key, &limit)| parse_tolerance(key, limit).map_err(|why| document.value_error(&["tolerance", key], why)))
        .collect()
}

/// Tolerance of a key such as `EX0C_um`; `limit`: maximum magnitude of the value, greater than 0.
fn parse_tolerance(key: &str, limit: f64) -> Result<ParameterTolerance, String> {
    let (symbol, unit) = UNIT_SUFFIXES
        .iter()
        .find_map(|(ending, unit)| Some((key.strip_suffix(ending)?, *unit)))
        .filter(|(symbol, _)| !symbol.is_empty())
        .ok_or("must be a symbol and a unit (_um, _urad, _um_per_m, _mm, _ms), e.g. `EX0C_um`")?;
    if limit <= 0.0 {
        return Err(format!("is {limit}; a limit must be greater than 0"));
    }
    Ok(ParameterTolerance { symbol: symbol.to_owned(), unit, limit })
}
