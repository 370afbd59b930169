//! `[report]`: data that a report prints and no computation uses.

use serde::Deserialize;

use super::document::TomlDocument;
use super::error::MachineFileError;
use machine::record::report_data::ReportData;

/// Reads `[report]`, and checks that `certificate_due` is a date. Without the section all data count as not stated.
pub fn read_report_data(document: &TomlDocument) -> Result<ReportData, MachineFileError> {
    let data = document.read_section(&["report"], ReportData::deserialize)?.unwrap_or_default();
    if let Some(due) = &data.certificate_due
        && due.parse::<jiff::civil::Date>().map(|date| date.to_string()).ok().as_ref() != Some(due)
    {
        let why = format!("`{due}` is not a date; write it as YYYY-MM-DD, such as 2027-03-31");
        return Err(document.value_error(&["report", "certificate_due"], why));
    }
    Ok(data)
}
