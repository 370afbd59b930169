//! Plan + readings → estimate.

use super::Settings;
use crate::methods::{IdentifyError, Refused};
use crate::record::estimate::Estimate;
use crate::record::plan::Plan;
use crate::record::reading::Reading;

pub fn identify(_: &Plan, _: &Settings, _: &[Reading]) -> Result<Estimate, IdentifyError> {
    Err(Refused { why: "not built yet".to_owned(), instead: "wait".to_owned() }.into())
}
