//! Comparison of each measurement with all others: residuals and outliers.

use serde::{Deserialize, Serialize};

/// Comparison of one measurement with all others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasurementCheck {
    /// Label from the plan.
    pub label: String,
    /// Mean time of its readings, on their clock, s. Absent in estimates of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_s: Option<f64>,
    /// Measured value minus the value of the model, outward along a touch; for a point, the length of the difference.
    /// Absent in estimates of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_um: Option<f64>,
    /// Smallest deviation that is detected with a probability of 95 %; absent if no other measurement checks it.
    #[serde(rename = "deviation_um", default, skip_serializing_if = "Option::is_none")]
    pub min_detectable_deviation_um: Option<f64>,
}

/// A measurement that is far from the value predicted by all others. It is still part of the estimate, unless a
/// repeated measurement replaces it: the operator decides whether its readings are flagged `excluded`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outlier {
    /// Candidates; several if the readings do not show which of them is wrong.
    pub candidates: Vec<OutlierCandidate>,
    /// Externally studentised residual; for a measurement of several rows, the length of its studentised residuals.
    #[serde(rename = "t")]
    pub studentised_residual: f64,
    /// Action taken, as text; absent: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolution: Option<String>,
}

impl Outlier {
    /// `resolution` of an outlier whose measurement is replaced by a repeated one.
    pub const REPLACED: &str = "measured again: the last measurement counts";

    /// Whether a repeated measurement replaces this one, which is then no longer part of the estimate.
    pub fn is_replaced(&self) -> bool {
        self.resolution.as_deref() == Some(Self::REPLACED)
    }
}

/// Deviation of one measurement, with the label from the plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutlierCandidate {
    pub label: String,
    /// Measured value minus the value predicted by all others, outward along the touch; for a ball, the length of the
    /// displacement.
    pub deviation_um: f64,
}
