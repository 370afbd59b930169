//! SAMBA: the geometry of a five-axis machine, the stylus and the artefact at once, from master balls
//! that nobody has calibrated and one scale bar (paper 4; METHODS section 4).

mod fit;
mod identify;
mod label;
mod model;
mod observe;
mod outputs;
mod parameters;
mod settings;
mod sources;
mod suspects;
#[cfg(test)]
mod tests;
mod uncertainty;
mod warnings;

pub use fit::{Bar, Measured, Problem, Seen};
pub use model::Model;
pub use settings::Settings;

use super::{IdentifyError, Method, Next, Refused, Source};
use crate::record::estimate::Estimate;
use crate::record::plan::{Plan, Stage};
use crate::record::reading::Reading;

pub const NAME: &str = "samba";

pub struct Samba {
    settings: Settings,
}

impl Samba {
    pub fn new(settings: Settings) -> Self {
        Self { settings }
    }
}

impl Method for Samba {
    fn settings(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    fn next(&self, _: &Plan, _: &[Stage], _: Source<'_>) -> Result<Next, Refused> {
        Err(Refused { why: "not built yet".to_owned(), instead: "wait".to_owned() })
    }

    fn check_priors(&self, priors: &[Estimate]) -> Result<(), Refused> {
        match priors.first() {
            None => Ok(()),
            Some(prior) => Err(Refused {
                why: format!("samba takes no prior yet (given: {})", prior.method),
                instead: "leave out --with".to_owned(),
            }),
        }
    }

    fn identify(
        &self,
        plan: &Plan,
        readings: &[Reading],
        priors: &[Estimate],
    ) -> Result<Estimate, IdentifyError> {
        self.check_priors(priors)?;
        identify::identify(plan, &self.settings, readings)
    }
}
