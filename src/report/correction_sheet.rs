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
    /// e.g. `X of C`, or the symbol of an error.
    pub quantity: String,
    /// Measured value.
    pub value: String,
    /// Expanded uncertainty U of the value.
    pub expanded: String,
    pub unit: &'static str,
    /// The value that the machine file states; empty for an error.
    #[serde(rename = "stated")]
    pub stated_in_machine_file: String,
    /// Why the quantity is not determined, and the remedy; empty if it is determined.
    #[serde(rename = "remark")]
    pub not_determined_reason: String,
}

/// Measured errors of one run, for a person who enters them into a control or a CAM system.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CorrectionSheet {
    /// Number of the run.
    pub run: String,
    pub method: String,
    pub machine: String,
    pub topology: String,
    /// Local time at which the run started.
    pub measured_at: String,
    /// Whether the run was measured on a simulated control.
    pub is_simulated: bool,
    pub estimate_sha256: String,
    /// Positions of the rotary axes that carry the table, one row per axis and direction across the axis.
    pub positions: Vec<SheetRow>,
    /// Point for which the positions are valid, in words.
    pub reference_point: Option<String>,
    /// All other identified errors except those in µm, such as tilts, squareness and scales.
    pub others: Vec<SheetRow>,
    /// Warnings of the estimate.
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
