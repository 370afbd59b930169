//! Error motions of a rotary axis by multiprobe and multistep separation (paper 3): sensors around a
//! cylinder on the table, the cylinder indexed against the table. From samples of several revolutions to
//! five of the six error motions; the angular positioning error is not visible on a round artefact.
//!
//! [`resample`] puts samples on equal angles, [`harmonics`] reduces revolutions to harmonics with their
//! scatter, [`identify`] separates motion and artefact harmonic by harmonic. [`layout`] predicts before
//! the measurement what a layout separates.

pub mod checks;
pub mod diagnosis;
pub mod filter;
pub mod fit;
pub mod harmonics;
pub mod iso;
pub mod layout;
pub mod model;
pub mod outputs;
pub mod resample;
pub mod revolutions;
pub mod sources;

#[cfg(test)]
mod tests;

use self::fit::SeparationFit;
use self::harmonics::HarmonicData;
use self::model::ProbeLayout;
use self::outputs::ReportedMotions;
use self::sources::{SourceSizes, sources};
use crate::identification::{Identification, Outputs, TrialPlan};
use crate::{IdentifyError, Refused};

/// The identified error motions.
pub struct Separated {
    pub identification: Identification,
    pub fit: SeparationFit,
    /// Fixed by convention.
    pub gauge: Vec<String>,
    /// Harmonics that are not reported, and the combinations of unknowns that the rows do not separate.
    pub not_identifiable: Vec<String>,
}

/// Separates motion and artefact. Values by ISO 230-7 and roundness have an uncertainty only with
/// `trials`.
///
/// # Errors
/// Rows or surfaces that the layout does not hold; values that are not finite; fewer than two trials.
pub fn identify(
    layout: &ProbeLayout,
    data: &HarmonicData,
    sizes: &SourceSizes,
    trials: Option<TrialPlan>,
) -> Result<Separated, IdentifyError> {
    checks::check_surfaces(layout, &data.rows)?;
    if data.orders() == 0 {
        let instead = "ask for at least one harmonic".to_owned();
        return Err(Refused { why: "no harmonics to separate".to_owned(), instead }.into());
    }
    let fit = SeparationFit::new(layout, data)?;
    let motions = ReportedMotions::new(layout, &fit, sizes.stage);
    // The values by ISO 230-7 and the roundness have their uncertainty from the trials.
    let nonlinear = iso::nonlinear_outputs(&motions, &layout.components());
    let outputs = Outputs { nonlinear: Some(nonlinear), ..motions.linear_outputs() };
    let lost = fit.harmonics.iter().flat_map(|harmonic| harmonic.lost.clone());
    let not_identifiable: Vec<String> =
        motions.not_identifiable().into_iter().chain(lost).collect();
    let gauge = motions.gauge.clone();
    let sources = sources(layout, data, &fit, sizes);
    let identification =
        crate::identification::identify(&fit.solution(), &sources, outputs, trials)?;
    Ok(Separated { identification, fit, gauge, not_identifiable })
}
