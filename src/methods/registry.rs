//! The list of methods. Method names, the help of the command line and the built-in machines derive from this list. A
//! test compares the table in the README with the list.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

use crate::outlier_repeats::OutlierRepeater;
use crate::probe_map_method::ProbeMapMethod;
use crate::prompts::PromptedMethod;
use crate::{Method, MethodDescription, RegisteredMethod};

macro_rules! registry {
    ($($method:ty,)*) => {
        /// Descriptions of all methods, in the order in which users see them.
        pub const METHOD_DESCRIPTIONS: &[MethodDescription] = &[$(<$method>::DESCRIPTION),*];

        fn method_by_name<'de, D: Deserializer<'de>>(name: &str, settings: D) -> Result<Box<dyn Method>, D::Error> {
            $(if name == <$method>::DESCRIPTION.name {
                return Ok(Box::new(<$method>::new(Deserialize::deserialize(settings)?)));
            })*
            let known = method_names().join(", ");
            Err(D::Error::custom(format!("there is no method `{name}`; the methods are {known}")))
        }
    };
}

registry! {
    crate::self_calibration::SelfCalibration,
    crate::samba::Samba,
    crate::laser_r_test::LaserRTest,
    crate::latch_delay::LatchDelay,
    crate::ball_plate::BallPlate,
    crate::ball_dome::BallDome,
    crate::multiprobe::Multiprobe,
    crate::r_test::RTest,
    crate::probe_qualification::ProbeQualification,
}

pub fn method_names() -> Vec<&'static str> {
    METHOD_DESCRIPTIONS.iter().map(|method| method.name).collect()
}

pub fn method_description(name: &str) -> Option<&'static MethodDescription> {
    METHOD_DESCRIPTIONS.iter().find(|method| method.name == name)
}

/// The method `name` with its settings, from the machine file or from a plan. The method is wrapped: it handles the
/// prompts that a plan contains, measures outliers again and applies a probe map among the priors.
///
/// # Errors
/// The method is unknown, or its settings are invalid (unknown keys, wrong types).
pub fn configure_method<'de, D: Deserializer<'de>>(name: &str, settings: D) -> Result<Box<dyn Method>, D::Error> {
    let method = method_by_name(name, settings)?;
    let mut settings = method.settings();
    if let Some(trials) = settings.get_mut("monte_carlo_trials") {
        // Only the residuals of this copy are used, so the minimum number of trials suffices.
        *trials = crate::MethodRefusal::MIN_MONTE_CARLO_TRIALS.into();
    }
    let fast_method = ProbeMapMethod(method_by_name(name, settings).map_err(D::Error::custom)?);
    let suspecting =
        OutlierRepeater { method: Box::new(ProbeMapMethod(method)), method_with_few_trials: Box::new(fast_method) };
    Ok(Box::new(PromptedMethod::without_new_prompts(Box::new(suspecting))))
}
