//! Sheet of the measured errors, for a person who enters them into a control or a CAM system.

use std::io;

use minijinja::context;
use minijinja::value::Serde;
use serde::Serialize;

use super::captions::sketch_values;
use super::page::html_environment;
use machine::record::estimate::Estimate;

const SHEET_TEMPLATE: &str = include_str!("correction_sheet.html");
const COLUMNS: [&str; 6] = ["quantity", "value", "U", "unit", "stated", "remark"];

/// One quantity. A number that is missing is an empty text.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SheetRow {
    /// e.g. `X of C`, or a symbol.
    pub quantity: String,
    pub value: String,
    pub expanded: String,
    pub unit: &'static str,
    /// The value that the machine file states.
    #[serde(rename = "stated")]
    pub stated_in_machine_file: String,
    /// Why the quantity is not determined.
    #[serde(rename = "remark")]
    pub not_determined_reason: String,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CorrectionSheet {
    pub run: String,
    pub method: String,
    pub machine: String,
    pub topology: String,
    pub measured_at: String,
    pub is_simulated: bool,
    pub estimate_sha256: String,
    /// Positions of the rotary axes.
    pub positions: Vec<SheetRow>,
    /// Point for which the positions are valid, in words.
    pub reference_point: Option<String>,
    /// Tilts, squareness and scales.
    pub others: Vec<SheetRow>,
    pub warnings: Vec<String>,
}

impl CorrectionSheet {
    /// The sheet as a page, with the sketches of the errors of `estimate`.
    ///
    /// # Errors
    /// The template cannot be rendered.
    pub fn render(&self, estimate: &Estimate) -> Result<String, minijinja::Error> {
        let values = context! { sheet => Serde(self), sketches => sketch_values(estimate) };
        html_environment().render_str(SHEET_TEMPLATE, values)
    }

    /// One row for each quantity, CSV in UTF-8. The numbers have an ASCII minus sign, which programs read.
    ///
    /// # Errors
    /// `output` cannot be written.
    pub fn write_csv(&self, output: impl io::Write) -> io::Result<()> {
        let mut table = csv::Writer::from_writer(output);
        table.write_record(COLUMNS)?;
        for row in self.positions.iter().chain(&self.others) {
            let [value, expanded, stated] =
                [&row.value, &row.expanded, &row.stated_in_machine_file].map(|text| text.replace('−', "-"));
            table.write_record([&row.quantity, &value, &expanded, row.unit, &stated, &row.not_determined_reason])?;
        }
        table.flush()
    }
}
